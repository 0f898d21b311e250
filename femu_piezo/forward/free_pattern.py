"""Operators in free unknowns, assembled directly from gradient products on one sparsity pattern.

The prolongations of `femu_piezo.forward.electrodes` and `femu_piezo.forward.parity` only drop held unknowns and scale
potentials; that of `electrodes` also joins the nodes of the hot electrode into the last unknown. So every entry of a
scalar matrix has a position in the operator that is computed once, and the operator of any tensor costs one pass over
the scalar entries per pair of fields.
"""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp

from femu_piezo.forward.gradient_products import FIELDS, GradientProducts


class FreePattern:
    """Sparsity pattern (m, m) of the coupled operator in free unknowns, the hot electrode's potential last.

    Parameters
    ----------
    products : scalar gradient products on n nodes
    prolongation : (4n, m) from free unknowns to all; each row has at most one entry
    electrode : whether the last free unknown is the potential of the hot electrode; False where electrodes are at zero
    """

    def __init__(self, products: GradientProducts, prolongation: sp.csr_matrix, electrode: bool = True) -> None:
        self._electrode = electrode
        self._products, n, self.size = products, products.size, prolongation.shape[1]
        entries = np.diff(prolongation.indptr)
        if entries.max() > 1:
            raise ValueError("a degree of freedom depends on two free unknowns: the pattern cannot be scattered")
        free = np.full(FIELDS * n, -1)
        free[entries == 1] = prolongation.indices
        hot = (free == self.size - 1) & electrode
        self._hot = hot[3 * n :]
        free[hot] = -1
        self._free = free.reshape(FIELDS, n)
        self._scale = [1.0, 1.0, 1.0, float(np.abs(prolongation.data).max())]
        self._rows = np.repeat(np.arange(n, dtype=np.int32), np.diff(products.indptr))
        self._touches = products.scalar(np.ones(products.indices.size)) @ self._hot > 0
        self._offsets, width = self._column_offsets()
        self.indptr, self._hot_rows = self._row_starts(width + self._touches)
        self.indices = self._fill_indices()

    def _column_offsets(self) -> tuple[list[np.ndarray], np.ndarray]:
        """Per field, the position (nnz,) of every scalar entry within its row of the operator; the row lengths (n,)."""
        starts, width, offsets = self._products.indptr, np.zeros(self._products.size, dtype=np.int64), []
        for g in range(FIELDS):
            before = np.concatenate([[0], np.cumsum(self._free[g][self._products.indices] >= 0)])
            offsets.append((before[:-1] - before[starts[:-1]][self._rows] + width[self._rows]).astype(np.int32))
            width = width + np.diff(before[starts])
        return offsets, width

    def _row_starts(self, width: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(m+1,) row pointers, and the free unknowns coupled to the electrode: the columns of the last row."""
        lengths = np.zeros(self.size, dtype=np.int64)
        coupled = []
        for f in range(FIELDS):
            kept = self._free[f] >= 0
            lengths[self._free[f][kept]] = width[kept]
            coupled.append(self._free[f][kept & self._touches])
        hot_rows = np.concatenate(coupled)
        if self._electrode:
            lengths[-1] = hot_rows.size + 1
        return np.concatenate([[0], np.cumsum(lengths)]), hot_rows

    def _targets(self, f: int, g: int) -> tuple[np.ndarray, np.ndarray]:
        """Scalar entries that belong to free unknowns in block (f, g), and their positions in the operator's data."""
        rows = self._free[f][self._rows]
        kept = np.flatnonzero((rows >= 0) & (self._free[g][self._products.indices] >= 0))
        return kept, self.indptr[rows[kept]] + self._offsets[g][kept]

    def _fill_indices(self) -> np.ndarray:
        indices = np.full(self.indptr[-1], self.size - 1, dtype=np.int32)
        for f in range(FIELDS):
            for g in range(FIELDS):
                kept, target = self._targets(f, g)
                indices[target] = self._free[g][self._products.indices[kept]]
        if self._electrode:
            indices[self.indptr[-2] : -1] = self._hot_rows
        return indices

    def stiffness(self, tensor: np.ndarray, inertia: float = 0.0) -> sp.csr_matrix:
        """(m, m) operator of an extended tensor H (4, 3, 4, 3), real or complex, symmetric in (f,a) ↔ (g,b).

        inertia : ω²ρ; ω²ρ ∫ φ_i φ_j is subtracted in the displacement blocks. It is subtracted here, because the
            difference of two sparse matrices loses entries that happen to be zero and changes the analysed pattern.
        """
        data = np.zeros(self.indptr[-1], dtype=tensor.dtype)
        ends = self.indptr[1:] - 1
        for f in range(FIELDS):
            for g in range(FIELDS):
                block = self._products.combine(tensor[f, :, g, :])
                if inertia and f == g < 3:
                    block = (0.0 if block is None else block) - inertia * self._products.mass
                if block is None:
                    continue
                block = block * (self._scale[f] * self._scale[g])
                kept, target = self._targets(f, g)
                data[target] = block[kept]
                if g == 3 and self._electrode:
                    self._couple(data, ends, f, self._products.scalar(block) @ self._hot)
        return sp.csr_matrix((data, self.indices, self.indptr), shape=(self.size, self.size))

    def added(self, matrix: sp.csr_matrix, further: sp.csr_matrix) -> sp.csr_matrix:
        """The sum of a matrix from `stiffness`, changed in place where that is possible, and a further matrix (m, m).

        The sum has this pattern where it contains all entries of `further`, else the union of both patterns.
        """
        entries = further.tocoo()
        numbers = np.arange(1, self.indices.size + 1)
        places = sp.csr_matrix((numbers, self.indices, self.indptr), shape=matrix.shape)[entries.row, entries.col]
        places = np.asarray(places).ravel() - 1
        if np.any(places < 0):
            return matrix + further
        matrix.data[places] += entries.data
        return matrix

    def _couple(self, data: np.ndarray, ends: np.ndarray, f: int, column: np.ndarray) -> None:
        """Write the electrode's column and row for field f; column : (n,) entries of f against the electrode."""
        coupled = (self._free[f] >= 0) & self._touches
        data[ends[self._free[f][coupled]]] = column[coupled]
        first = self.indptr[-2] + np.sum([np.sum((self._free[h] >= 0) & self._touches) for h in range(f)], dtype=int)
        data[first : first + np.count_nonzero(coupled)] = column[coupled]
        if f == 3:
            data[-1] = column[self._hot].sum()
