"""Gradient products of a part with weights along its length, each assembled once for all that needs it."""

from __future__ import annotations

from functools import cached_property

import numpy as np
import scipy.sparse as sp
import skfem

from femu_piezo.forward.gradient_products import GradientProducts, assemble_gradient_products
from femu_piezo.forward.model import ElectroelasticModel
from femu_piezo.geometry.boxes import elements_of, grid_lines


class WeightedProducts:
    """Of a box of hexahedra, one part of a plate that is cut at x = 0.

    Parameters
    ----------
    model : the part with its scalar basis of n degrees of freedom
    """

    def __init__(self, model: ElectroelasticModel) -> None:
        self.model = model

    @cached_property
    def slices(self) -> list[GradientProducts]:
        """Of every slice of elements across the part alone, by growing x."""
        mesh, whole = self.model.domain.mesh, self.model.basis
        slabs = (np.sort(slab.ravel()) for slab in elements_of(mesh))
        parts = (skfem.Basis(mesh, whole.elem, elements=slab, quadrature=whole.quadrature) for slab in slabs)
        return [assemble_gradient_products(part) for part in parts]

    @property
    def slice_ends(self) -> np.ndarray:
        """(slices + 1,) places along x where the slices meet, m."""
        return grid_lines(self.model.domain.mesh)[0]

    @cached_property
    def odd(self) -> GradientProducts:
        """With the weight 2x/L."""
        return assemble_gradient_products(self.model.basis, self._share)

    @cached_property
    def even(self) -> GradientProducts:
        """With the weight (2x/L)² − 1/3, whose mean is zero."""
        return assemble_gradient_products(self.model.basis, self._share**2 - 1 / 3)

    @cached_property
    def mass(self) -> sp.csr_matrix:
        """(3n, 3n) mass of all displacements, symmetry planes not held, kg."""
        n = 3 * self.model.basis.N
        return self.model.products.mass_matrix(self.model.density)[:n, :n]

    @property
    def _share(self) -> np.ndarray:
        """(elements, points) 2x/L at the points of integration."""
        return np.asarray(self.model.basis.global_coordinates())[0] / self.model.domain.mesh.p[0].max()
