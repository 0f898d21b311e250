"""Local compliance of a face under a small patch, beyond that of the modes of a reduced body.

On a plate of infinite extent a force over a face is a sum of waves e^(jk·x), each of which drives the modes through the
thickness at that k. The modes of a body below a frequency Ω include those with ω < Ω; all others yield as if static,

    C(k) = Σ_(ω > Ω) |u(t/2)|²/ω²,

and a unit force spread uniformly over a disk of radius a moves the disk on average by (Hankel transform, twice)

    C(a) = 1/(2π) ∫ C(k) [2 J₁(ka)/(ka)]² k dk.

With all modes and a ≪ t this is the compliance of a half-space, 16 (1 − ν²)/(3π² E a) along the normal of an isotropic
one (Johnson, Contact Mechanics, 1985, section 3.3).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import scipy.linalg as sl
from scipy.interpolate import CubicSpline
from scipy.special import j1

from femu_piezo.effects.effect import EffectContext
from femu_piezo.forward.gradient_products import FIELDS, extended_tensor
from femu_piezo.forward.revolution import Line
from femu_piezo.material.constants import ElasticForm
from femu_piezo.material.voigt import axes_with_poling
from femu_piezo.threads import blas_limit

#: Elements through the thickness, graded towards the faces by halves, and their order.
_ELEMENTS, _ORDER = 6, 4
#: Wavenumbers: the lowest over 1/t, the highest over 1/a, where the transform of the disk has decayed, their number.
_LOWEST, _HIGHEST, _COUNT = 1e-2, 30.0, 120
#: Number of radii between which C is interpolated.
_RADII = 16


@dataclass(frozen=True)
class FaceCompliance:
    """C(a) along x, y and z of patches between two radii; computed when it is first asked for.

    Attributes
    ----------
    constants : (10,) of the e-form, of which the real parts are used
    poling_axis : the axis (0, 1, 2) of the poling
    covered : whether both faces are short-circuited electrodes, else they are bare
    density : kg/m³;  thickness : m
    cutoff_omega : Ω, rad/s
    radii : the smallest and the largest patch, m
    """

    constants: tuple[complex, ...]
    poling_axis: int
    covered: bool
    density: float
    thickness: float
    cutoff_omega: float
    radii: tuple[float, float]

    @classmethod
    def of(cls, context: EffectContext, cutoff_omega: float, radii: tuple[float, float]) -> FaceCompliance:
        """Of the faces of a specimen, without the modes below Ω = `cutoff_omega`."""
        constants = tuple(context.constants.to_e_form().vector().tolist())
        axis, covered = context.poling_axis, context.field_axis == 2
        return cls(constants, axis, covered, context.density, context.height, cutoff_omega, radii)

    @property
    def _log(self) -> CubicSpline:
        return _log_compliance(self)

    def stiffness(self, radius: float) -> tuple[np.ndarray, np.ndarray]:
        """1/C (3,) along x, y, z, N/m, and its slopes in the radius."""
        log = np.log(radius)
        found = np.exp(-self._log(log))
        return found, -found * self._log(log, 1) / radius


@lru_cache(maxsize=64)
def _log_compliance(of: FaceCompliance) -> CubicSpline:
    """Spline log a → log C (3,)."""
    k = np.geomspace(_LOWEST / of.thickness, _HIGHEST / of.radii[0], _COUNT)
    with blas_limit():
        yielding = yielding_beyond(of, k)
    at = np.geomspace(*of.radii, _RADII)
    disk = (2 * j1(k * at[:, None]) / (k * at[:, None])) ** 2
    found = np.trapezoid(disk[:, :, None] * (yielding * k[:, None] ** 2), np.log(k), axis=1) / (2 * np.pi)
    return CubicSpline(np.log(at), np.log(found))


def yielding_beyond(of: FaceCompliance, k: np.ndarray) -> np.ndarray:
    """C(k) (m, 3) along x, y, z at wavenumbers (m,), m³/N: the mean of waves along x and along y."""
    rotation = axes_with_poling(np.eye(3)[of.poling_axis])
    tensor = extended_tensor(ElasticForm.from_vector(np.array(of.constants)), rotation).real
    along = _Waves(of, tensor, 0)
    first = np.array([along.yielding(wavenumber) for wavenumber in k])
    if of.poling_axis == 2:  # waves along y are those along x with the axes exchanged
        return (first + first[:, [1, 0, 2]]) / 2
    other = _Waves(of, tensor, 1)
    return (first + np.array([other.yielding(wavenumber) for wavenumber in k])) / 2


class _Waves:
    """Waves along x (0) or y (1): forms on Lagrange elements through the thickness, by powers of k.

    u along the wave is a quarter of a period out of phase with the rest, and so is φ where the wave runs along the
    poling: with these phases taken out all forms are real.
    """

    def __init__(self, of: FaceCompliance, tensor: np.ndarray, axis: int) -> None:
        half = 0.5 ** np.arange(_ELEMENTS // 2 - 1, -1, -1.0)
        ends = of.thickness / 2 * np.concatenate([[0.0], half, 2 - half[-2::-1], [2.0]])
        line = Line(ends, _ORDER)
        points, weights = line.gauss
        values, slopes = (shapes.toarray() for shapes in line.shapes(points))
        n = self._size = line.places.size
        self._mass = sl.block_diag(*[of.density * (values.T * weights) @ values] * 3)
        inner = np.arange(n)[1:-1] if of.covered else np.arange(n)
        self._inner, self._cut = 3 * n + inner, of.cutoff_omega
        phase = np.where([f == axis or (f == 3 and axis == of.poling_axis) for f in range(FIELDS)], 1j, 1.0)
        gradients = {axis: (1j, values, 1), 2: (1.0, slopes, 0)}
        powers = np.zeros((3, FIELDS, n, FIELDS, n), dtype=complex)
        for a, (left_phase, left, left_power) in gradients.items():
            for b, (right_phase, right, right_power) in gradients.items():
                product = np.conj(left_phase) * right_phase * (left.T * weights) @ right
                share = tensor[:, a, :, b] * np.conj(phase)[:, None] * phase
                powers[left_power + right_power] += share[:, None, :, None] * product[None, :, None, :]
        self._powers = powers.real.reshape(3, FIELDS * n, -1)

    def yielding(self, k: float) -> np.ndarray:
        """C(k) (3,) along x, y, z, m³/N."""
        whole = np.tensordot(k ** np.arange(3.0), self._powers, axes=1)
        u, inner = slice(0, 3 * self._size), self._inner
        coupling = whole[inner, u]
        elastic = whole[u, u] - coupling.T @ np.linalg.solve(whole[np.ix_(inner, inner)], coupling)
        values, modes = sl.eigh((elastic + elastic.T) / 2, self._mass)
        on_face, above = modes.reshape(3, self._size, -1)[:, -1], values > self._cut**2
        return np.sum(on_face[:, above] ** 2 / values[above], axis=1)
