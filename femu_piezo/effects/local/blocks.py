"""`Blocks`: matrices over the unknowns of a reduced plate that concern few of them, kept small."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np


@dataclass(frozen=True)
class Blocks:
    """Symmetric matrices that are zero but for some of the r unknowns, for any selection of these.

    Attributes
    ----------
    inner : (…, k, k);  at : (k,) number of each row among the unknowns selected, −1 where it is not
    size : number of unknowns selected
    """

    inner: np.ndarray = field(repr=False)
    at: np.ndarray = field(repr=False)
    size: int

    @classmethod
    def of(cls, matrices: np.ndarray, own: np.ndarray) -> Blocks:
        """Of full matrices (…, r, r) that are zero outside the unknowns `own` (k,)."""
        return cls(np.ascontiguousarray(matrices[(..., *np.ix_(own, own))]), own, matrices.shape[-1])

    def __getitem__(self, number) -> np.ndarray:
        """(…, size, size) in full."""
        return self._full(self.inner[number])

    def combined(self, weights: np.ndarray) -> np.ndarray:
        """(…, size, size) Σ weights (n,) times the matrices along their first axis."""
        return self._full(np.tensordot(weights, self.inner, axes=1))

    def _full(self, block: np.ndarray) -> np.ndarray:
        there, found = self.at >= 0, np.zeros((*block.shape[:-2], self.size, self.size))
        found[(..., *np.ix_(self.at[there], self.at[there]))] = block[(..., *np.ix_(there, there))]
        return found

    def select(self, keep: np.ndarray) -> Blocks:
        """For the unknowns `keep` (indices, ascending) alone."""
        at = np.searchsorted(keep, self.at)
        there = (at < keep.size) & (keep[np.minimum(at, keep.size - 1)] == self.at)
        return Blocks(self.inner, np.where(there, at, -1), keep.size)
