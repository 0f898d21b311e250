"""Model order by evidence: which modes and how much background a sweep supports."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from femu_piezo.extraction.covariance import fisher_spread
from femu_piezo.extraction.fit import ROUNDING, Fit, SweepData, correlation, fit, solve_linear
from femu_piezo.extraction.model import RationalModel

MAX_BACKGROUND = 12
MAX_LOSS = 0.3  # beyond η = 0.3 a term is background, not a resonance
MAX_SYSTEMATIC = 0.05  # relative size up to which a smooth misfit may be the instrument's or the model's
KEEP_SIGMA = 10.0  # a mode whose residue is beyond so many standard deviations needs no removal test
MAX_PHASE = np.pi / 4  # of a residue: the loss angles of a material turn it by far less
SCAN_FREQUENCIES = 160
SCAN_WIDTHS = 8
MAX_SCAN_POINTS = 2000


@dataclass(frozen=True)
class Candidate:
    """One model order that was tried.

    Attributes
    ----------
    modes : number of poles M
    background_degree : degree d of the background polynomial
    misfit : Σ|residual|²
    evidence : Bayesian information criterion (`evidence`), smaller is better
    poles : (M,) complex λ, rad²/s²
    """

    modes: int
    background_degree: int
    misfit: float
    evidence: float
    poles: np.ndarray


def evidence(result: Fit, data: SweepData) -> float:
    """Bayesian information criterion of a fit, N ln(S/n) + k ln(N) · N/(N − k − 1) − 2 Σ ln weight²; less is better.

    N = 2n real data, k real parameters: −2 ln of the likelihood of the relative errors with the noise level
    profiled out, plus Schwarz's penalty with the small-sample factor of Hurvich and Tsai (1989). S is Σ|r|² for
    white noise, or the innovation of a first-order autoregression with two more parameters where that describes
    the residual better (`correlation`) and is below `MAX_SYSTEMATIC` in size: a systematic error of instrument
    or model is then not taken for modes.
    Here r = weight · ln(charge_model/charge_data), whose noise is the same however wrong the model is.
    Rounding of double precision counts as noise.
    """
    n, k = len(data), 2 * result.model.size
    r = data.weight * np.log(result.model.charge(data.x) / data.charge)
    floor = ROUNDING**2 * float(np.sum(data.weight**2))
    shape = 2 * float(np.sum(np.log(data.weight**2)))
    options = [(float(np.sum(np.abs(r) ** 2)), k)]
    if np.mean(np.abs(r / data.weight) ** 2) < MAX_SYSTEMATIC**2:
        options.append((correlation(r)[1], k + 2))
    return min(
        (
            2 * n * np.log((misfit + floor) / n) + size * np.log(2 * n) * 2 * n / (2 * n - size - 1) - shape
            for misfit, size in options
            if size + 1 < 2 * n
        ),
        default=np.inf,
    )


def is_passive(model: RationalModel) -> bool:
    """No pole inside the sweep draws power the wrong way: |arg| of its residue stays below `MAX_PHASE`.

    The residue of Y/(jω) in λ is a positive number turned by the loss angles of the material; a pole that only
    soaks up an error of the instrument has any phase. Broad terms (η > MAX_LOSS) are background and free.
    """
    value = model.axis.eigenvalue(model.poles)
    inside = (np.abs(model.poles.real) <= 1) & (value.imag > 0) & (value.imag < MAX_LOSS * value.real)
    residue = model.residues
    return bool(np.all(np.abs(np.angle(residue[inside])) <= MAX_PHASE))


def search(data: SweepData, max_modes: int, start: RationalModel | None = None) -> tuple[Fit, list[Candidate]]:
    """Grow modes and background while the evidence grows, then try to remove each mode and degree again.

    Returns the chosen fit and every order tried. At each step the moves "one more mode, where a scan of the
    residual finds most to explain" and "one, two or three more background degrees" compete by `evidence`;
    models that are not passive are not considered.
    """
    tried: list[Candidate] = []
    nothing = np.zeros(0, complex)
    first = start or RationalModel(data.axis, data.scale, nothing, nothing, np.zeros(2, complex))
    best = _record(_refit(first, data), data, tried)
    while True:
        moves = [_record(f, data, tried) for f in _moves(best, data, max_modes)]
        top = min(moves, key=lambda f: evidence(f, data), default=best)
        if evidence(top, data) >= evidence(best, data):
            break
        best = top
    return _prune(best, data, tried), tried


def widen(model: RationalModel, extra: int) -> RationalModel:
    """The same model with `extra` more background degrees, at zero."""
    return replace(model, background=np.concatenate([model.background, np.zeros(extra, complex)]))


def _moves(current: Fit, data: SweepData, max_modes: int) -> list[Fit]:
    model, n = current.model, len(data)
    out = []
    if model.poles.size < max_modes and model.size + 2 < n:
        out.append(fit(_add_pole(current, data), data))
    for extra in (1, 2, 3):
        if model.background.size - 1 + extra <= MAX_BACKGROUND and model.size + extra < n:
            out.append(_refit(widen(model, extra), data))
    return [f for f in out if is_passive(f.model)]


def _prune(best: Fit, data: SweepData, tried: list[Candidate]) -> Fit:
    while True:
        model = best.model
        fewer = [
            replace(model, poles=np.delete(model.poles, m), residues=np.delete(model.residues, m))
            for m in np.flatnonzero(_significance(best, data) < KEEP_SIGMA)
        ]
        if model.background.size > 1:
            fewer.append(replace(model, background=model.background[:-1]))
        trials = [_record(_refit(m, data), data, tried) for m in fewer]
        trials = [f for f in trials if is_passive(f.model)]
        top = min(trials, key=lambda f: evidence(f, data), default=best)
        if evidence(top, data) >= evidence(best, data):
            return best
        best = top


def _significance(result: Fit, data: SweepData) -> np.ndarray:
    """(M,) |residue| in units of its standard deviation."""
    m = result.model.poles.size
    factor = fisher_spread(result.model, data, result.scale).factor
    return np.abs(result.model.residues) / np.linalg.norm(factor[m : 2 * m], axis=1)


def _refit(model: RationalModel, data: SweepData) -> Fit:
    linear = solve_linear(model, data)
    return fit(linear.model, data) if model.poles.size else linear


def _add_pole(current: Fit, data: SweepData) -> RationalModel:
    """The model with one more pole where the linearised misfit drops most (a score scan).

    Every trial pole is an atom weight/(charge (z − x)); its gain is |⟨a⊥, r⟩|²/‖a⊥‖² after projection onto
    the complement of what the current model can already follow.
    """
    model = current.model
    pick = np.unique(np.linspace(0, len(data) - 1, min(len(data), MAX_SCAN_POINTS)).astype(int))
    x, row = data.x[pick], (data.weight / data.charge)[pick]
    basis, _ = np.linalg.qr(row[:, None] * model.jacobian(x))
    r = current.residual[pick]
    r = r - basis @ (basis.conj().T @ r)
    best_gain, best_z = -1.0, 0j
    for z in _trial_poles(x):
        atoms = row[:, None] / (z - x[:, None])
        atoms = atoms - basis @ (basis.conj().T @ atoms)
        gain = np.abs(atoms.conj().T @ r) ** 2 / np.sum(np.abs(atoms) ** 2, axis=0)
        k = int(np.argmax(gain))
        if gain[k] > best_gain:
            best_gain, best_z = float(gain[k]), complex(z[k])
    grown = replace(model, poles=np.append(model.poles, best_z), residues=np.append(model.residues, 0j))
    return solve_linear(grown, data).model


def _trial_poles(x: np.ndarray) -> list[np.ndarray]:
    """Trial positions, one array per half-width: from the point spacing up to a quarter of the sweep."""
    spacing = float(np.median(np.diff(x)))
    widths = np.geomspace(spacing / 2, 0.5, SCAN_WIDTHS)
    centres = np.interp(np.linspace(0, x.size - 1, SCAN_FREQUENCIES), np.arange(x.size), x)
    return [centres + 1j * width for width in widths]


def _record(result: Fit, data: SweepData, tried: list[Candidate]) -> Fit:
    model = result.model
    poles = data.axis.eigenvalue(model.poles)
    tried.append(Candidate(model.poles.size, model.background.size - 1, result.misfit, evidence(result, data), poles))
    return result
