"""Projections VᵗA_qV of every affine term on a growing basis, from scalar gradient products: no sparse A_q is formed.

With the four fields of the basis vectors on the nodes, every bulk term is a combination of G_ab V_g (see
`femu_piezo.forward.gradient_products`), so nine products serve all ten constants. Images A_q v are computed for a few
vectors at a time, multiplied by the basis and dropped, so that only small matrices are kept.

Rows and columns are divided into displacements "u" and potentials "p" (hot electrode last among the rows, lifting of
the voltage first among the columns), because most terms have only some of the four blocks.
"""

from __future__ import annotations

from functools import partial

import numpy as np
import scipy.sparse as sp
import scipy.sparse.linalg as spla

from femu_piezo.forward.gradient_products import FIELDS
from femu_piezo.forward.model import ElectroelasticModel
from femu_piezo.threads import by_columns, cores_of_process, in_parallel

_BLOCKS = ("uu", "pu", "up", "pp")  #: rows, then columns
_CHUNK_BYTES = 128e6  #: memory for the images of all chunks of columns that are computed at the same time


class TermProjections:
    """VᵗA_qV for every affine term of a model and a basis whose columns only grow in number.

    Attributes
    ----------
    displacements : number of displacement unknowns of the full model, which come first
    """

    def __init__(self, model: ElectroelasticModel) -> None:
        self._model = model
        nodes = model.basis.N
        self.displacements = model.displacements
        split = {"u": slice(0, self.displacements), "p": slice(self.displacements, model.size)}
        self._fields = {"u": slice(0, 3), "p": slice(3, FIELDS)}
        rows = {"u": slice(0, 3 * nodes), "p": slice(3 * nodes, FIELDS * nodes)}
        prolongation = sp.csr_matrix(model.prolongation)
        self._prolong = {kind: prolongation[rows[kind]][:, split[kind]] for kind in "up"}
        self._restrict = {kind: self._prolong[kind].T.tocsr() for kind in "up"}
        self._extra = [
            {block: matrix[split[block[0]]][:, split[block[1]]] for block in _BLOCKS}
            for matrix in model.extra_terms.values()
        ]
        self._tensors = model.tensors
        self._known = {"u": 0, "p": 0}
        self._projected = {block: np.zeros((len(model.terms), 0, 0)) for block in ("uu", "pu", "pp")}

    def _images(self, kind: str, columns: np.ndarray) -> list[dict[str, np.ndarray]]:
        """For every term, the nonzero rows "u" and "p" of A_q v for basis columns v (n_u or n_p, k) of one kind."""
        k, nodes = columns.shape[1], self._model.basis.N
        fields = np.zeros((FIELDS, nodes, k))
        fields[self._fields[kind]] = (self._prolong[kind] @ columns).reshape(-1, nodes, k)
        found = []
        for tensor, images in zip(self._tensors, self._model.products.applied(self._tensors, fields), strict=True):
            rows = [row for row in "up" if np.any(tensor[self._fields[row]][:, :, self._fields[kind]])]
            found.append({row: self._restrict[row] @ images[self._fields[row]].reshape(-1, k) for row in rows})
        for blocks in self._extra:
            found.append({row: blocks[row + kind] @ columns for row in "up" if blocks[row + kind].nnz})
        return found

    @property
    def mass(self) -> spla.LinearOperator:
        """M (n_u, n_u) of the free displacements, kg."""
        times = self._mass_times
        return spla.LinearOperator((self.displacements,) * 2, matvec=times, matmat=times, dtype=float)

    def _mass_times(self, displacements: np.ndarray) -> np.ndarray:
        return by_columns(self._mass_image, displacements.reshape(self.displacements, -1))

    def _mass_image(self, displacements: np.ndarray) -> np.ndarray:
        k, nodes = displacements.shape[1], self._model.basis.N
        nodal = (self._prolong["u"] @ displacements).reshape(3, nodes, k).transpose(1, 0, 2).reshape(nodes, -1)
        found = self._model.density * self._model.products.mass_times(nodal).reshape(nodes, 3, k).transpose(1, 0, 2)
        return self._restrict["u"] @ found.reshape(3 * nodes, k)

    def project(self, u: np.ndarray, p: np.ndarray) -> np.ndarray:
        """VᵗA_qV, (n_terms, r, r) real symmetric; V has the columns u, then p without its first, then the first of p.

        Parameters
        ----------
        u, p : (n_u, k_u) and (n_p, k_p) basis columns; those of the previous call come first, unchanged, and the first
            column of p is the lifting of the voltage
        """
        ku, size = u.shape[1], u.shape[1] + p.shape[1]
        self._grow(u, p)
        blocks = self._projected
        result = np.zeros((len(blocks["uu"]), size, size))
        result[:, :ku, :ku], result[:, ku:, ku:], result[:, ku:, :ku] = blocks["uu"], blocks["pp"], blocks["pu"]
        result[:, :ku, ku:] = blocks["pu"].transpose(0, 2, 1)
        order = np.r_[0:ku, ku + 1 : size, ku]
        result = result[:, order][:, :, order]
        return (result + result.transpose(0, 2, 1)) / 2

    def _grow(self, u: np.ndarray, p: np.ndarray) -> None:
        """Extend the projections by the columns that are new."""
        columns = {"u": u, "p": p}
        for block, known in self._projected.items():
            added = [columns[kind].shape[1] - old for kind, old in zip(block, known.shape[1:], strict=True)]
            self._projected[block] = np.pad(known, ((0, 0), (0, added[0]), (0, added[1])))
        for kind in "up":
            chunks = self._chunks(self._known[kind], columns[kind].shape[1])
            products = in_parallel(partial(self._products, columns, kind), chunks)
            for place, of_chunk in zip(chunks, products, strict=True):
                for number, row, product in of_chunk:
                    self._place(number, row + kind, place, product)
            self._known[kind] = columns[kind].shape[1]

    def _products(self, columns: dict[str, np.ndarray], kind: str, place: slice) -> list[tuple[int, str, np.ndarray]]:
        """(number of a term, rows "u" or "p", product of all basis columns of these rows with some images)."""
        images = self._images(kind, columns[kind][:, place])
        return [(n, row, columns[row].T @ image) for n, rows in enumerate(images) for row, image in rows.items()]

    def _chunks(self, start: int, end: int) -> list[slice]:
        """Chunks of new columns, at least one for each core, whose images together stay within `_CHUNK_BYTES`."""
        cores = cores_of_process()
        most = max(1, int(_CHUNK_BYTES / (8 * 40 * self._model.basis.N)) // cores)
        width = max(1, min(most, -(-(end - start) // cores)))
        return [slice(first, min(first + width, end)) for first in range(start, end, width)]

    def _place(self, number: int, block: str, place: slice, product: np.ndarray) -> None:
        """Write a term's product (all basis columns, new columns) into its block and the transposed entries."""
        if block == "up":
            self._projected["pu"][number, place] = product.T
            return
        self._projected[block][number, :, place] = product
        if block in ("uu", "pp"):
            self._projected[block][number, place] = product.T
