"""`StandardFigures`: what a data sheet states of a piece, by the definitions and formulas of the standards.

Each figure comes with the value of the finite element model where there is one. The formulas take one dimension of the
body as infinite or as negligible; `formula_error` is the error of that for this piece: of the formula applied to the
curve of finite elements with the dimensions of the formula and no circuit, relative to the constants of that curve.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from femu_piezo.material.constants import PiezoConstants
from femu_piezo.resonances import Resonance
from femu_piezo.standards.formulas import disk_poisson
from femu_piezo.standards.frequencies import Admittance, CharacteristicFrequencies, characteristic_frequencies
from femu_piezo.standards.piece import WORDS, Piece, material_figures
from femu_piezo.units import hertz

#: Frequency at which data sheets state capacitance and loss, Hz.
STATED = 1e3
#: Relative error of a formula below which it is right.
_RIGHT = 1e-5
#: Share of fs below which a body is taken as a free capacitor.
_LOW = 0.1
#: Loss of pole or zero below which a computed curve is taken as lossless.
LEAST_LOSS = 1e-8
#: Range of f/fs1 in which a pole of a disk is its second radial mode: fs2/fs1 is 2.5 to 2.75 for σ = 0.1 to 0.5.
_SECOND_RADIAL = (2.4, 2.9)

MEANING = {
    "fs": ("series resonance, largest conductance", "Hz"),
    "fp": ("parallel resonance, largest resistance", "Hz"),
    "fm": ("largest |Y|", "Hz"),
    "fn": ("largest |Z|", "Hz"),
    "fr": ("resonance, zero reactance", "Hz"),
    "fa": ("antiresonance, zero reactance", "Hz"),
    "k_eff": ("effective coupling from fs, fp", "1"),
    "Qm_3dB": ("mechanical quality, 3 dB of G", "1"),
    "Qm_Z": ("mechanical quality by |Z| at fm", "1"),
    "Qm_pole": ("mechanical quality of the pole, 1/eta", "1"),
    "Qm_zero": ("mechanical quality of the zero, 1/eta", "1"),
    "C_T": ("capacitance at 1 kHz", "F"),
    "tan_delta": ("loss tangent at low frequency", "1"),
    "k31": ("coupling across the poling", "1"),
    "k33": ("coupling along the poling", "1"),
    "kp": ("planar coupling", "1"),
    "kt": ("thickness coupling", "1"),
    "k15": ("shear coupling", "1"),
    "poisson": ("planar Poisson ratio -s12/s11", "1"),
    "N1": ("frequency constant fs l", "Hz m"),
    "N3": ("frequency constant fp l", "Hz m"),
    "Np": ("frequency constant fs d", "Hz m"),
    "N_ring": ("frequency constant fs d, mean diameter", "Hz m"),
    "Nt": ("frequency constant fp t", "Hz m"),
    "N15": ("frequency constant fp t", "Hz m"),
    "s11": ("compliance across the poling", "m^2/N"),
    "s33": ("compliance along the poling", "m^2/N"),
    "s33D": ("compliance along the poling, open circuit", "m^2/N"),
    "s44": ("shear compliance", "m^2/N"),
    "c33": ("stiffness along the poling", "Pa"),
    "c33D": ("stiffness along the poling, open circuit", "Pa"),
    "c44D": ("shear stiffness, open circuit", "Pa"),
    "d31": ("strain across the poling per field", "C/N"),
    "d33": ("strain along the poling per field", "C/N"),
    "d15": ("shear strain per field", "C/N"),
    "eps33T": ("free permittivity along the poling", "F/m"),
    "eps11T": ("free permittivity across the poling", "F/m"),
}


@dataclass(frozen=True)
class CurveFigures:
    """The figures of one curve: name → value, SI; `notes` say where the capacitance and σ are from.

    `poisson` is the σ that the formulas of a disk used; `std` has the deviations of what was read from a noisy point.
    """

    values: dict[str, float]
    notes: tuple[str, ...]
    poisson: float
    std: dict[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Figure:
    """One figure.

    Attributes
    ----------
    name, meaning, unit : SI units, "1" for a pure number
    value : from the sweep, by definition or by the formula of the standard; None where the sweep gives none
    std : standard deviation by the noise of the sweep, None where unknown
    model : value of the finite element model, from its curve or the material constant itself
    formula_error : relative error of the formula for this piece; None where no formula of a body is used
    """

    name: str
    meaning: str
    unit: str
    value: float | None
    std: float | None = None
    model: float | None = None
    formula_error: float | None = None

    @property
    def deviation(self) -> float | None:
        """value/model − 1."""
        return None if self.value is None or not self.model else float(self.value / self.model - 1)


@dataclass(frozen=True)
class StandardFigures:
    """The figures of one mode of a piece.

    Attributes
    ----------
    title : kind of body and mode, in words
    figures : in the order of a data sheet
    aspect : the ratio that the formulas take as large, ("length/width", 8.0), None where there is none
    notes : sentences
    """

    title: str
    figures: tuple[Figure, ...]
    aspect: tuple[str, float] | None = None
    notes: tuple[str, ...] = ()

    def __getitem__(self, name: str) -> Figure:
        """A figure by its name; KeyError where there is none."""
        try:
            return next(one for one in self.figures if one.name == name)
        except StopIteration:
            raise KeyError(name) from None

    def with_coupling_std(self, std: float) -> StandardFigures:
        """The same with the standard deviation of k_eff; nan where it is not known."""
        return self._with("k_eff", std=None if np.isnan(std) else std)

    def with_model(self, name: str, value: float) -> StandardFigures:
        """The same with a value of the model for a figure, where the sweep gives that figure; SI."""
        return self._with(name, model=value)

    def with_notes(self, notes: tuple[str, ...]) -> StandardFigures:
        """The same with further notes."""
        return replace(self, notes=self.notes + notes)

    def _with(self, name: str, **changes: float | None) -> StandardFigures:
        changed = (replace(one, **changes) if one.name == name else one for one in self.figures)
        return replace(self, figures=tuple(changed))

    @property
    def formula_words(self) -> str | None:
        """What the formulas get wrong for this piece, as a sentence; None without a model or a formula."""
        wrong = [one for one in self.figures if abs(one.formula_error or 0.0) > _RIGHT]
        if not wrong:
            return None
        ratio = f" ({self.aspect[0]} = {self.aspect[1]:.3g})" if self.aspect else ""
        found = ", ".join(f"{one.name} {100 * one.formula_error:+.2g} %" for one in wrong)
        return f"what the handbook formulas get wrong for this piece{ratio}: {found}"

    def to_json(self) -> dict:
        """JSON types only."""
        return {
            "title": self.title,
            "aspect": None if self.aspect is None else {"ratio": self.aspect[0], "value": self.aspect[1]},
            "figures": {
                one.name: {
                    "value": one.value,
                    "std": one.std,
                    "unit": one.unit,
                    "model": one.model,
                    "deviation": one.deviation,
                    "formula_error": one.formula_error,
                    "meaning": one.meaning,
                }
                for one in self.figures
            },
            "notes": list(self.notes),
        }


def read_curve(
    admittance: Admittance,
    points: tuple[np.ndarray, np.ndarray],
    pole: Resonance,
    zero: Resonance,
    piece: Piece,
    overtone: Resonance | None = None,
    noise: np.ndarray | None = None,
) -> CurveFigures:
    """The figures of one curve about one pole and its zero.

    Parameters
    ----------
    admittance : Y (n,) in siemens at ω (n,) in rad/s, smooth
    points : frequencies (n,) Hz and impedances (n,) ohm, for capacitance and loss at low frequency
    overtone : pole of the second radial mode of a disk, from which σ follows; the σ of `piece` is taken where None
    noise : (n,) relative standard deviation of the impedances, sqrt(E|δZ/Z|²); None for a curve without noise
    """
    band = (float(points[0][0]), float(points[0][-1]))
    lossy = pole.loss > LEAST_LOSS and zero.loss > LEAST_LOSS
    if lossy:
        found = characteristic_frequencies(admittance, pole.eigenvalue, zero.eigenvalue, band)
    else:  # without loss there are no maxima: fs = fm = fr and fp = fn = fa
        low, high = pole.frequency_Hz, zero.frequency_Hz
        found = CharacteristicFrequencies(low, high, low, high, low, high, None, None, None)
    fs, fp = found.fs or pole.frequency_Hz, found.fp or zero.frequency_Hz
    piece, notes = _with_poisson(piece, pole, overtone)
    values = {name: getattr(found, name) for name in found.names()}
    values["k_eff"] = float(np.sqrt(1 - (fs / fp) ** 2)) if fp > fs else None
    free, low = _free_capacitance(points, piece, fs, fp)
    stated = None if free is None else free * piece.share(STATED, fs, fp)
    values |= {
        "Qm_3dB": found.Q_series,
        "Qm_Z": _quality(found, fs, fp, free),
        "Qm_pole": pole.quality_factor if lossy else None,
        "Qm_zero": zero.quality_factor if lossy else None,
        "C_T": stated,
        "tan_delta": low.tangent,
        **piece.figures(fs, fp, free),
    }
    known = {name: float(value) for name, value in values.items() if value is not None}
    relative = 0.0 if noise is None else _deviation_between(low.frequency_Hz, points[0], noise) / np.sqrt(2)
    return CurveFigures(
        known, notes + low.notes, piece.poisson, _reading_deviations(known, relative, low.frequency_Hz == STATED)
    )


def _deviation_between(at: float, frequency: np.ndarray, noise: np.ndarray) -> float:
    """Deviation at a frequency of the straight line between the readings on both sides, of deviations `noise`."""
    behind = int(np.clip(np.searchsorted(frequency, at), 1, frequency.size - 1))
    share = (at - frequency[behind - 1]) / (frequency[behind] - frequency[behind - 1])
    return float(np.hypot((1 - share) * noise[behind - 1], share * noise[behind]))


def _reading_deviations(values: dict[str, float], relative: float, at_stated: bool) -> dict[str, float]:
    """Deviations of C, ε and tan δ, where the real and the imaginary part of one reading have a relative one.

    at_stated : whether C was read at `STATED`; extrapolated to it C and ε have the error of a formula, which is larger
    """
    if not relative:
        return {}
    read = ("C_T", "eps33T", "eps11T") if at_stated else ()
    found = {name: abs(values[name]) * relative for name in read if name in values}
    return found | ({"tan_delta": relative} if "tan_delta" in values else {})


def standard_figures(
    piece: Piece,
    measured: CurveFigures,
    pole: Resonance,
    zero: Resonance,
    model: CurveFigures | None = None,
    constants: PiezoConstants | None = None,
    body: CurveFigures | None = None,
) -> StandardFigures:
    """The figures of a sweep together with those of a finite element model.

    Parameters
    ----------
    measured, model : of the measured and of the computed curve; None where there is no computed one
    pole, zero : measured; the frequencies have their standard deviations, to first order in the loss
    constants : of the material, from which the curve of the model was computed
    body : of a curve with these constants of the body alone, as the formulas take it; `model` where None
    """
    body = body or model
    material = {} if constants is None else material_figures(constants)
    deviations = _deviations(measured, pole, zero)
    names = [*measured.values, *(name for name in (model.values if model else {}) if name not in measured.values)]
    by_formula = piece.figures(1.0, 1.2, 1.0)
    figures = []
    for name in sorted(names, key=list(MEANING).index):
        has_formula = name in by_formula and name in material
        computed = None if model is None else model.values.get(name)
        # a σ that is taken from the material has no error of a formula
        alone = None if body is None else body.values.get(name)
        has_error = has_formula and alone is not None and material[name] and alone != material[name]
        error = alone / material[name] - 1 if has_error else None
        reference = material[name] if has_formula else computed
        value, std = measured.values.get(name), deviations.get(name)
        figures.append(Figure(name, *MEANING[name], value, std, reference, error))
    return StandardFigures(WORDS[piece.kind], tuple(figures), piece.aspect, measured.notes)


def _deviations(measured: CurveFigures, pole: Resonance, zero: Resonance) -> dict[str, float]:
    """Standard deviations of the frequencies and of 1/η from those of pole and zero, and those of the reading."""
    found = dict(measured.std)
    for one, names, quality in ((pole, ("fs", "fm", "fr"), "Qm_pole"), (zero, ("fp", "fn", "fa"), "Qm_zero")):
        if one.std_Hz is not None:
            found |= {name: one.std_Hz for name in names if name in measured.values}
            found[quality] = float(one.std_loss / one.loss**2)
    return found


@dataclass(frozen=True)
class _Low:
    """Result of the low end of a sweep: frequency, loss tangent, None where that is above `_LOW` fs, and notes."""

    frequency_Hz: float
    tangent: float | None
    notes: tuple[str, ...]


def reads_stated(frequency: np.ndarray, fs: float) -> bool:
    """Whether the capacitance at `STATED` can be read off a sweep (n,), Hz, of a body that resonates at fs."""
    return bool(frequency[0] <= STATED <= min(_LOW * fs, frequency[-1]))


def _free_capacitance(points, piece: Piece, fs: float, fp: float) -> tuple[float | None, _Low]:
    """C^T, F, extrapolated to zero frequency by the formula of the body; loss tangent and notes."""
    frequency, impedance = points
    y = 1 / impedance
    at = STATED if reads_stated(frequency, fs) else float(frequency[0])
    capacitance = float(np.interp(at, frequency, y.imag / (2 * np.pi * frequency)))
    if frequency[0] >= 0.97 * fs or capacitance <= 0:
        note = "the sweep starts at a resonance, so it gives no capacitance and no figure that depends on it"
        return None, _Low(at, None, (note,))
    tangent = float(np.interp(at, frequency, y.real / y.imag)) if at <= _LOW * fs else None
    if piece.kind in ("thickness plate", "higher mode") and at > _LOW * fs:
        note = "other modes lie below this one, and the sweep does not begin below them, so it gives no capacitance"
        return None, _Low(at, tangent, (note,))
    notes = ()
    if at != STATED:
        covered = frequency[0] <= STATED <= frequency[-1]
        why = "1 kHz is not far below the resonance" if covered else "the sweep does not include 1 kHz"
        way = (
            "the formula of the body"
            if piece.kind not in ("other", "higher mode", "thickness plate")
            else "that of a single mode"
        )
        notes = (f"{why}: the capacitance at {hertz(at)} Hz was extrapolated there by {way}",)
    return capacitance / piece.share(at, fs, fp), _Low(at, tangent, notes)


def _quality(found: CharacteristicFrequencies, fs: float, fp: float, free: float | None) -> float | None:
    """Qm = fp²/[2π fm |Z(fm)| C^T (fp² − fs²)] (EN 50324-2)."""
    if free is None or found.Z_series is None or not fp > fs:
        return None
    return float(fp**2 / (2 * np.pi * found.fm * found.Z_series * free * (fp**2 - fs**2)))


def _with_poisson(piece: Piece, pole: Resonance, overtone: Resonance | None) -> tuple[Piece, tuple[str, ...]]:
    """The piece, a disk with σ from its second radial mode if the sweep holds it; and a note if not."""
    if piece.kind != "disk":
        return piece, ()
    ratio = overtone.frequency_Hz / pole.frequency_Hz if overtone is not None else 0.0
    poisson = disk_poisson(ratio) if _SECOND_RADIAL[0] < ratio < _SECOND_RADIAL[1] else None
    if poisson is None:
        words = "is that of the material, as the sweep includes no second radial mode"
        return piece, (f"the planar Poisson ratio {piece.poisson:.4g} {words}",)
    return replace(piece, poisson=poisson), ()


def is_second_radial(pole: Resonance, other: Resonance) -> bool:
    """Whether a pole may be the second radial mode of a disk with this first one."""
    return _SECOND_RADIAL[0] < other.frequency_Hz / pole.frequency_Hz < _SECOND_RADIAL[1]
