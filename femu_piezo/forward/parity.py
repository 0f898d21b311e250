"""Modes of a plate that its terminals do not drive: the other parity classes of a part with mirror planes.

About every mirror plane of a plate the driven field has a definite parity. Opposite parity at some of the planes gives
the other parity classes of the whole plate, on the same part and mesh: at a flipped plane the normal displacement u_n
is free and the other displacements vanish; the potential vanishes if it is free in the driven class, and is free if it
vanishes there. Both electrodes are at zero potential. Operators without the symmetry (a spot of mass, a crack) couple
the classes; all classes together are the whole plate, at the cost of its part (Bossavit, Comput. Methods Appl. Mech.
Eng. 56, 1986, 167).
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import scipy.sparse as sp
import scipy.sparse.linalg as spla

from femu_piezo.errors import ConvergenceError
from femu_piezo.forward.electrodes import boundary_dofs
from femu_piezo.forward.free_pattern import FreePattern
from femu_piezo.forward.gradient_products import FIELDS
from femu_piezo.forward.linear_solver import Factorization, factorize
from femu_piezo.forward.model import POTENTIAL_SCALE, ElectroelasticModel
from femu_piezo.material.constants import ElasticForm

#: Number of modes computed first; it is doubled until the band is covered.
_COUNT = 30
#: Relative error of the eigenvalue by which a further mode is looked for; one beyond this many times the top is none.
_ROUGH, _ABOVE = 1e-2, 1.1
#: Relative error of an eigenvalue; the error of a Galerkin model on a basis of the modes is its square.
_TOLERANCE = 1e-6


class ParityClass:
    """The short-circuited operator of one parity class in the free unknowns of that class.

    Parameters
    ----------
    constants : e-form; their real parts are used
    flipped : axes of the mirror planes at which the parity is the opposite of the driven field's; () for the
        driven class itself, short-circuited

    Raises
    ------
    ValueError : the part has no mirror plane normal to such an axis
    """

    def __init__(self, model: ElectroelasticModel, constants: ElasticForm, flipped: Iterable[int]) -> None:
        p = self.prolongation = class_prolongation(model, tuple(flipped))
        tensor = np.tensordot(constants.vector().real, model.unit_tensors, axes=1)
        self.stiffness = FreePattern(model.assembled, p, electrode=False).stiffness(tensor)
        self.mass = (p.T @ model.assembled.mass_matrix(model.density) @ p).tocsr()
        # with three mirror planes a class has at most one rigid-body mode, and pairs are in two classes
        self._repeated = len(set(model.domain.symmetry.values())) < 3

    def factor(self, shift: float) -> Factorization:
        """Factorisation of K − shift · M of the class."""
        return factorize(self.stiffness - shift * self.mass)

    def modes(self, top: float) -> np.ndarray:
        """(4n, k) fields of all modes with ω² below `top`, rigid-body modes included, uᵗMu = 1 on the part."""
        return self.prolongation @ modes_below(self.stiffness, self.mass, top, repeated=self._repeated)


def modes_below(stiffness: sp.csr_matrix, mass: sp.csr_matrix, top: float, *, repeated: bool = False) -> np.ndarray:
    """(m, k) all modes of a real pencil (m, m) with ω² below `top`, rigid-body modes included, uᵗMu = 1.

    repeated : whether several modes may have one frequency, as rigid-body modes and the pairs of a square. Of those a
        search finds only some: searches among what is orthogonal to the modes found follow until one finds no more.

    Raises
    ------
    ConvergenceError : ARPACK did not converge, or the modes of the band are about a quarter of the unknowns or more
    """
    size, shift = stiffness.shape[0], 0.3 * top
    factor = factorize(stiffness - shift * mass)
    modes, rng = np.zeros((size, 0)), np.random.default_rng(1)

    def outside(right: np.ndarray) -> np.ndarray:
        """(m,) (K − shift M)^-1 right without its part along the modes found."""
        found = factor.solve(right)
        return found - modes @ (modes.T @ (mass @ found))

    inverse = spla.LinearOperator(stiffness.shape, matvec=outside, dtype=float)

    def nearest(count: int, tolerance: float) -> tuple[np.ndarray, np.ndarray]:
        """ω² (count,) of the further modes nearest to the shift, and the modes (m, count)."""
        start, ncv = inverse @ (mass @ rng.standard_normal(size)), 2 * count + 4
        try:
            values, vectors = spla.eigsh(
                stiffness, count, M=mass, sigma=shift, OPinv=inverse, v0=start, tol=tolerance, ncv=ncv
            )
        except spla.ArpackNoConvergence as error:
            raise ConvergenceError(f"modes of one symmetry: {error}; narrow the band") from error
        return values, vectors / np.sqrt(np.einsum("ik,ik->k", vectors, mass @ vectors))

    count = min(_COUNT, size // 8)
    # the modes nearest to the shift: once one lies above the top, all frequencies below are found, as the shift is at
    # 0.3 top
    while (first := nearest(count, _TOLERANCE))[0].max() <= top:
        if count >= size // 4:
            raise ConvergenceError("the mesh is too coarse for the modes of one symmetry in this band")
        count *= 2
    values, modes = first
    while repeated and nearest(1, _ROUGH)[0][0] < _ABOVE * top:
        value, mode = nearest(1, _TOLERANCE)
        if value[0] >= top:
            break
        values, modes = np.append(values, value), np.concatenate([modes, mode], axis=1)
    return modes[:, values < top]


def class_prolongation(model: ElectroelasticModel, flipped: tuple[int, ...]) -> sp.csr_matrix:
    """(4n, m) from the free unknowns of a class to all degrees of freedom; potentials scaled as in the model."""
    domain, basis, n = model.domain, model.basis, model.basis.N
    if not set(flipped) <= set(domain.symmetry.values()):
        raise ValueError(f"the part has mirror planes normal to {sorted(domain.symmetry.values())}, not to {flipped}")
    held = np.zeros((FIELDS, n), dtype=bool)
    for name, axis in domain.symmetry.items():
        nodes, antisymmetric_potential = boundary_dofs(basis, (name,)), name in domain.ground
        if axis in flipped:
            held[np.ix_([other for other in range(3) if other != axis], nodes)] = True
        else:
            held[axis, nodes] = True
        held[3, nodes] |= antisymmetric_potential != (axis in flipped)
    electrodes = [*domain.hot, *(name for name in domain.ground if name not in domain.symmetry)]
    held[3, boundary_dofs(basis, tuple(electrodes))] = True
    free = np.flatnonzero(~held.ravel())
    scale = np.where(free >= 3 * n, POTENTIAL_SCALE, 1.0)
    return sp.csr_matrix((scale, (free, np.arange(free.size))), shape=(FIELDS * n, free.size))
