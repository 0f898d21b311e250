"""Crowded sweeps with known poles: 10 to 30 modes of Q 20 to 1000 and far modes as a background, independent of
femu_piezo.

    Y/(jω) = C [1 − j tan δ + Σ_m k_m λ_m/(λ_m − ω²)],    λ_m = ω_m² (1 + j/Q_m)

All modes of the sum have this form; those far below and above the sweep are its background. Couplings k_m have random
loss angles, as those of a material have. `loops` says how far each mode stands out of the noise.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.polynomial import chebyshev

from femu_piezo.measurement.spectrum import ImpedanceSpectrum
from tests.noise import circular_noise


@dataclass(frozen=True)
class Crowded:
    """A sweep with its true poles.

    Attributes
    ----------
    spectrum : (n,) points
    poles : (m,) complex λ inside the sweep, rad²/s², by frequency
    loops : (m,) diameter of the loop that a mode adds to log Z, over the relative noise
    certain : (m,) residue over its least standard deviation (Cramér-Rao bound), all other modes and a background of
        degree 8 being unknown; it is low where modes overlap
    """

    spectrum: ImpedanceSpectrum
    poles: np.ndarray
    loops: np.ndarray
    certain: np.ndarray


def _certainty(squares: np.ndarray, charge: np.ndarray, poles: np.ndarray, residues: np.ndarray, noise: float):
    """(m,) |r_m|/std by the Cramér-Rao bound of charge = Σ r/(λ − s) + Σ b T(x) over s (n,), rad²/s², in relative
    noise.
    """
    x = (2 * squares - squares[0] - squares[-1]) / (squares[-1] - squares[0])
    gap = 1 / (poles - squares[:, None])
    columns = np.hstack([-residues * gap**2, gap, chebyshev.chebvander(x, 8)]) / (charge[:, None] * noise)
    size = np.linalg.norm(columns, axis=0)
    deviation = np.linalg.norm(np.linalg.inv(np.linalg.qr(columns / size)[1]), axis=1) / size
    return np.abs(residues) / deviation[poles.size : 2 * poles.size]


def crowded(seed: int, error: float = 0.0) -> Crowded:
    """One draw.

    error : relative size of a smooth error of the instrument added to the noise
    """
    rng = np.random.default_rng([20261122, seed])
    count = int(rng.integers(10, 31))
    low = 50e3
    high = low * rng.uniform(1.5, 4.0)
    inside = low + (high - low) * np.sort(rng.uniform(0.02, 0.98, count))
    far = np.concatenate([rng.uniform(0.2, 0.9, 3) * low, high * (1.1 + np.cumsum(rng.exponential(0.3, 40)))])
    frequency = np.concatenate([inside, far])
    q = np.exp(rng.uniform(np.log(20), np.log(1000), frequency.size))
    poles = (2 * np.pi * frequency) ** 2 * (1 + 1j / q)
    strength = np.exp(rng.uniform(np.log(3e-4), np.log(3e-2), frequency.size))
    coupling = strength * np.exp(1j * rng.normal(0, 0.02, frequency.size))
    points = int(rng.choice([801, 1601, 3201]))
    noise = float(np.exp(rng.uniform(np.log(1e-4), np.log(3e-3))))
    grid = np.linspace(low, high, points)
    scale, tan_delta = 1e-9, rng.uniform(0.003, 0.02)

    def relative_charge(squares: np.ndarray) -> np.ndarray:
        return 1 - 1j * tan_delta + np.sum(coupling * poles / (poles - squares[:, None]), axis=1)

    omega = 2 * np.pi * grid
    z = 1 / (1j * omega * scale * relative_charge(omega**2))
    scatter = circular_noise(points, noise, rng)
    knots = rng.normal(size=(2, 12))
    smooth = np.array([np.interp(np.linspace(0, 11, points), np.arange(12), one) for one in knots])
    z = z * np.exp(scatter + error * (smooth[0] + 1j * smooth[1]))
    inside_poles = poles[:count]
    loop = np.abs(coupling[:count] * inside_poles / inside_poles.imag) / np.abs(relative_charge(inside_poles.real))
    certain = _certainty(omega**2, relative_charge(omega**2), inside_poles, coupling[:count] * inside_poles, noise)
    return Crowded(ImpedanceSpectrum(grid, z), inside_poles, loop / noise, certain)


def matched(found: np.ndarray, true: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Which true poles (m,) are found, and which found ones (k,) are true, paired one to one within a half-width."""
    from scipy.optimize import linear_sum_assignment

    if not found.size or not true.size:
        return np.zeros(true.size, bool), np.zeros(found.size, bool)
    far = np.abs(found[None] - true[:, None]) / true.imag[:, None]
    rows, columns = linear_sum_assignment(np.minimum(far, 2.0))
    close = far[rows, columns] < 1
    hit, right = np.zeros(true.size, bool), np.zeros(found.size, bool)
    hit[rows[close]], right[columns[close]] = True, True
    return hit, right
