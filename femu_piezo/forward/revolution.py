"""Bodies of revolution poled along their axis: the forms of one Fourier order on a section over r and z.

With θ counted from a plane of symmetry, the fields of order n are

    u_r, u_z, φ ∝ cos nθ,    u_θ ∝ sin nθ,

and the gradient of (u_r, u_θ, u_z, φ) along r, θ, z is

    ∂_r u_r    −(n u_r + u_θ)/r    ∂_z u_r
    ∂_r u_θ     (n u_θ + u_r)/r    ∂_z u_θ
    ∂_r u_z    −n u_z/r            ∂_z u_z
    ∂_r φ      −n φ/r              ∂_z φ.

The extended tensor of a crystal poled along z is the same in the frame (r, θ, z) at every angle, so the forms are those
of `femu_piezo.forward.gradient_products` with these twelve gradients and ∫ cos² nθ dθ r dr dz; the components of the
tensor that would couple a cosine to a sine are zero. As the gradient is linear in n, the operator is
K = K_0 + n K_1 + n² K_2 times ∫ cos² nθ dθ, and K_0, K_1, K_2 are assembled once for all orders. The section has half
the height of the body; the parity of a field about the mid-plane is that of the field that the terminals drive, or the
opposite. Integrals are those over an eighth of the body.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import scipy.sparse as sp
from scipy.interpolate import BarycentricInterpolator

from femu_piezo.forward.electrodes import Faces, of_field
from femu_piezo.forward.gradient_products import FIELDS
from femu_piezo.forward.hex_element import lobatto_nodes
from femu_piezo.forward.model import POTENTIAL_SCALE
from femu_piezo.forward.parity import modes_below
from femu_piezo.geometry.shape import wave_error
from femu_piezo.threads import Once, made_once

#: Orders of the elements along r and z, and the relative eigenvalue error for which their number is chosen.
_ORDERS, _ACCURACY = (8, 5), 1e-5


@dataclass(frozen=True)
class Line:
    """Lagrange elements along one axis.

    Attributes
    ----------
    ends : (m + 1,) where elements meet, growing, m
    order : of the elements
    """

    ends: np.ndarray
    order: int

    @classmethod
    def fine_for(cls, low: float, high: float, order: int, wavenumber: float) -> Line:
        """The fewest elements of an order that follow waves of a wavenumber, 1/m."""
        count = 1
        while wave_error(order, wavenumber * (high - low) / count) > _ACCURACY:
            count += 1
        return cls(np.linspace(low, high, count + 1), order)

    @made_once
    def places(self) -> np.ndarray:
        """(n,) coordinates of the nodes, growing, m."""
        inner = self.ends[:-1, None] + np.diff(self.ends)[:, None] * lobatto_nodes(self.order)[:-1]
        return np.append(inner.ravel(), self.ends[-1])

    @made_once
    def gauss(self) -> tuple[np.ndarray, np.ndarray]:
        """Gauss points and weights (q,), m: order + 2 points in each element, exact up to degree 2 order + 3."""
        points, weights = np.polynomial.legendre.leggauss(self.order + 2)
        half, middle = np.diff(self.ends)[:, None] / 2, (self.ends[1:, None] + self.ends[:-1, None]) / 2
        return (middle + half * points).ravel(), (half * weights).ravel()

    @made_once
    def at_gauss(self) -> tuple[sp.csr_matrix, sp.csr_matrix]:
        """`shapes` at the Gauss points: values and slopes, each (q, n)."""
        return self.shapes(self.gauss[0])

    def shapes(self, points: np.ndarray) -> tuple[sp.csr_matrix, sp.csr_matrix]:
        """(q, n) values and slopes of the functions of all nodes at points (q,)."""
        element = np.clip(np.searchsorted(self.ends, points, side="right") - 1, 0, self.ends.size - 2)
        found = [sp.lil_matrix((points.size, self.places.size)) for _ in range(2)]
        for number in range(self.ends.size - 1):
            here, nodes = np.flatnonzero(element == number), number * self.order + np.arange(self.order + 1)
            lagrange = BarycentricInterpolator(self.places[nodes], np.eye(nodes.size), rng=0)
            for matrix, part in zip(found, (lagrange(points[here]), lagrange.derivative(points[here])), strict=True):
                matrix[np.ix_(here, nodes)] = part
        return found[0].tocsr(), found[1].tocsr()


@dataclass(frozen=True)
class Section:
    """Section of the upper half of a body of revolution: inner ≤ r ≤ outer, 0 ≤ z ≤ t/2, an electrode at z = t/2.

    Attributes
    ----------
    radial, axial : elements along r and z;  density : kg/m³
    """

    radial: Line
    axial: Line
    density: float
    _kept: Once = field(default_factory=lambda: Once(latest=1), init=False, repr=False, compare=False)

    @classmethod
    def fine_for(cls, radii: tuple[float, float], thickness: float, density: float, wavenumber: float) -> Section:
        """The section whose elements follow waves of a wavenumber, 1/m, along the radius and through the height."""
        ends = (radii, (0.0, thickness / 2))
        radial, axial = (Line.fine_for(*pair, order, wavenumber) for pair, order in zip(ends, _ORDERS, strict=True))
        return cls(radial, axial, density)

    @property
    def size(self) -> int:
        """Number n of nodes; their number along z varies fastest."""
        return self.radial.places.size * self.axial.places.size

    def to_nodes_of(self, other: Section) -> sp.csr_matrix:
        """(n_other, n) matrix that interpolates nodal values at the n_other nodes of another section."""
        lines = ((self.radial, other.radial), (self.axial, other.axial))
        return sp.kron(*(here.shapes(there.places)[0] for here, there in lines), format="csr")

    def order(self, number: int) -> FourierOrder:
        """The forms of one Fourier order."""
        return FourierOrder(self, number)

    @made_once
    def radii(self) -> np.ndarray:
        """(q,) r of the Gauss points, m."""
        return np.repeat(self.radial.gauss[0], self.axial.gauss[0].size)

    @made_once
    def heights(self) -> np.ndarray:
        """(q,) z of the Gauss points, m."""
        return np.tile(self.axial.gauss[0], self.radial.gauss[0].size)

    @made_once
    def weights(self) -> np.ndarray:
        """(q,) weights of the Gauss points in ∫ r dr dz: volumes per radian, m³."""
        (r, weight_r), (_, weight_z) = self.radial.gauss, self.axial.gauss
        return np.outer(r * weight_r, weight_z).ravel()

    @made_once
    def values(self) -> sp.csr_matrix:
        """(q, n) values of all shape functions at the Gauss points."""
        return sp.kron(self.radial.at_gauss[0], self.axial.at_gauss[0], format="csr")

    @made_once
    def _slopes(self) -> tuple[sp.csr_matrix, sp.csr_matrix]:
        """∂/∂r and ∂/∂z of all shape functions at the Gauss points, each (q, n)."""
        (value_r, slope_r), (value_z, slope_z) = self.radial.at_gauss, self.axial.at_gauss
        return sp.kron(slope_r, value_z, format="csr"), sp.kron(value_r, slope_z, format="csr")

    def gradients(self, number: int) -> list[list[sp.csr_matrix]]:
        """[f][a] → (q, 4n) gradient of field f of a Fourier order along r, θ, z at the Gauss points."""
        slopes_r, slopes_z = self._slopes
        plane = _in_plane(self.values, slopes_r, self.radii, number)
        return [[*plane[f], of_field(slopes_z, f)] for f in range(FIELDS)]

    def stiffness_by_order(self, tensor: np.ndarray) -> list[sp.csr_matrix]:
        """K_0, K_1, K_2, each (4n, 4n), of an extended tensor (4, 3, 4, 3), per radian; kept for the latest tensor."""
        return self._kept.get(tensor.tobytes(), lambda: self._stiffness_by_order(tensor))

    def _stiffness_by_order(self, tensor: np.ndarray) -> list[sp.csr_matrix]:
        # the gradient of order n is constant + n linear
        constant, first, weighted = self.gradients(0), self.gradients(1), sp.diags(self.weights)
        linear = [[at_1 - at_0 for at_1, at_0 in zip(*row, strict=True)] for row in zip(first, constant, strict=True)]
        by_power, found = (constant, linear), [sp.csr_matrix((FIELDS * self.size,) * 2) for _ in range(3)]
        for f, a in zip(*np.nonzero(np.any(tensor, axis=(2, 3))), strict=True):
            coupled = list(zip(*np.nonzero(tensor[f, a]), strict=True))
            for power, gradients in enumerate(by_power):
                stress = weighted @ sum(tensor[f, a, g, b] * gradients[g][b] for g, b in coupled)
                for power_of_strain, strains in enumerate(by_power):
                    total = power_of_strain + power
                    found[total] = found[total] + strains[f][a].T @ stress
        return [matrix.tocsr() for matrix in found]


class FourierOrder:
    """Forms of one Fourier order on vectors (4n,) of the nodal values of u_r, u_θ, u_z and φ, one field after another.

    Attributes
    ----------
    radii, heights, weights : (q,) of the Gauss points: r and z, m, and the weights of volume integrals, m³
    """

    def __init__(self, section: Section, number: int) -> None:
        self.section, self.number = section, number
        # ∫ cos² nθ dθ over a quarter turn; with half the height, an eighth of the body
        self._turn = np.pi / (4 if number else 2)
        self.radii, self.heights, self.weights = section.radii, section.heights, section.weights * self._turn

    @property
    def size(self) -> int:
        """4n"""
        return FIELDS * self.section.size

    @made_once
    def gradients(self) -> list[list[sp.csr_matrix]]:
        """[f][a] → (q, 4n) gradient of field f along r, θ, z at the Gauss points."""
        return self.section.gradients(self.number)

    def stiffness(self, tensor: np.ndarray) -> sp.csr_matrix:
        """(4n, 4n) stiffness of an extended tensor (4, 3, 4, 3)."""
        k0, k1, k2 = self.section.stiffness_by_order(tensor)
        return (self._turn * (k0 + self.number * k1 + self.number**2 * k2)).tocsr()

    @made_once
    def mass(self) -> sp.csr_matrix:
        """(4n, 4n) mass, kg; zero in the potential."""
        values = self.section.values
        block = self.section.density * (values.T @ sp.diags(self.weights) @ values)
        return sp.block_diag([*[block] * 3, sp.csr_matrix(block.shape)], format="csr")

    @made_once
    def electrode_faces(self) -> Faces:
        """The electrode at the top of the section, z = t/2."""
        section = self.section
        r, weight_r = section.radial.gauss
        top = sp.csr_matrix(([1.0], ([0], [section.axial.places.size - 1])), shape=(1, section.axial.places.size))
        value, slope = (sp.kron(radial, top, format="csr") for radial in section.radial.at_gauss)
        values = [of_field(value, f) for f in range(FIELDS)]
        return Faces(r * weight_r * self._turn, values, _in_plane(value, slope, r, self.number))

    def at_points(self, fields: np.ndarray) -> np.ndarray:
        """(4, 3, q, k) gradients of fields (4n, k) at the Gauss points."""
        return np.array([[g @ fields for g in row] for row in self.gradients])

    def between(
        self, left: np.ndarray, right: np.ndarray, tensors: Sequence[np.ndarray], weight: np.ndarray | float = 1.0
    ) -> np.ndarray:
        """(n_tensors, k, l) vᵗA w of extended tensors, each (4, 3, 4, 3), on fields v (4n, k) and w (4n, l).

        weight : (q,) factor of the integrand at the Gauss points
        """
        return self.joined(self.at_points(left), self.at_points(right), tensors, weight)

    def joined(
        self, before: np.ndarray, after: np.ndarray, tensors: Sequence[np.ndarray], weight: np.ndarray | float = 1.0
    ) -> np.ndarray:
        """(n_tensors, k, l) `between` of fields given by gradients (4, 3, q, k), (4, 3, q, l) at the Gauss points."""
        tensors, volume = np.asarray(tensors), (self.weights * weight)[:, None]
        found = np.zeros((len(tensors), before.shape[3], after.shape[3]))
        for f, a, g, b in zip(*np.nonzero(np.any(tensors, axis=0)), strict=True):
            image = before[f, a].T @ (volume * after[g, b])
            for number in np.flatnonzero(tensors[:, f, a, g, b]):
                found[number] += tensors[number, f, a, g, b] * image
        return found

    def load(self, flow: np.ndarray) -> np.ndarray:
        """(4n, k) nodal forces and charges of stresses and electric displacements (4, 3, q, k) at the Gauss points."""
        volume = self.weights[:, None]
        return sum(self.gradients[f][a].T @ (volume * flow[f, a]) for f in range(FIELDS) for a in range(flow.shape[1]))

    def momentum(self, fields: np.ndarray, weight: np.ndarray) -> np.ndarray:
        """(4n, k) ∫ ρ weight v·u over u_r and u_z alone of fields (4n, k), kg; weight (q,) at the Gauss points.

        It serves fields of order 0, which have no u_θ, and the factor of cos nθ in a density as the weight.
        """
        volume, n = (self.section.density * self.weights * weight)[:, None], self.section.size
        found = np.zeros_like(fields)
        for f in (0, 2):
            rows = slice(f * n, (f + 1) * n)
            found[rows] = self.section.values.T @ (volume * (self.section.values @ fields[rows]))
        return found

    def within(self, fields: np.ndarray, tensors: Sequence[np.ndarray], weight: np.ndarray | float = 1.0) -> np.ndarray:
        """(n_tensors, k, k) symmetric: `between` of fields (4n, k) with themselves."""
        found = self.between(fields, fields, tensors, weight)
        return (found + found.transpose(0, 2, 1)) / 2

    def free(self, flipped: bool) -> sp.csr_matrix:
        """(4n, m) from the free unknowns to all nodal values; electrode at zero, potentials scaled as in the model.

        Fields are smooth on the axis: order 0 has u_z and φ, order 1 a translation u_r = −u_θ, higher orders vanish.

        flipped : whether the parity about the mid-plane is the opposite of the driven field's
        """
        section, number = self.section, self.number
        shape = (FIELDS, section.radial.places.size, section.axial.places.size)
        held = np.zeros(shape, dtype=bool)
        held[(0, 1) if flipped else (2, 3), :, 0] = True
        held[3, :, -1] = True
        held[1] |= number == 0
        axis = section.radial.places[0] == 0
        if axis:
            held[{0: [0, 1], 1: [1, 2, 3]}.get(number, [0, 1, 2, 3]), 0] = True
        free = np.flatnonzero(~held.ravel())
        values = np.where(free >= 3 * section.size, POTENTIAL_SCALE, 1.0)
        found = sp.lil_matrix(sp.csr_matrix((values, (free, np.arange(free.size))), shape=(self.size, free.size)))
        if axis and number == 1:
            shifted = np.flatnonzero(free < section.axial.places.size)  # u_r on the axis
            found[section.size + free[shifted], shifted] = -1.0
        return found.tocsr()

    def modes(self, tensor: np.ndarray, flipped: bool, top: float) -> np.ndarray:
        """(4n, k) fields of all modes with ω² below `top`, rigid-body modes included, uᵗMu = 1."""
        p = self.free(flipped)
        return p @ modes_below((p.T @ self.stiffness(tensor) @ p).tocsr(), (p.T @ self.mass @ p).tocsr(), top)


def _in_plane(values: sp.csr_matrix, slopes: sp.csr_matrix, radii: np.ndarray, n: int) -> list[list[sp.csr_matrix]]:
    """[f][a] → (q, 4n) gradients of order n along r and θ, from values and r slopes (q, n) of the shape functions."""
    over_r = sp.diags(1 / radii) @ values
    u_r, u_theta, u_z, potential = (of_field(over_r, f) for f in range(FIELDS))
    around = [-(n * u_r + u_theta), n * u_theta + u_r, -n * u_z, -n * potential]
    return [[of_field(slopes, f), around[f].tocsr()] for f in range(FIELDS)]
