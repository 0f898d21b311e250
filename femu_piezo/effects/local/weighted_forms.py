"""Gradient products of a part with weights along its length, and its films, assembled once for all that needs them."""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property

import numpy as np
import scipy.sparse as sp
import skfem

from femu_piezo.forward.electrodes import electrode_film
from femu_piezo.forward.gradient_products import GradientProducts, assemble_gradient_products
from femu_piezo.forward.model import ElectroelasticModel
from femu_piezo.geometry.boxes import elements_of, grid_lines

#: Slices across the part along its length, at least.
_SLICES = 16


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
        """Of every slice across the part alone, by growing x; a long element holds several."""
        mesh, whole, found = self.model.domain.mesh, self.model.basis, []
        points, weights = whole.quadrature
        axis, grows = self._along_length
        for slab in (np.sort(slab.ravel()) for slab in elements_of(mesh)):
            for number in range(self._per_element):
                place = number if grows else self._per_element - 1 - number
                own = points.copy()
                own[axis] = (place + own[axis]) / self._per_element
                quadrature = (own, weights / self._per_element)
                part = skfem.Basis(mesh, whole.elem, elements=slab, quadrature=quadrature)
                found.append(assemble_gradient_products(part))
        return found

    @property
    def slice_ends(self) -> np.ndarray:
        """(slices + 1,) places along x where the slices meet, m."""
        line = grid_lines(self.model.domain.mesh)[0]
        return np.interp(np.arange(0, line.size - 1 + 1e-9, 1 / self._per_element), np.arange(line.size), line)

    @property
    def _per_element(self) -> int:
        """Slices in each element along x."""
        return -(-_SLICES // (grid_lines(self.model.domain.mesh)[0].size - 1))

    @property
    def _along_length(self) -> tuple[int, bool]:
        """Axis of the reference cell that lies along x, alike in every cell of a box, and whether it points to +x."""
        middle = np.full((3, 1), 0.5)
        jacobian = self.model.basis.mapping.DF(middle, tind=np.arange(1))[0, :, 0, 0]
        axis = int(np.argmax(np.abs(jacobian)))
        return axis, bool(jacobian[axis] > 0)

    @cached_property
    def odd(self) -> GradientProducts:
        """With the weight 2x/L."""
        return assemble_gradient_products(self.model.basis, self._share[0])

    @cached_property
    def even(self) -> GradientProducts:
        """With the weight (2x/L)² − 1/3, whose mean is zero."""
        return assemble_gradient_products(self.model.basis, self._share[0] ** 2 - 1 / 3)

    @cached_property
    def tapered(self) -> tuple[GradientProducts, GradientProducts]:
        """Parts of first and second order in t where the width is W (1 + t ξ), ξ = 2x/L.

        The map y → y (1 + t ξ) turns ∂_x into ∂_x − t η/(1 + tξ) ∂_y with η = 2y/L, ∂_y into ∂_y/(1 + tξ), and dV into
        (1 + tξ) dV.
        """
        part = self.model.basis
        xi, eta = self._share
        along, across = self.odd.gradients, assemble_gradient_products(part, eta).gradients
        first, second = np.zeros_like(along), np.zeros_like(along)
        first[0, 0] = along[0, 0] - across[0, 1] - across[1, 0]
        first[1, 1], first[2, 2] = -along[1, 1], along[2, 2]
        first[0, 1] = first[1, 0] = -across[1, 1]
        first[0, 2], first[2, 0] = along[0, 2] - across[1, 2], along[2, 0] - across[2, 1]
        second[0, 0], mixed, second[1, 1] = (
            assemble_gradient_products(part, weight).gradients[1, 1] for weight in (eta**2, xi * eta, xi**2)
        )
        second[0, 1] = second[1, 0] = mixed
        none = np.zeros_like(self.odd.mass)
        return replace(self.odd, gradients=first), replace(self.odd, gradients=second, mass=none)

    @cached_property
    def film(self) -> sp.csr_matrix:
        """(4n, 4n) ∫ v·u over the electrode of the part, m² per unit of displacement²."""
        return electrode_film(self.model)

    @cached_property
    def mass(self) -> sp.csr_matrix:
        """(3n, 3n) mass of all displacements, symmetry planes not held, kg."""
        n = 3 * self.model.basis.N
        return self.model.products.mass_matrix(self.model.density)[:n, :n]

    @property
    def _share(self) -> np.ndarray:
        """(2, elements, points) 2x/L and 2y/L at the points of integration."""
        return np.asarray(self.model.basis.global_coordinates())[:2] / self.model.domain.mesh.p[0].max()
