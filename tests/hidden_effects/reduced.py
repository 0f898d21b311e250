"""Impedance of a `Body` with surfaces over a sweep, from few vibration modes and static responses instead of all
unknowns.

The basis of each parity class holds the lossless short-circuit modes up to a multiple of the highest frequency, the
changes of the shapes of modes in the band by losses and surfaces, and static responses: to the voltage (twice) and to a
few patterns of load on every surface, among them the loads by modes of the driven class. The potential is eliminated
exactly at the complex constants. `cutoff=None` keeps all unknowns: the full solution with which the tests compare.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import scipy.linalg as sl
import scipy.sparse as sp
from scipy.interpolate import BarycentricInterpolator
from scipy.sparse.linalg import LinearOperator, eigsh

from hidden_effects.body import Body, ParityClass, Surface
from hidden_effects.ritz import e_form
from hidden_effects.round_body import RoundBody, RoundClass, RoundSurface

Part = ParityClass | RoundClass
Theta = np.ndarray | Callable[[float], np.ndarray]
#: Nodes of the interpolation over frequency, frequencies solved at once, unknowns above which Lanczos is faster.
_NODES, _BATCH, _MANY = 12, 32, 2500


def _constants(theta: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """c11 c12 c13 c33 c44, e31 e33 e15, ε11S ε33S of d-form constants (10,)."""
    c, e, eps = e_form(np.asarray(theta))
    return (
        np.array([c[0, 0], c[0, 1], c[0, 2], c[2, 2], c[3, 3]]),
        np.array([e[2, 0], e[2, 2], e[0, 4]]),
        np.array([eps[0], eps[2]]),
    )


class _Reduced:
    """One parity class on its basis."""

    def __init__(self, part: Part, theta, surfaces, top: float, cutoff: float | None, driven) -> None:
        """driven : `shapes` of the driven class; empty for the driven class itself"""
        self.dielectric = part.dielectric
        factors = [part.factor(surface) for surface in surfaces]
        basis, self.shapes = np.eye(part.displacements), []
        if cutoff is not None:
            basis, self.shapes = _basis(part, theta, factors, top, cutoff, driven)
        self.elastic = np.array([basis.T @ a @ basis for a in part.elastic])
        self.coupling = np.array([basis.T @ a for a in part.coupling])
        self.mass = basis.T @ part.mass @ basis
        self.factors = [basis.T @ b for b in factors]
        self.size = basis.shape[1]

    def operator(self, theta: np.ndarray) -> np.ndarray:
        """(r + 1, r + 1) complex symmetric operator over displacements and volt, without inertia."""
        return _condensed(self.elastic, self.coupling, self.dielectric, _constants(theta))


def _condensed(elastic, coupling, dielectric, constants) -> np.ndarray:
    """Operator of displacements and volt, with the inner potentials eliminated."""
    c, e, eps = constants
    r, m = elastic.shape[1], dielectric.shape[1] - 1
    stiffness, piezo = np.tensordot(c, elastic, axes=1), np.tensordot(e, coupling, axes=1)
    potential = -np.tensordot(eps, dielectric, axes=1)
    found = np.empty((r + 1, r + 1), dtype=np.result_type(stiffness, potential))
    found[:r, :r], found[:r, r], found[r, :r], found[r, r] = stiffness, piezo[:, m], piezo[:, m], potential[m, m]
    side = np.concatenate([piezo[:, :m], potential[m:, :m]])
    # a real potential matrix is lossless, and its negative then positive definite
    kind = "sym" if np.iscomplexobj(potential) else "pos"
    found += side @ sl.solve(-potential[:m, :m], side.T, assume_a=kind)
    return found


def _loads(part: Part, theta: np.ndarray, states: np.ndarray) -> np.ndarray:
    """Forces (n, k + 1) of displacements (n, k) and of the volt at complex constants."""
    c, e, eps = _constants(theta)
    piezo, potential = np.tensordot(e, part.coupling, axes=1), -np.tensordot(eps, part.dielectric, axes=1)
    charges = np.concatenate([piezo[:, :-1].T @ states, potential[:-1, -1:]], axis=1)
    forces = np.concatenate([np.tensordot(c, part.elastic @ states, axes=1), piezo[:, -1:]], axis=1)
    return forces - piezo[:, :-1] @ sl.solve(potential[:-1, :-1], charges, assume_a="sym")


def _basis(part: Part, theta: np.ndarray, factors, top: float, cutoff: float, driven) -> tuple[np.ndarray, list]:
    """Basis (n, r), orthonormal in the mass, and how its modes in the band move each surface, (g, k)."""
    constants = _constants(np.asarray(theta).real)
    lossless = _condensed(part.elastic, part.coupling, part.dielectric, constants)[:-1, :-1]
    shifted = sl.cho_factor(lossless + (0.5 * top) ** 2 * part.mass)
    values, modes = _modes(lossless, part.mass, shifted, top, cutoff)
    inner = modes[:, values < (1.3 * top) ** 2]
    loads = _loads(part, theta, inner)
    further = [sl.cho_solve(shifted, loads[:, :-1].imag)]  # changes of the shapes of modes by losses
    if part.driven:
        first = sl.cho_solve(shifted, np.stack([loads[:, -1].real, loads[:, -1].imag], axis=1))
        further += [first, sl.cho_solve(shifted, part.mass @ first)]
    shapes = [factor.T @ inner for factor in factors]
    for factor, shape in zip(factors, shapes, strict=True):
        answers = sl.cho_solve(shifted, factor)
        squares, patterns = sl.eigh(answers @ answers.T, subset_by_index=(max(0, len(answers) - 6), len(answers) - 1))
        further.append(patterns[:, squares > (3e-3) ** 2 * squares[-1]])
        further.append(sl.cho_solve(shifted, factor @ shape))
    further += [sl.cho_solve(shifted, factor @ shape) for factor, shape in zip(factors, driven, strict=False)]
    extra = np.concatenate(further, axis=1)
    norm = np.sqrt(np.einsum("ik,ik->k", extra, part.mass @ extra))
    extra = extra[:, norm > 0] / norm[norm > 0]
    for _ in range(2):
        extra = extra - modes @ (modes.T @ (part.mass @ extra))
    gram = extra.T @ part.mass @ extra
    size, rotation = np.linalg.eigh((gram + gram.T) / 2)
    keep = size > 1e-10
    return np.concatenate([modes, extra @ (rotation[:, keep] / np.sqrt(size[keep]))], axis=1), shapes


def _modes(lossless, mass, shifted, top: float, cutoff: float) -> tuple[np.ndarray, np.ndarray]:
    """Squared angular frequencies and shapes (n, k) of all modes up to the cutoff; by Lanczos if n is large."""
    limit = (cutoff * top) ** 2
    if len(mass) < _MANY:
        return sl.eigh(lossless, mass, subset_by_value=(-np.inf, limit))
    inverse = LinearOperator(mass.shape, matvec=lambda b: sl.cho_solve(shifted, b, check_finite=False))
    weight, start, count = sp.csr_matrix(mass), np.ones(len(mass)), 40
    while True:
        values, modes = eigsh(lossless, count, weight, sigma=-((0.5 * top) ** 2), OPinv=inverse, v0=start)
        if values.max() > limit:
            return values[values < limit], modes[:, values < limit]
        count *= 2


class Plate:
    """A body with surfaces, ready to be swept up to a frequency.

    Parameters
    ----------
    theta : (10,) d-form constants that the basis is made for
    top_Hz : highest frequency of the sweeps
    cutoff : highest mode of the basis over top_Hz; None: all unknowns
    """

    def __init__(
        self,
        body: Body | RoundBody,
        theta: np.ndarray,
        top_Hz: float,
        surfaces: Sequence[Surface] | Sequence[RoundSurface] = (),
        cutoff: float | None = 2.5,
    ) -> None:
        self._surfaces = tuple(surfaces)
        top = 2 * np.pi * top_Hz
        signs = body.classes(surfaces)
        self._parts: list[_Reduced] = []
        for of_class in signs:  # the driven class first
            shapes = self._parts[0].shapes if self._parts else []
            self._parts.append(_Reduced(body.part(of_class), theta, surfaces, top, cutoff, shapes))
        self.size = sum(part.size for part in self._parts)
        self._mass = sl.block_diag(*(part.mass for part in self._parts))
        self._forms = []
        for index in range(len(self._surfaces)):
            whole = np.concatenate([part.factors[index] for part in self._parts])
            self._forms.append(whole @ whole.T)

    def operator(self, theta: np.ndarray) -> np.ndarray:
        """(r + 1, r + 1) operator of all classes, the volt last."""
        found = np.zeros((self.size + 1, self.size + 1), dtype=complex)
        start = 0
        for part in self._parts:
            block = part.operator(theta)
            rows = np.concatenate([np.arange(start, start + part.size), [self.size]])
            found[np.ix_(rows, rows)] += block
            start += part.size
        return found

    def impedance(self, theta: Theta, frequency: np.ndarray) -> np.ndarray:
        """Z (k,), ohm, of constants (10,) or of a law: frequency in Hz → constants."""
        omega = 2 * np.pi * np.asarray(frequency, float)
        if callable(theta):
            nodes, weights = _nodes(omega)
            operators = np.array([self.operator(theta(w / (2 * np.pi))) for w in nodes])
        else:
            operators, weights = self.operator(theta)[None], np.ones((omega.size, 1))
        found = np.empty(omega.size, dtype=complex)
        flat = operators.reshape(len(operators), -1)
        coefficients = [surface.coefficient(omega) for surface in self._surfaces]
        for rows in np.array_split(np.arange(omega.size), max(1, omega.size // _BATCH)):
            matrix = (weights[rows] @ flat).reshape(-1, self.size + 1, self.size + 1)
            matrix[:, :-1, :-1] -= omega[rows, None, None] ** 2 * self._mass
            for values, form in zip(coefficients, self._forms, strict=True):
                matrix[:, :-1, :-1] += values[rows, None, None] * form
            inner = np.linalg.solve(matrix[:, :-1, :-1], matrix[:, :-1, -1:])[:, :, 0]
            charge = -(matrix[:, -1, -1] - np.einsum("ki,ki->k", matrix[:, -1, :-1], inner))
            found[rows] = 1 / (1j * omega[rows] * charge)
        return found


def _nodes(omega: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Chebyshev nodes in log ω and the weights (k, nodes) that interpolate from them."""
    low, high = np.log([omega.min(), omega.max()])
    at = (low + high) / 2 + (high - low) / 2 * np.cos(np.pi * (np.arange(_NODES) + 0.5) / _NODES)
    return np.exp(at), BarycentricInterpolator(at, np.eye(_NODES))(np.log(omega))
