"""Model order by evidence: which modes and how much background a sweep supports."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from femu_piezo.extraction.fit import ROUNDING, Fit, SweepData, fit, solve_linear
from femu_piezo.extraction.model import RationalModel

MAX_BACKGROUND = 12
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
    bic : Bayesian information criterion with the noise level profiled out (smaller is better)
    poles : (M,) complex λ, rad²/s²
    """

    modes: int
    background_degree: int
    misfit: float
    bic: float
    poles: np.ndarray


def bic(result: Fit, data: SweepData) -> float:
    """N ln(misfit/n) + k ln(N) · N/(N − k − 1), N = 2n real data, k real parameters.

    −2 ln of the likelihood with the noise *level* profiled out (its *shape* is `data.weight`) plus Schwarz's
    penalty with the small-sample factor of Hurvich and Tsai (1989), which keeps a model from using up a short
    sweep. Rounding of double precision counts as noise: noise-free data do not earn endless terms.
    """
    n, k = len(data), 2 * result.model.size
    if k + 1 >= 2 * n:
        return np.inf
    floor = ROUNDING**2 * float(np.sum(data.weight**2))
    return 2 * n * np.log((result.misfit + floor) / n) + k * np.log(2 * n) * 2 * n / (2 * n - k - 1)


def search(data: SweepData, max_modes: int) -> tuple[Fit, list[Candidate]]:
    """Grow modes and background while the evidence grows, then try to remove each mode again.

    Returns the chosen fit and every order tried. At each step the moves "one more mode, where a scan of the
    residual finds most to explain" and "one, two or three more background degrees" compete by `bic`.
    """
    tried: list[Candidate] = []
    empty = RationalModel(
        data.axis, data.scale, np.zeros(0, complex), np.zeros(0, complex), np.zeros(2, complex)
    )
    best = _record(solve_linear(empty, data), data, tried)
    while True:
        moves = [_record(f, data, tried) for f in _moves(best, data, max_modes)]
        if not moves:
            break
        top = min(moves, key=lambda f: bic(f, data))
        if bic(top, data) >= bic(best, data):
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
            wider = solve_linear(widen(model, extra), data)
            out.append(fit(wider.model, data) if model.poles.size else wider)
    return out


def _prune(best: Fit, data: SweepData, tried: list[Candidate]) -> Fit:
    improved = True
    while improved and best.model.poles.size:
        improved = False
        for m in range(best.model.poles.size):
            fewer = replace(
                best.model, poles=np.delete(best.model.poles, m), residues=np.delete(best.model.residues, m)
            )
            trial = _record(fit(solve_linear(fewer, data).model, data), data, tried)
            if bic(trial, data) < bic(best, data):
                best, improved = trial, True
                break
    return best


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
    tried.append(
        Candidate(model.poles.size, model.background.size - 1, result.misfit, bic(result, data), poles)
    )
    return result
