"""Interpolation of finite element fields on a box of hexahedra; cells are found from the grid lines of the box."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp

from femu_piezo.forward.model import ElectroelasticModel
from femu_piezo.geometry.boxes import elements_of, grid_lines


def interpolation(model: ElectroelasticModel, points: np.ndarray) -> sp.csr_matrix:
    """(k, n) matrix from the degrees of freedom of a box's scalar basis to values at points (3, k) within the box."""
    mesh, basis = model.domain.mesh, model.basis
    cells = tuple(
        np.clip(np.searchsorted(line, where, side="right") - 1, 0, line.size - 2)
        for line, where in zip(grid_lines(mesh), points, strict=True)
    )
    element = elements_of(mesh)[cells]
    corners = np.concatenate([np.zeros((3, 1)), np.eye(3)], axis=1)
    images = basis.mapping.F(corners, tind=element)  # (3, k, 4): every element is a box, so its map is affine
    edges = np.moveaxis(images[:, :, 1:] - images[:, :, :1], 0, 1)
    local = np.linalg.solve(edges, (points - images[:, :, 0]).T[:, :, None])[:, :, 0].T[:, :, None]
    values = np.array(
        [np.asarray(basis.elem.gbasis(basis.mapping, local, i, tind=element)[0])[:, 0] for i in range(basis.Nbfun)]
    )
    columns = basis.element_dofs[:, element]
    rows = np.broadcast_to(np.arange(points.shape[1]), columns.shape)
    return sp.csr_matrix((values.ravel(), (rows.ravel(), columns.ravel())), shape=(points.shape[1], basis.N))
