"""`Blocks`: matrices over the unknowns of a reduced plate that concern few of them, kept small."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np


@dataclass(frozen=True)
class Blocks:
    """Symmetric matrices (…, r, r) that are zero but for some of the r unknowns.

    Attributes
    ----------
    inner : (…, k, k);  at : (k,) number of each row among the unknowns;  size : r
    """

    inner: np.ndarray = field(repr=False)
    at: np.ndarray = field(repr=False)
    size: int

    def __getitem__(self, number) -> np.ndarray:
        """(…, r, r) in full."""
        return self._full(self.inner[number])

    def combined(self, weights: np.ndarray) -> np.ndarray:
        """(…, r, r) Σ weights (n,) times the matrices along their first axis."""
        return self._full(np.tensordot(weights, self.inner, axes=1))

    def among(self, numbers: np.ndarray, size: int) -> Blocks:
        """The same over `size` unknowns, of which those so far are the given ones (indices)."""
        return Blocks(self.inner, numbers[self.at], size)

    def _full(self, block: np.ndarray) -> np.ndarray:
        found = np.zeros((*block.shape[:-2], self.size, self.size))
        found[(..., *np.ix_(self.at, self.at))] = block
        return found
