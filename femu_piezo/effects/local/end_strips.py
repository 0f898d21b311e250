"""Bare strips at the two ends of a thickness-poled plate: what freeing the potential there does to the reduced plate.

A base field x leaves the charge R x on the strip, where its potential was held. Set free, the potential moves by
ψ = −G R x with the local compliance G of the end region, and the operator by

    S(m) = −Rᵗ G R = Rᵗψ + ψᵗR + ψᵗKψ    per base field.

The last form is stationary in ψ, so its parts per unit constant are exact derivatives of S; and since S is homogeneous
of degree one in the constants, it is the sum of constant times derivative. G
comes from a mesh of the end region alone, graded to the edge of the electrode at L/2 − m, where the field is singular;
inertia plays no part over such lengths. S starts as m² and is interpolated between a few strips.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import skfem
from scipy.interpolate import BarycentricInterpolator

from femu_piezo.effects.local.blocks import Blocks
from femu_piezo.effects.local.sectors import Sectors
from femu_piezo.forward.box_interpolation import interpolation
from femu_piezo.forward.gradient_products import FIELDS, assemble_gradient_products
from femu_piezo.forward.linear_solver import factorize
from femu_piezo.forward.model import POTENTIAL_SCALE, ElectroelasticModel
from femu_piezo.material.constants import ElasticForm
from femu_piezo.threads import in_parallel

#: Widest strip as a share of the plate's length, and where S is computed, as shares of that.
WIDEST = 0.1
_NODES = np.array([0.06, 0.22, 0.45, 0.72, 1.0])
#: Reach of the end region beyond the strip, in thicknesses; elements over width and half thickness.
_REACH, _ACROSS, _DEEP = 2.5, 2, 4
#: Growth of element lengths away from the electrode's edge, and the smallest, in half thicknesses.
_GROWTH, _SMALLEST = 1.7, 0.01
#: Share of the largest pattern of charge on a strip below which one is rounding.
_ROUNDING = 1e-9


@dataclass(frozen=True)
class BareEnds:
    """S at strips of several widths.

    Attributes
    ----------
    widths : (n,) m
    matrices : [n, 10] (r, r) ∂S/∂c of every e-form constant at the reference
    """

    widths: np.ndarray
    matrices: Blocks

    def at(self, width: float) -> tuple[np.ndarray, np.ndarray]:
        """∂S/∂c (10, r, r) at a width, (m/m_k)² times Lagrange polynomials, and its slope by the width."""
        lagrange = BarycentricInterpolator(self.widths, np.eye(self.widths.size))
        value, slope = lagrange(width), lagrange.derivative(width)
        square = self.widths**2
        shares = value * width**2 / square, (slope * width**2 + 2 * width * value) / square
        value, slope = (self.matrices.combined(weights) for weights in shares)
        return value, slope

    def among(self, numbers: np.ndarray, size: int) -> BareEnds:
        """The same over `size` unknowns, of which those so far are the given ones (indices)."""
        return BareEnds(self.widths, self.matrices.among(numbers, size))


def measure_bare_ends(model: ElectroelasticModel, driven: Sectors, constants: ElasticForm) -> BareEnds:
    """S of strips up to a tenth of the length of a plate whose electrodes are on the large faces.

    driven : the driven sector alone
    constants : lossless reference
    """
    fields, kept = _condensed(model, driven.all_fields.fields(driven.names), driven.displacements, constants)
    widths = _NODES * WIDEST * 2 * model.domain.mesh.p[0].max()
    inner = np.array(list(in_parallel(lambda width: _freed(model, fields, constants, float(width)), widths)))
    return BareEnds(widths, Blocks(inner, kept, driven.size))


def _condensed(
    model: ElectroelasticModel, fields: np.ndarray, displacements: int, constants: ElasticForm
) -> tuple[np.ndarray, np.ndarray]:
    """Fields (4, n, k) of the displacement unknowns and of the hot potential, inner potentials following them.

    Also the numbers (k,) of these unknowns. What the inner potentials do for a strip, ψ does.
    """
    size = fields.shape[2]
    (matrix,) = model.products.within(fields, [np.tensordot(constants.vector().real, model.unit_tensors, axes=1)])
    inner, kept = np.arange(displacements, size - 1), np.append(np.arange(displacements), size - 1)
    follow = -np.linalg.solve(matrix[np.ix_(inner, inner)], matrix[np.ix_(inner, kept)])
    return fields[:, :, kept] + fields[:, :, inner] @ follow, kept


def _freed(model: ElectroelasticModel, fields: np.ndarray, constants: ElasticForm, width: float) -> np.ndarray:
    """∂S/∂c (10, k, k) of one strip on fields (4, n, k)."""
    length, breadth, height = model.domain.mesh.p.max(axis=1)
    start = max(0.0, length - width - 2 * _REACH * height)
    lines = (
        _graded(start, length - width, length, height),
        np.linspace(0.0, breadth, _ACROSS + 1),
        height * (1 - np.linspace(1.0, 0.0, _DEEP + 1) ** 2),
    )
    basis = skfem.Basis(skfem.MeshHex.init_tensor(*lines), skfem.ElementHex2(), intorder=4)
    x, y, z = basis.doflocs
    n = basis.N
    products = assemble_gradient_products(basis)
    operator = products.stiffness(np.tensordot(constants.vector().real, model.unit_tensors, axes=1))
    top = np.isclose(z, height, rtol=0, atol=1e-9 * height)
    strip = np.flatnonzero(top & (x > length - width + 1e-9 * length))
    held = np.zeros((FIELDS, n), dtype=bool)
    held[:, np.isclose(x, start, rtol=0, atol=1e-9 * length) & (start > 0)] = True
    held[0, x == 0] = True
    held[1, y == 0] = True
    held[2:, z == 0] = True
    held[3, top] = True
    held[3, strip] = False
    free = np.flatnonzero(~held.ravel())
    scale = np.where(free >= 3 * n, POTENTIAL_SCALE, 1.0)
    local = operator[free][:, free].multiply(scale).T.multiply(scale).tocsr()
    probe = interpolation(model, basis.doflocs)
    interpolated = np.concatenate([probe @ part for part in fields])
    rows = 3 * n + strip
    patterns, along = _patterns(operator[rows] @ interpolated)
    right = np.zeros((free.size, patterns.shape[1]))
    right[np.searchsorted(free, rows)] = patterns * POTENTIAL_SCALE
    factor = factorize(local)
    held_out = products.mass_matrix(model.density)[free] @ interpolated[:, :-1]
    image = factor.solve(held_out)
    response = factor.solve(right)
    response -= image @ np.linalg.lstsq(held_out.T @ image, held_out.T @ response, rcond=1e-10)[0]
    moved = np.zeros((interpolated.shape[0], response.shape[1]))
    moved[free] = -scale[:, None] * response
    moved, interpolated = moved.reshape(FIELDS, n, -1), interpolated.reshape(FIELDS, n, -1)
    freed = np.zeros_like(moved)
    freed[3, strip] = moved[3, strip]
    crossed = along.T @ products.between(freed, interpolated, model.unit_tensors, strip)
    return crossed + crossed.transpose(0, 2, 1) + along.T @ products.within(moved, model.unit_tensors) @ along


def _patterns(charges: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The few patterns P (n, r) that smooth fields leave on a strip, and C (r, k): P C = charges (n, k)."""
    left, singular, right = np.linalg.svd(charges, full_matrices=False)
    few = singular > _ROUNDING * singular[0]
    return left[:, few], singular[few, None] * right[few]


def _graded(start: float, edge: float, end: float, height: float) -> np.ndarray:
    """Lines along x, finest at the electrode's edge, at most half a height apart."""
    steps = [_SMALLEST * height]
    while sum(steps) < max(edge - start, end - edge):
        steps.append(min(steps[-1] * _GROWTH, 0.7 * height))
    away = np.concatenate([[0.0], np.cumsum(steps)])
    left, right = (_fitted(away, reach) for reach in (edge - start, end - edge))
    return np.concatenate([edge - left[:0:-1], edge + right])


def _fitted(away: np.ndarray, reach: float) -> np.ndarray:
    """The first distances, stretched to end at `reach` exactly."""
    count = int(np.searchsorted(away, reach * (1 - 1e-9))) + 1
    return away[:count] * (reach / away[count - 1])
