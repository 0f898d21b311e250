"""`Blocks`: matrices over the unknowns of a reduced body that involve few of them, stored without the zeros."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np


@dataclass(frozen=True)
class Blocks:
    """Symmetric matrices (…, r, r) that are zero outside the rows and columns of k of the r unknowns.

    Attributes
    ----------
    inner : (…, k, k);  at : (k,) index of each row among the unknowns;  size : r
    """

    inner: np.ndarray = field(repr=False)
    at: np.ndarray = field(repr=False)
    size: int

    def __getitem__(self, number) -> np.ndarray:
        """(…, r, r) the chosen matrices in full."""
        return self._full(self.inner[number])

    def combined(self, weights: np.ndarray) -> np.ndarray:
        """(…, r, r) sum of the matrices along their first axis with weights (n,); (k, …, r, r) with weights (k, n)."""
        return self._full(np.tensordot(weights, self.inner, axes=1))

    def embedded(self, numbers: np.ndarray, size: int) -> Blocks:
        """These matrices over `size` unknowns, in which the present unknowns have the given indices."""
        return Blocks(self.inner, numbers[self.at], size)

    def _full(self, block: np.ndarray) -> np.ndarray:
        found = np.zeros((*block.shape[:-2], self.size, self.size))
        found[(..., *np.ix_(self.at, self.at))] = block
        return found
