"""Solder on the two ends of a plate: −ω² (m/A) ∫ v·u dS over each end face of area A, m in kg on each end."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp
import skfem

from femu_piezo.effects.effect import Effect, EffectContext, EffectParameter, ExtraTerm
from femu_piezo.forward.model import ElectroelasticModel


@skfem.BilinearForm
def inertia(u, v, _):
    """The weak form v·u."""
    return u * v


def end_face(model: ElectroelasticModel) -> sp.csr_matrix:
    """∫ v·u over the computed part of the end face x = L/2, for the three displacements; the potential has no inertia.

    For a plate cut at its mirror planes this stands for both ends: all terms of the model lack the same factor.
    """
    mesh = model.domain.mesh
    end = mesh.p[0].max()
    facets = mesh.facets_satisfying(lambda x: x[0] > end * (1 - 1e-9))
    block = inertia.assemble(skfem.FacetBasis(mesh, model.basis.elem, facets=facets))
    return sp.block_diag([block, block, block, sp.csr_matrix(block.shape)], format="csr")


def candidates(context: EffectContext) -> tuple[Effect, ...]:
    """For plates of known size; at most a fifth of the mass of the plate on each end."""
    if context.dimensions is None:
        return ()
    length, width, thickness = context.dimensions
    section = width * thickness
    own = context.density * length * section

    def coefficient(omega: np.ndarray, p: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """c = m/A at each frequency, and ∂c/∂m."""
        return np.full(omega.shape, p[0] / section, dtype=complex), np.full((omega.size, 1), 1 / section, dtype=complex)

    def weight(p: np.ndarray, area: float) -> tuple[float, np.ndarray]:
        """Mass of the solder on both ends, kg, and its derivative: what a balance sees."""
        return 2 * p[0], np.array([2.0])

    return (
        Effect(
            name="end_mass",
            sentence="solder or glue sits on the two ends of the plate",
            parameters=(EffectParameter("mass", "kg", -0.01 * own, 0.2 * own, 0.005 * own, 0.05 * own),),
            confusable_with=("wrong_length", "electrode_mass", "s11"),
            advice=("look at the ends and clean them", "weigh the specimen before and after cleaning"),
            terms=(ExtraTerm("end mass", "inertia", end_face, coefficient, (0.05 * own / section,)),),
            added_mass=weight,
        ),
    )
