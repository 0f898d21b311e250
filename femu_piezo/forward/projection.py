"""Images A_q V of every affine term on a growing basis, from scalar gradient products: no sparse A_q is formed.

With the four fields of the basis vectors on the nodes, every bulk term is a combination of G_ab V_g (see
`femu_piezo.forward.gradient_products`), so nine sparse products serve all ten constants. The images give the
projections VᵗA_qV and the residuals Σ c_q A_q V y of reduced states at any constants.

Rows and columns are split in displacements "u" and potentials "p" (hot electrode last among the rows, lifting of
the voltage first among the columns), because a term couples few of the four blocks.
"""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp
import scipy.sparse.linalg as spla

from femu_piezo.forward.gradient_products import FIELDS
from femu_piezo.forward.model import ElectroelasticModel

_BLOCKS = ("uu", "pu", "up", "pp")  #: rows then columns
_CHUNK_BYTES = 128e6


class TermImages:
    """A_q V for every affine term of a model and the basis columns added so far.

    Attributes
    ----------
    displacements : number of displacement unknowns of the full model, which come first
    """

    def __init__(self, model: ElectroelasticModel) -> None:
        self._model = model
        nodes = model.basis.N
        self.displacements = int(np.count_nonzero(model.mass.diagonal()))
        split = {"u": slice(0, self.displacements), "p": slice(self.displacements, model.size)}
        rows = {"u": slice(0, 3 * nodes), "p": slice(3 * nodes, FIELDS * nodes)}
        prolongation = sp.csr_matrix(model.prolongation)
        self._prolong = {kind: prolongation[rows[kind]][:, split[kind]] for kind in "up"}
        self._restrict = {kind: self._prolong[kind].T.tocsr() for kind in "up"}
        self._extra = [
            {block: matrix[split[block[0]]][:, split[block[1]]] for block in _BLOCKS}
            for matrix in model.extra_terms.values()
        ]
        self._tensors = model.tensors
        count = len(self._tensors) + len(self._extra)
        self._images: list[dict[str, np.ndarray]] = [{} for _ in range(count)]
        self._projected: list[dict[str, np.ndarray]] = [{} for _ in range(count)]

    def add(self, kind: str, columns: np.ndarray) -> None:
        """Append the images of further basis columns of one kind, (rows of that kind, k) real."""
        nodes = self._model.basis.N
        width = max(1, int(_CHUNK_BYTES / (8 * 27 * nodes)))
        for start in range(0, columns.shape[1], width):
            part = columns[:, start : start + width]
            images = self._bulk_images(kind, part) + [
                {row: blocks[row + kind] @ part for row in "up" if blocks[row + kind].nnz} for blocks in self._extra
            ]
            for stored, fresh in zip(self._images, images, strict=True):
                for row, image in fresh.items():
                    old = stored.get(row + kind)
                    stored[row + kind] = image if old is None else np.hstack([old, image])

    def _bulk_images(self, kind: str, columns: np.ndarray) -> list[dict[str, np.ndarray]]:
        fields = range(3) if kind == "u" else (3,)
        k, nodes = columns.shape[1], self._model.basis.N
        nodal = (self._prolong[kind] @ columns).reshape(len(fields), nodes, k)
        wide = np.ascontiguousarray(nodal.transpose(1, 0, 2).reshape(nodes, -1))
        moved = {}
        for a in range(3):
            for b in range(3):
                product = self._model.products.times(a, b, wide).reshape(nodes, len(fields), k)
                for position, g in enumerate(fields):
                    moved[a, g, b] = product[:, position]
        return [self._combine(tensor, moved, fields, (nodes, k)) for tensor in self._tensors]

    def _combine(self, tensor: np.ndarray, moved: dict, fields, shape: tuple[int, int]) -> dict[str, np.ndarray]:
        """Restrict Σ H[f,a,g,b] G_ab V_g to the unknowns, rows "u" (f < 3) and "p" (f = 3) where not zero."""
        result = {}
        for row, targets in (("u", range(3)), ("p", (3,))):
            part = tensor[list(targets)][:, :, list(fields)]
            if not np.any(part):
                continue
            total = np.zeros((len(targets), *shape))
            for f, a, g, b in zip(*np.nonzero(part), strict=True):
                total[f] += part[f, a, g, b] * moved[a, fields[g], b]
            result[row] = self._restrict[row] @ total.reshape(-1, shape[1])
        return result

    @property
    def mass(self) -> spla.LinearOperator:
        """M (n_u, n_u) of the free displacements, kg."""
        times = self._mass_times
        return spla.LinearOperator((self.displacements,) * 2, matvec=times, matmat=times, dtype=float)

    def _mass_times(self, displacements: np.ndarray) -> np.ndarray:
        displacements = displacements.reshape(self.displacements, -1)
        k, nodes = displacements.shape[1], self._model.basis.N
        nodal = (self._prolong["u"] @ displacements).reshape(3, nodes, k).transpose(1, 0, 2).reshape(nodes, -1)
        found = self._model.density * self._model.products.mass_times(nodal).reshape(nodes, 3, k).transpose(1, 0, 2)
        return self._restrict["u"] @ found.reshape(3 * nodes, k)

    def project(self, u: np.ndarray, p: np.ndarray) -> np.ndarray:
        """VᵗA_qV, (n_terms, r, r) real symmetric; columns u, then those of p after its first, then its first.

        Parameters
        ----------
        u, p : the basis columns added so far, p with the lifting of the voltage first
        """
        ku, size = u.shape[1], u.shape[1] + p.shape[1]
        result = np.zeros((len(self._images), size, size))
        for matrix, blocks, known in zip(result, self._images, self._projected, strict=True):
            for block, rows in (("uu", u), ("pu", p), ("pp", p)):
                if block in blocks:
                    known[block] = _grown(known.get(block, np.zeros((0, 0))), rows, blocks[block])
            matrix[:ku, :ku], matrix[ku:, ku:] = known.get("uu", 0.0), known.get("pp", 0.0)
            matrix[ku:, :ku] = known.get("pu", 0.0)
            matrix[:ku, ku:] = matrix[ku:, :ku].T
        order = np.r_[0:ku, ku + 1 : size, ku]
        result = result[:, order][:, :, order]
        return (result + result.transpose(0, 2, 1)) / 2

    def apply(self, coefficients: np.ndarray, states: np.ndarray) -> np.ndarray:
        """Σ c_q A_q V y, (m, k), for reduced states y (r, k) in the order of `project` and coefficients (n_terms,)."""
        ku = next(blocks["uu"].shape[1] for blocks in self._images if "uu" in blocks)
        parts = {"u": states[:ku], "p": np.concatenate([states[-1:], states[ku:-1]])}
        rows = {"u": self.displacements, "p": self._model.size - self.displacements}
        result = {kind: np.zeros((rows[kind], states.shape[1]), np.result_type(coefficients, states)) for kind in "up"}
        for block in _BLOCKS:
            present = [(c, q[block]) for c, q in zip(coefficients, self._images, strict=True) if block in q and c != 0]
            if present:
                total = present[0][0] * present[0][1]
                for coefficient, image in present[1:]:
                    total += coefficient * image
                result[block[0]] += total @ parts[block[1]]
        return np.concatenate([result["u"], result["p"]])


def _grown(known: np.ndarray, rows: np.ndarray, images: np.ndarray) -> np.ndarray:
    """rowsᵗ images (k, j), of which the part for the first rows and images is known."""
    k, j = known.shape
    found = np.empty((rows.shape[1], images.shape[1]))
    found[:k, :j] = known
    found[k:, :j] = rows[:, k:].T @ images[:, :j]
    found[:, j:] = rows.T @ images[:, j:]
    return found
