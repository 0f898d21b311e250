"""`Domain`: a mesh with named boundaries and what they mean electrically and by symmetry."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
import skfem

from femu_piezo.errors import InputError
from femu_piezo.geometry.curved_mesh import CurvedHexahedra
from femu_piezo.geometry.quality import mean_normal


@dataclass(frozen=True)
class Domain:
    """The part of a specimen that is computed, and the factors from the part to the whole specimen.

    Attributes
    ----------
    mesh : scikit-fem mesh with named boundaries, coordinates in m
    hot, ground : names of the boundaries that carry the two electrodes. On a plane of antisymmetric potential
        (the mid-plane between the electrodes) φ = 0, so that plane is the ground of the part.
    symmetry : boundary name → axis (0, 1, 2) whose displacement vanishes there
    copies : how many copies of the part make the specimen
    voltage_factor : terminal voltage of the specimen / potential of `hot` in the part
    poling : (3,) direction of poling in specimen axes
    order : polynomial order of the elements that the mesh is made for
    radii : inner (0 for a disk) and outer radius, m, where the part is an eighth of a disk or ring with fully covered
        faces, poled along its axis z; None for others
    rim_error : expected relative error of eigenvalues from the singular field where electrodes end inside faces; 0
        where no electrode does
    """

    mesh: skfem.Mesh
    hot: tuple[str, ...]
    ground: tuple[str, ...]
    symmetry: Mapping[str, int] = field(default_factory=dict)
    copies: int = 1
    voltage_factor: float = 1.0
    poling: tuple[float, float, float] = (0.0, 0.0, 1.0)
    order: int = 2
    rim_error: float = 0.0
    radii: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        known = self.mesh.boundaries or {}
        for name in (*self.hot, *self.ground, *self.symmetry):
            if name not in known:
                raise InputError(
                    f'the mesh has no boundary named "{name}"; it has {", ".join(sorted(known)) or "none"}'
                )
        if not self.hot or not self.ground:
            raise InputError("a domain needs at least one boundary for each of the hot and ground electrodes")

    def has_mesh_of(self, other: Domain) -> bool:
        """Whether mesh and element order equal those of another domain."""
        if self.order != other.order or type(self.mesh) is not type(other.mesh):
            return False
        return np.array_equal(self.mesh.doflocs, other.mesh.doflocs) and np.array_equal(self.mesh.t, other.mesh.t)

    @property
    def admittance_factor(self) -> float:
        """Y of the specimen / Y of the part: stored energy scales with `copies`, voltage with `voltage_factor`."""
        return self.copies / self.voltage_factor**2

    @property
    def poling_along_field(self) -> float:
        """|cos| of the angle between the poling and the mean normal of the hot electrode."""
        facets = np.concatenate([self.mesh.boundaries[name] for name in self.hot])
        normal = mean_normal(skfem.FacetBasis(self.mesh, self.mesh.elem(), facets=facets))
        return float(abs(np.dot(self.poling, normal)) / (np.linalg.norm(self.poling) * np.linalg.norm(normal)))

    @property
    def volume(self) -> float:
        """Volume of the whole specimen, m³."""
        order = 12 if isinstance(self.mesh, CurvedHexahedra) else None
        basis = skfem.Basis(self.mesh, self.mesh.elem(), intorder=order)
        return float(np.sum(basis.dx)) * self.copies
