"""Values of finite element fields on a box of hexahedra at any points, without a search in space."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp

from femu_piezo.forward.model import ElectroelasticModel


def interpolation(model: ElectroelasticModel, points: np.ndarray) -> sp.csr_matrix:
    """(k, n) matrix from the degrees of freedom of a box's scalar basis to values at points (3, k) within the box."""
    mesh, basis = model.domain.mesh, model.basis
    lines = [np.unique(np.round(axis / np.ptp(axis), 9)) for axis in mesh.p]
    low, size = mesh.p.min(axis=1), np.ptp(mesh.p, axis=1)

    def cells(where: np.ndarray) -> np.ndarray:
        """(3, k) numbers of the intervals between the lines."""
        shares = (where - low[:, None]) / size[:, None]
        found = [np.searchsorted(line, share, side="right") - 1 for line, share in zip(lines, shares, strict=True)]
        return np.array([np.clip(i, 0, line.size - 2) for i, line in zip(found, lines, strict=True)])

    counts = tuple(line.size - 1 for line in lines)
    element = np.empty(counts, dtype=int)
    element[tuple(cells(mesh.p[:, mesh.t].mean(axis=1)))] = np.arange(mesh.t.shape[1])
    own = element[tuple(cells(points))]
    corners = np.concatenate([np.zeros((3, 1)), np.eye(3)], axis=1)
    images = basis.mapping.F(corners, tind=own)  # (3, k, 4): every element is a box, so its map is affine
    edges = np.moveaxis(images[:, :, 1:] - images[:, :, :1], 0, 1)
    local = np.linalg.solve(edges, (points - images[:, :, 0]).T[:, :, None])[:, :, 0].T[:, :, None]
    values = np.array(
        [np.asarray(basis.elem.gbasis(basis.mapping, local, i, tind=own)[0])[:, 0] for i in range(basis.Nbfun)]
    )
    columns = basis.element_dofs[:, own]
    rows = np.broadcast_to(np.arange(points.shape[1]), columns.shape)
    return sp.csr_matrix((values.ravel(), (rows.ravel(), columns.ravel())), shape=(points.shape[1], basis.N))
