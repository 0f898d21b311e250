"""Compares what `diagnose` said of a draw with the key.

Misfit of an effect, in σ: the root of Σ 2 |log(Z_fit/Z_clean)|²/noise² over the fitted points, less the number of
fitted unknowns (the contribution of the noise). Z_fit is the base model refitted to the noisy sweep, for a pair the
base with the other effect; Z_clean the truth without noise, noise the true one. The misfit does not depend on how well
the library's candidate of the effect fits.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from femu_piezo.errors import FemuPiezoError
from femu_piezo.inference.fit import Fit, stepped
from femu_piezo.specimen.file import read_specimen
from femu_piezo.study.diagnose import Diagnosis, diagnose
from femu_piezo.study.model_cache import Bases
from hidden_effects.catalogue import NAMES
from hidden_effects.draws import Draw

#: Misfit in σ above which an effect counts as detectable.
DETECTABLE = 8.0
#: (estimated value, its standard deviation, true value), SI.
Known = tuple[float, float, float]


@dataclass(frozen=True)
class Outcome:
    """One judged draw.

    Attributes
    ----------
    name, seed : of the draw;  kind : null, single, variant, pair or undescribed
    truth : the hidden effects;  along : what comes with them
    sigma : misfit of each hidden effect (of all together if undescribed), σ; −1 where the fit that it needs is missing
    word, said : the verdict and the causes, as effect → probability
    alike : causes that are reported as indistinguishable from each cause
    sizes : "effect.parameter" → (estimated − true)/std, of the effects named rightly
    bias : constant → (value after extension − true)/std, "tan_…" likewise
    ratio : rms error of held-out points over the true noise, with the causes in the fit and without
    misfit : rms error of held-out points with the causes in the fit over that of a right model
    seconds : of the diagnosis
    chances : every candidate → its probability by the comparison of all sets of causes
    below : constant → probability that it is below the true one, averaged over all sets of causes
    constants, causes : (estimated, std, true), SI, from which `bias` and `sizes` are computed
    """

    name: str
    seed: int
    kind: str
    truth: tuple[str, ...]
    sigma: tuple[float, ...]
    word: str
    said: dict[str, float]
    alike: dict[str, list[str]]
    variant: str = ""
    along: tuple[str, ...] = ()
    sizes: dict[str, float] = field(default_factory=dict)
    bias: dict[str, float] = field(default_factory=dict)
    ratio: tuple[float, float] = (0.0, 0.0)
    misfit: float = 0.0
    seconds: float = 0.0
    chances: dict[str, float] = field(default_factory=dict)
    constants: dict[str, Known] = field(default_factory=dict)
    causes: dict[str, Known] = field(default_factory=dict)
    below: dict[str, float] = field(default_factory=dict)

    @property
    def detectable(self) -> bool:
        """Whether every hidden effect is detectable."""
        return bool(self.sigma) and min(self.sigma) > DETECTABLE

    @property
    def first(self) -> bool:
        """Whether all true causes are named, a single one as the first."""
        if len(self.truth) == 1:
            return next(iter(self.said), None) == self.truth[0]
        return set(self.truth) <= set(self.said)

    @property
    def in_class(self) -> bool:
        """Whether all true causes are named, or reported as indistinguishable from a named one (for a single cause
        from the first).
        """
        named = list(self.said)[:1] if len(self.truth) == 1 else list(self.said)
        reach = {*named, *(other for cause in named for other in self.alike[cause])}
        return bool(self.truth) and set(self.truth) <= reach

    @property
    def confident(self) -> bool:
        """A verdict "effect" with a probability above 0.9."""
        return self.word == "effect" and max(self.said.values(), default=0.0) > 0.9

    def line(self) -> str:
        """The outcome as one line of text."""
        sigma = ", ".join(f"{s:.0f}" for s in self.sigma)
        said = ", ".join(
            f"{cause} {chance:.2f}" + (f" (or {', '.join(self.alike[cause])})" if self.alike[cause] else "")
            for cause, chance in self.said.items()
        )
        mark = "+" if self.first else "~" if self.in_class else "-"
        if self.kind == "null":
            mark = "+" if self.word == "none" else "-"
        sizes = " ".join(f"{name.partition('.')[2]} {value:+.1f}σ" for name, value in self.sizes.items())
        words = f" [{self.variant}]" if self.variant else ""
        return (
            f"{mark} {self.name}:{self.seed}{words} {sigma or '0'} σ → {self.word}: {said or 'nothing'}; {sizes} "
            f"rms/noise {self.ratio[0]:.2f} (over expected {self.misfit:.2f}, before {self.ratio[1]:.1f}), "
            f"{self.seconds:.0f} s"
        )


def judge_draw(draw: Draw, folder: Path, bases: Bases | None = None) -> Outcome:
    """Write specimen and sweep, diagnose them, and compare with the key; a refused sweep counts as missed.

    bases : source of the models of the diagnosis; None for bases of its own
    """
    kind, truth = _kind(draw), tuple(hidden.title for hidden in draw.key)
    truth = truth or ((draw.undescribed,) if draw.undescribed else ())
    try:
        result = diagnose(read_specimen(draw.write(folder)), bases=bases)
    except FemuPiezoError as error:
        return Outcome(draw.name, draw.seed, kind, truth, (np.inf,) * len(truth), "refused", {}, {}, str(error))
    causes, constants, found = result.verdict.causes, _constants(draw, result), _sizes(draw, result)
    return Outcome(
        name=draw.name,
        seed=draw.seed,
        kind=kind,
        truth=truth,
        sigma=_misfits(draw, result),
        word=result.verdict.word,
        said={cause.effect.title: cause.probability for cause in causes},
        alike={cause.effect.title: list(cause.indistinguishable_from) for cause in causes},
        variant=", ".join(hidden.variant for hidden in draw.key if hidden.variant),
        along=tuple(name for hidden in draw.key for name in hidden.along),
        sizes=_in_deviations(found),
        bias=_in_deviations(constants),
        ratio=(result.gain["held_out_after"] / draw.noise, result.gain["held_out_before"] / draw.noise),
        misfit=result.gain["over_expected"] * result.gain["noise_floor"] / draw.noise,
        seconds=sum(result.seconds.values()),
        chances=dict(sorted(result.comparison.probabilities.items(), key=lambda item: -item[1])),
        constants=constants,
        causes=found,
        below=_below(result, constants),
    )


def _kind(draw: Draw) -> str:
    if draw.undescribed:
        return "undescribed"
    if len(draw.key) == 1:
        return "variant" if draw.key[0].variant else "single"
    return "pair" if draw.key else "null"


def _misfits(draw: Draw, result: Diagnosis) -> tuple[float, ...]:
    """Misfit of each hidden effect, σ."""
    seen = result.fitted
    if len(draw.key) < 2:
        base = replace(result.comparison.base, discrepancy=None)
        whole = min(
            _left(draw, one, seen) for one in (base, stepped(base))
        )  # the base fit without its discrepancy, also one step further
        return (whole,) if draw.key or draw.undescribed else ()
    fits = {trial.effect.title: [trial.fit] for trial in result.comparison.singles if trial.fit is not None}
    final = result.comparison.final
    if len(final.parameters.causes) == 1:  # fitted until it converged, unlike some single candidates
        fits.setdefault(final.parameters.causes[0].title, []).append(final)
    others = [fits.get(other.title, []) for other in reversed(draw.key)]
    return tuple(min((_left(draw, fit, seen) for fit in fits_without), default=-1.0) for fits_without in others)


def _left(draw: Draw, fit: Fit, seen: np.ndarray) -> float:
    """Misfit that a fit leaves against the noise-free sweep, σ."""
    return _root(fit.log_error + np.log(draw.impedance / draw.clean)[seen], draw.noise, fit.x.size)


def _root(error: np.ndarray, noise: float, unknowns: int) -> float:
    """Root of the weighted squares less the number of unknowns."""
    return float(np.sqrt(max(0.0, 2 * np.sum(np.abs(error) ** 2) / noise**2 - unknowns)))


def _in_deviations(known: Mapping[str, Known]) -> dict[str, float]:
    """Name → (estimated − true)/std."""
    return {name: (value - truth) / std for name, (value, std, truth) in known.items()}


def _sizes(draw: Draw, result: Diagnosis) -> dict[str, Known]:
    """Sizes of the effects named rightly, where the key has them; signs that no sweep can tell are left out of the
    key.
    """
    found = {}
    for hidden in draw.key:
        for cause in result.verdict.causes:
            if cause.effect.title != hidden.title or not hidden.sized:
                continue
            for parameter, value, std in zip(cause.effect.parameters, cause.values, cause.std, strict=True):
                if parameter.name in hidden.sizes:
                    truth = hidden.sizes[parameter.name]
                    found[f"{hidden.title}.{parameter.name}"] = (float(value), float(std), float(truth))
    return found


def _constants(draw: Draw, result: Diagnosis) -> dict[str, Known]:
    """Constants and tangents with the causes in the fit, at the reference frequency of laws over frequency."""
    truth, found = draw.build.stated(result.reference_Hz), {}
    for name, estimate in result.after.items():
        value = complex(truth[NAMES.index(name)])
        found[name] = (estimate.value, estimate.std, value.real)
        found[f"tan_{name}"] = (estimate.tan, estimate.tan_std, -value.imag / value.real)
    return found


def _below(result: Diagnosis, constants: Mapping[str, Known]) -> dict[str, float]:
    """Name → probability that it is below its true value, averaged over all sets of causes."""
    truth = np.array([true for _, _, true in constants.values()])
    return dict(zip(constants, result.comparison.averaged.below(truth).tolist(), strict=True))
