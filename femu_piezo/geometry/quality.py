"""Checks of meshes and electrodes before a computation; every failure is an InputError with one exact sentence."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp
import skfem

from femu_piezo.errors import InputError
from femu_piezo.geometry.curved_mesh import CurvedHexahedra

#: An element whose Jacobian falls below this share of the mean over the element is degenerate.
DEGENERATE = 1e-6


def least_jacobian(mesh: skfem.Mesh) -> float:
    """The least Jacobian determinant in an element over the mean of that element; 0 where one vanishes."""
    try:
        jacobian = _jacobian(mesh)
    except ZeroDivisionError:
        return 0.0
    return float(np.min(jacobian / jacobian.mean(axis=1, keepdims=True)))


def _jacobian(mesh: skfem.Mesh) -> np.ndarray:
    """(m, n) determinants at points inside and at corners of every element; ZeroDivisionError where one vanishes."""
    points, _ = skfem.quadrature.get_quadrature(mesh.elem.refdom, 6)
    try:
        found = mesh.mapping().detDF(np.hstack([points, np.array(mesh.elem.refdom.p, dtype=float)]))
    except Exception as error:  # skfem raises plain Exception for a determinant that is exactly zero
        raise ZeroDivisionError(str(error)) from None
    return np.broadcast_to(found, (mesh.nelements, found.shape[-1]))


def check_elements(mesh: skfem.Mesh, what: str = "the mesh") -> None:
    """InputError where an element is inverted or has no volume, or where the mesh is not connected."""
    try:
        jacobian = _jacobian(mesh)
    except ZeroDivisionError:
        raise InputError(f"{what} has an element without volume; mesh it again, or more finely") from None
    mean = np.abs(jacobian.mean(axis=1))
    if not np.all(np.isfinite(jacobian)) or not mean.max() > 0:
        raise InputError(f"{what} has elements without volume; are all its points in one plane?")
    sign = np.sign(jacobian.mean(axis=1))
    bad = np.flatnonzero((np.min(jacobian * sign[:, None], axis=1) < DEGENERATE * mean) | (mean < 1e-9 * mean.max()))
    if bad.size:
        x, y, z = mesh.p[:, mesh.t[: mesh.elem.refdom.nnodes, bad[0]]].mean(axis=1)
        raise InputError(
            f"{what} has {bad.size} inverted or degenerate element{'s' if bad.size > 1 else ''} of {mesh.nelements}, "
            f"the first at ({x:.4g}, {y:.4g}, {z:.4g}) m; mesh it finer there or with straight-sided elements"
        )
    corners = mesh.t[: mesh.elem.refdom.nnodes]
    pairs = (corners[:-1].ravel(), corners[1:].ravel())
    graph = sp.coo_matrix((np.ones(pairs[0].size), pairs), shape=(mesh.p.shape[1],) * 2)
    _, label = sp.csgraph.connected_components(graph, directed=False)
    parts = np.unique(label[corners[0]]).size
    if parts > 1:
        raise InputError(
            f"{what} falls into {parts} parts that share no points; unite them (in gmsh: BooleanFragments, or "
            "Coherence) so that neighbours have common points"
        )


def boundary_area(mesh: skfem.Mesh, name: str) -> float:
    """Area of a named boundary, m²."""
    facets = mesh.boundaries[name]
    if len(facets) == 0:
        return 0.0
    order = 12 if isinstance(mesh, CurvedHexahedra) else None
    return float(np.sum(skfem.FacetBasis(mesh, mesh.elem(), facets=facets, intorder=order).dx))


def mean_normal(facets: skfem.FacetBasis) -> np.ndarray:
    """(3,) mean of the outward normal over some facets; shorter than 1 where they are not in one plane."""
    return np.sum(np.asarray(facets.normals) * facets.dx, axis=(1, 2)) / np.sum(facets.dx)


def check_electrodes(mesh: skfem.Mesh, hot: str, ground: str, what: str = "the mesh") -> None:
    """InputError where an electrode has no name, lies inside the body or has no area, or where the two touch."""
    known = mesh.boundaries or {}
    for name in (hot, ground):
        if name not in known:
            raise InputError(
                f'{what} has no surface named "{name}"; it has {", ".join(sorted(known)) or "no named surface"}: '
                f'name both electrodes, in gmsh by Physical Surface("{hot}") and Physical Surface("{ground}")'
            )
        inside = int(np.sum(mesh.f2t[1, known[name]] != -1))
        if inside:
            raise InputError(
                f'{what}: {inside} of {len(known[name])} facets of "{name}" lie inside the body; an electrode is a '
                "part of its surface"
            )
        if not boundary_area(mesh, name) > 0:
            raise InputError(f'{what}: the electrode "{name}" has no area; is it smaller than its margin?')
    nodes = [np.unique(mesh.facets[:, known[name]]) for name in (hot, ground)]
    common = np.intersect1d(*nodes)
    if common.size:
        x, y, z = mesh.p[:, common[0]]
        raise InputError(
            f'{what}: the electrodes "{hot}" and "{ground}" touch at {common.size} points, the first at '
            f"({x:.4g}, {y:.4g}, {z:.4g}) m, and would be short-circuited; leave a gap between them"
        )
