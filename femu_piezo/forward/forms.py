"""The weak form of the coupled electro-elastic problem, one bilinear form per unit constant (IEEE 176).

Find u, φ such that for all v, ψ

    ∫ S(v)ᵗ c^E S(u) + ∫ S(v)ᵗ eᵗ ∇φ − ω² ∫ ρ v·u = 0
    ∫ ∇ψᵗ e S(u) − ∫ ∇ψᵗ ε^S ∇φ = −Q·ψ on the electrodes.

Every constant enters linearly, so a form evaluated for ONE unit constant is the submatrix A_q of the affine
operator A(θ) = Σ c_q A_q and at the same time its exact derivative. These forms state the problem in its usual
notation; `femu_piezo.forward.gradient_products` assembles the same matrices from products of gradients, and a
test checks that both are equal.
"""

from __future__ import annotations

import numpy as np
from skfem import BilinearForm, Element, ElementVector
from skfem.helpers import dot, grad, sym_grad

from femu_piezo.material.constants import ElasticForm
from femu_piezo.material.voigt import piezoelectric_tensor, stiffness_tensor


def coupled_element(scalar: Element) -> Element:
    """Displacement (vector) and potential (scalar) on the same scalar element."""
    return ElementVector(scalar, 3) * scalar


def electroelastic_form(constants: ElasticForm, rotation: np.ndarray | None = None) -> BilinearForm:
    """The stiffness form of given e-form constants; for a unit set (one constant 1, the others 0) this is A_q.

    Parameters
    ----------
    constants : e-form constants, SI (real part used; the forms of a unit set are real)
    rotation : (3, 3) x_crystal = R x_specimen; identity where None

    Returns
    -------
    skfem.BilinearForm over the composite element of `coupled_element`: (u, φ) trial, (v, ψ) test.
    """
    r = np.eye(3) if rotation is None else rotation
    c = np.einsum("pqrs,pi,qj,rk,sl->ijkl", stiffness_tensor(constants.stiffness().real), r, r, r, r)
    e = np.einsum("pqr,pi,qj,rk->ijk", piezoelectric_tensor(constants.piezoelectric().real), r, r, r)
    eps = r.T @ constants.permittivity().real @ r

    @BilinearForm
    def form(u, phi, v, psi, _):
        strain, virtual_strain = sym_grad(u), sym_grad(v)
        field, virtual_field = grad(phi), grad(psi)
        return (
            np.einsum("ij...,ijkl,kl...->...", virtual_strain, c, strain)
            + np.einsum("jk...,ijk,i...->...", virtual_strain, e, field)
            + np.einsum("i...,ijk,jk...->...", virtual_field, e, strain)
            - np.einsum("i...,ij,j...->...", virtual_field, eps, field)
        )

    return form


def unit_form(name: str, rotation: np.ndarray | None = None) -> BilinearForm:
    """A_q of one e-form constant by name ("c11", "e31", "eps33S", …); rotation (3, 3) as `electroelastic_form`."""
    unit = [float(name == other) for other in ElasticForm.names()]
    return electroelastic_form(ElasticForm(*unit), rotation)


def mass_form(density: float) -> BilinearForm:
    """∫ ρ v·u with density in kg/m³."""

    @BilinearForm
    def form(u, phi, v, psi, _):
        return density * dot(v, u)

    return form
