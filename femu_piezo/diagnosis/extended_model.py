"""`ExtendedModel`: a reduced model that also knows the terms of effects and how each term scales with the dimensions.

Scaling the axes by s turns ∂_a into ∂_a/s_a and dV into s_x s_y s_z dV. So a gradient product ∫ ∂_a v ∂_b w takes the
factor Π_i s_i^(1 − k_i), k_i = how many of a, b are the axis i, and the mass takes s_x s_y s_z. Each unit-constant
matrix is the sum of its parts of equal exponents ("strata"); with them any stretch is exact, on one mesh.
"""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import scipy.sparse as sp

from femu_piezo.diagnosis.effect import Effect, ExtraTerm
from femu_piezo.forward.gradient_products import FIELDS
from femu_piezo.forward.model import ElectroelasticModel
from femu_piezo.forward.reduction import ReducedModel, reduce_model
from femu_piezo.material.constants import E_FORM, PiezoConstants

#: Relative stretch of each dimension that the basis is trained for.
_STRETCH = 0.02


@dataclass(frozen=True)
class ExtendedModel:
    """Projected terms; r unknowns as in `ReducedModel`.

    Attributes
    ----------
    bulk : (10, r, r) the unit-constant matrices of the unstretched body
    strata : (n_s, r, r) their parts of equal exponents; strata of one constant sum to its bulk matrix
    owner : (n_s,) index of the e-form constant of each stratum
    exponents : (n_s, 3) exponents 1 − k of the factors on the three dimensions
    stiffness, inertia : name of an extra term → (r, r)
    displacements : number of displacement unknowns; the mass is the identity there
    """

    bulk: np.ndarray = field(repr=False)
    strata: np.ndarray = field(repr=False)
    owner: np.ndarray = field(repr=False)
    exponents: np.ndarray = field(repr=False)
    stiffness: dict[str, np.ndarray] = field(repr=False)
    inertia: dict[str, np.ndarray] = field(repr=False)
    displacements: int
    admittance_factor: float
    estimated_error: float

    @property
    def size(self) -> int:
        """Number of reduced unknowns."""
        return self.bulk.shape[1]


def extend_model(
    model: ElectroelasticModel,
    training: Sequence[PiezoConstants],
    effects: Sequence[Effect],
    band_Hz: float,
    *,
    accuracy: float = 1e-5,
) -> ExtendedModel:
    """Reduce a model so that it serves all effects of a list within their training ranges.

    Parameters
    ----------
    training : constants the basis is trained at, the reference first
    accuracy : of Z, as `reduce_model`
    """
    terms = list({term.name: term for effect in effects for term in effect.terms}.values())
    matrices = {term.name: term.matrix(model) for term in terms}
    reference = training[0].to_e_form().vector().real
    stretching = any(effect.stretch is not None for effect in effects)
    parts = _stretch_parts(model, reference) if stretching else {}
    trained = _with_terms(model, {**matrices, **parts})
    top = (2 * np.pi * band_Hz) ** 2
    points: list = [*training]
    lossless = training[0].lossless()
    for term in terms:
        for value in term.training:
            # a mass leads along the same states as a spring, which makes no mode of negative stiffness
            points.append((lossless, {term.name: 0.3 * top * value if term.kind == "inertia" else value}))
    for axis in range(3) if stretching else ():
        s = 1 + _STRETCH
        points.append((lossless, {f"stretch_{axis}_0": s - 1, f"stretch_{axis}_2": 1 / s - 1}))
    reduced = reduce_model(trained, points, band_Hz, accuracy=accuracy)
    return _projected(model, reduced, terms, stretching)


def _with_terms(model: ElectroelasticModel, matrices: dict[str, sp.spmatrix]) -> ElectroelasticModel:
    """A copy of the model with further terms, sharing everything else."""
    other = copy.copy(model)
    p = model.prolongation
    other.extra_terms = {**model.extra_terms, **{name: (p.T @ a @ p).tocsr() for name, a in matrices.items()}}
    return other


def _stretch_parts(model: ElectroelasticModel, coefficients: np.ndarray) -> dict[str, sp.csr_matrix]:
    """The parts of Σ c_q A_q with no derivative and with two derivatives along each axis, (4n, 4n)."""
    tensor = np.tensordot(coefficients, model.unit_tensors, axes=1)
    parts = {}
    for axis in range(3):
        along = (np.arange(3) == axis).astype(int)
        count = along[:, None] + along[None, :]  # derivatives along the axis in H[f, a, g, b]
        for k in (0, 2):
            masked = tensor * (count == k)[None, :, None, :]
            parts[f"stretch_{axis}_{k}"] = model.products.stiffness(masked)
    return parts


def _projected(
    model: ElectroelasticModel, reduced: ReducedModel, terms: Sequence[ExtraTerm], stretching: bool
) -> ExtendedModel:
    names = list(reduced.terms)
    extra = {term.name: reduced.matrices[names.index(term.name)] for term in terms}
    strata, owner, exponents = _strata(model, reduced) if stretching else _one_stratum_each(reduced)
    return ExtendedModel(
        bulk=reduced.matrices[: len(E_FORM)],
        strata=strata,
        owner=owner,
        exponents=exponents,
        stiffness={term.name: extra[term.name] for term in terms if term.kind == "stiffness"},
        inertia={term.name: extra[term.name] for term in terms if term.kind == "inertia"},
        displacements=reduced.displacements,
        admittance_factor=reduced.admittance_factor,
        estimated_error=reduced.estimated_error,
    )


def _one_stratum_each(reduced: ReducedModel) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    return reduced.matrices[: len(E_FORM)], np.arange(len(E_FORM)), np.zeros((len(E_FORM), 3))


def _strata(model: ElectroelasticModel, reduced: ReducedModel) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Project every gradient product that occurs once, and sum them by constant and exponents."""
    fields = (model.prolongation @ reduced.basis).reshape(FIELDS, model.basis.N, -1)
    gradients = model.products.gradient_matrices
    images: dict[tuple[int, int, int], np.ndarray] = {}
    atoms: dict[tuple[int, int, int, int], np.ndarray] = {}

    def atom(f: int, a: int, g: int, b: int) -> np.ndarray:
        if (g, b, f, a) in atoms:
            return atoms[g, b, f, a].T
        if (f, a, g, b) not in atoms:
            if (a, g, b) not in images:
                images[a, g, b] = gradients[a][b] @ fields[g]
            atoms[f, a, g, b] = fields[f].T @ images[a, g, b]
        return atoms[f, a, g, b]

    sums: dict[tuple[int, tuple[int, ...]], np.ndarray] = {}
    for q, tensor in enumerate(model.unit_tensors):
        for f, a, g, b in zip(*np.nonzero(tensor), strict=True):
            key = (q, tuple(1 - int(a == axis) - int(b == axis) for axis in range(3)))
            sums[key] = sums.get(key, 0.0) + tensor[f, a, g, b] * atom(f, a, g, b)
    matrices = np.array([(matrix + matrix.T) / 2 for matrix in sums.values()])
    return matrices, np.array([q for q, _ in sums]), np.array([powers for _, powers in sums], dtype=float)
