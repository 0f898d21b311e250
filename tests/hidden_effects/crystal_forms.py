"""Energy matrices of a crystal from integrals of products of derivatives, whatever the functions are."""

from __future__ import annotations

from abc import ABC, abstractmethod

import numpy as np

from hidden_effects import crystal
from hidden_effects.crystal import VOIGT

#: Number of the field of one volt between the electrodes, beside u_x, u_y, u_z and φ.
VOLT = 4


class CrystalForms(ABC):
    """Matrices over displacements and potentials, the last potential the volt.

    Attributes
    ----------
    driven : whether the volt drives these fields
    displacements, potentials : numbers n and m of functions, the volt apart
    starts : (4,) first displacements of u_x, u_y and u_z, and n
    poling : axis 2 or 0
    """

    driven: bool
    displacements: int
    potentials: int
    starts: np.ndarray
    poling: int

    def block(self, f: int) -> slice:
        """Where the functions of u_x, u_y or u_z are among the displacements."""
        return slice(self.starts[f], self.starts[f + 1])

    @abstractmethod
    def product(self, f: int, a: int, g: int, b: int, profile: str) -> np.ndarray:
        """∫ profile ∂_a f ∂_b g dV of two fields."""

    def elastic_forms(self) -> np.ndarray:
        """(5, n, n) of the constants in the order of ELASTIC."""
        return np.array([self._strain_strain(crystal.elastic(name, self.poling)) for name in crystal.ELASTIC])

    def coupling_forms(self) -> np.ndarray:
        """(3, n, m + 1) of those in the order of COUPLING."""
        return np.array([self._strain_field(crystal.coupling(name, self.poling)) for name in crystal.COUPLING])

    def dielectric_forms(self) -> np.ndarray:
        """(2, m + 1, m + 1) of those in the order of DIELECTRIC."""
        return np.array([self._field_field(crystal.dielectric(name, self.poling)) for name in crystal.DIELECTRIC])

    def _strain_strain(self, c: np.ndarray) -> np.ndarray:
        found = np.zeros((self.displacements, self.displacements))
        for row, column in zip(*np.nonzero(c), strict=True):
            for f, a in VOIGT[row]:
                for g, b in VOIGT[column]:
                    found[self.block(f), self.block(g)] += c[row, column] * self.product(f, a, g, b, "c")
        return found

    def _strain_field(self, e: np.ndarray) -> np.ndarray:
        found = np.zeros((self.displacements, self.potentials + 1))
        for k, column in zip(*np.nonzero(e), strict=True):
            for f, a in VOIGT[column]:
                found[self.block(f), :-1] += e[k, column] * self.product(f, a, 3, k, "e")
                if self.driven:
                    found[self.block(f), -1:] += e[k, column] * self.product(f, a, VOLT, k, "e")
        return found

    def _field_field(self, eps: np.ndarray) -> np.ndarray:
        found = np.zeros((self.potentials + 1, self.potentials + 1))
        for k in np.flatnonzero(eps):
            found[:-1, :-1] += eps[k] * self.product(3, k, 3, k, "eps")
            if self.driven:
                mixed = eps[k] * self.product(3, k, VOLT, k, "eps")
                found[:-1, -1:] += mixed
                found[-1:, :-1] += mixed.T
                found[-1:, -1:] += eps[k] * self.product(VOLT, k, VOLT, k, "eps")
        return found
