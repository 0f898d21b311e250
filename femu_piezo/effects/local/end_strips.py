"""Bare strips at the ends of a plate (`femu_piezo.effects.local.bare_strips`).

Strips of unequal widths m₊ and m₋ at the ends of a plate couple the driven fields to those that are odd about the
middle. Let P = ±1 for even and odd fields, T(m) be twice the S of a strip at one end alone, and D(m) the rest of the S
of equal strips at both ends, whose ψ interact by the base fields that are subtracted. Then

    S(m₊, m₋) = ½ [T(m₊) + P T(m₋) P] + D(√(m₊ m₋)).

Against the independent solver the effect of equal strips is off by up to 2 % from 0.25 mm on, on plates of 1 and
1.5 mm, and by up to 5 % where they are as much as twelve thicknesses wide. That of unequal ones is off by up to 8 %
there; on thin plates, the wider strip many thicknesses wide, by a tenth and more, up to more than the whole effect.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np
import scipy.sparse as sp
import skfem

from femu_piezo.effects.local.bare_strips import (
    ORDER,
    REACH,
    ROUNDING,
    WIDEST,
    Answers,
    BareStrips,
    Base,
    Part,
    answers,
    deep,
    graded,
    in_region,
    strips_at_nodes,
)
from femu_piezo.effects.local.blocks import Blocks
from femu_piezo.effects.local.sectors import Sectors
from femu_piezo.forward.box_interpolation import interpolation
from femu_piezo.forward.free_pattern import FreePattern
from femu_piezo.forward.gradient_products import FIELDS, GradientProducts, assemble_gradient_products
from femu_piezo.forward.hex_element import ElementHexP, node_places
from femu_piezo.forward.model import ElectroelasticModel
from femu_piezo.geometry.boxes import divided, grid_lines


def compute_bare_ends(sectors: Sectors) -> BareStrips:
    """S of strips m (1 ± a) wide, up to a tenth of the length of a plate whose electrodes are on the large faces.

    sectors : the driven one and, for strips of two widths, the modes that are odd about the middle
    """
    model, constants = sectors.all_fields.model, sectors.all_fields.constants
    fields = sectors.all_fields.fields(sectors.names).reshape(-1, sectors.size)
    forms = _BoxForms(model.products, model.density)
    base = Base.of(sectors, fields, forms, constants, model.unit_tensors)
    sign, half = np.where(base.odd, -1.0, 1.0), np.array([0.5])

    def parts(single: np.ndarray, rest: np.ndarray) -> tuple[Part, ...]:
        right, together = (Blocks(one, base.kept, sectors.size) for one in (single[0], rest))
        left = Blocks(single[0] * sign[:, None] * sign, base.kept, sectors.size)
        return Part(right, _wider, half), Part(left, _narrower, half), Part(together, _mean, np.ones(1))

    widest = WIDEST * 2 * model.domain.mesh.p[0].max()
    return strips_at_nodes(widest, lambda width: _bare_end(model, base, width), parts, bool(np.any(base.odd)))


def _wider(asymmetry: float) -> tuple[np.ndarray, np.ndarray]:
    """m₊/m and its slope in a."""
    return np.array([1 + asymmetry]), np.ones(1)


def _narrower(asymmetry: float) -> tuple[np.ndarray, np.ndarray]:
    """m₋/m and its slope in a."""
    return np.array([1 - asymmetry]), -np.ones(1)


def _mean(asymmetry: float) -> tuple[np.ndarray, np.ndarray]:
    """√(m₊ m₋)/m and its slope in a."""
    ratio = np.sqrt(max(1 - asymmetry**2, ROUNDING))
    return np.array([ratio]), np.array([-asymmetry / ratio])


class _BoxForms:
    """`Forms` on a box, with what its answers need."""

    def __init__(self, products: GradientProducts, density: float) -> None:
        self._products, self.mass = products, products.mass_matrix(density)

    def charges(self, tensor: np.ndarray, nodes: np.ndarray, fields: np.ndarray) -> np.ndarray:
        """(s, k) charges that fields (4n, k) leave on nodes (s,) by an extended tensor."""
        found = np.zeros((nodes.size, fields.shape[1]))
        for coefficients, part in zip(tensor[3].transpose(1, 0, 2), np.split(fields, FIELDS), strict=True):
            if np.any(coefficients):
                found += self._products.scalar(self._products.combine(coefficients))[nodes] @ part
        return found

    def restricted(self, tensor: np.ndarray, prolongation: sp.csr_matrix) -> sp.csr_matrix:
        """PᵗKP (m, m) of an extended tensor."""
        return FreePattern(self._products, prolongation, electrode=False).stiffness(tensor)

    def between(self, left: np.ndarray, right: np.ndarray, tensors: Sequence[np.ndarray]) -> np.ndarray:
        fields = [side.reshape(FIELDS, self._products.size, -1) for side in (left, right)]
        return self._products.between(*fields, tensors)

    def within(self, fields: np.ndarray, tensors: Sequence[np.ndarray]) -> np.ndarray:
        return self._products.within(fields.reshape(FIELDS, self._products.size, -1), tensors)


def _bare_end(model: ElectroelasticModel, base: Base, width: float) -> np.ndarray:
    """∂T/∂c and ∂D/∂c (2, 10, k, k) of the strip at one end of a plate."""
    length, _, height = model.domain.mesh.p.max(axis=1)
    start = max(0.0, length - width - 2 * REACH * height)
    lines = (
        graded(start, length - width, length, height),
        divided(grid_lines(model.domain.mesh)[1], model.domain.order // ORDER),
        deep(height),
    )
    basis = skfem.Basis(skfem.MeshHex.init_tensor(*lines), ElementHexP(ORDER), intorder=2 * ORDER)
    x, y, z = places = node_places(basis)
    top = np.isclose(z, height, rtol=0, atol=1e-9 * height)
    held = np.zeros((FIELDS, basis.N), dtype=bool)
    held[:, np.isclose(x, start, rtol=0, atol=1e-9 * length) & (start > 0)] = True
    held[0, x == 0] = True
    held[1, y == 0] = True
    held[2:, z == 0] = True
    held[3, top] = True
    strip = np.flatnonzero(top & (x > length - width + 1e-9 * length))
    forms = _BoxForms(assemble_gradient_products(basis), model.density)
    return _freed(forms, held, strip, interpolation(model, places), base)


def _freed(forms: _BoxForms, held: np.ndarray, strip: np.ndarray, probe: sp.csr_matrix, base: Base) -> np.ndarray:
    """∂T/∂c and ∂D/∂c (2, 10, k, k) of a region with one strip; without odd base fields all of S is in T.

    Parameters
    ----------
    held : (4, n) values that are zero while the electrode covers the strip;  strip : nodes whose potential is freed
    probe : (n, nodes of the body) values of a field in the region
    """
    interpolated = in_region(probe, base.fields)
    charges = forms.charges(base.tensor, strip, interpolated)
    found = answers(partial(forms.restricted, base.tensor), held, strip, charges)
    answered = Answers.of(forms, interpolated, found, base.units)
    equal = answered.condensed(base, ~base.odd, 1.0)  # S of equal strips at both ends
    if not np.any(base.odd):
        return np.array([equal, np.zeros_like(equal)])
    equal += answered.condensed(base, base.odd, 1.0)
    apart = 2 * answered.condensed(base, np.ones_like(base.odd), 0.5)
    return np.array([apart, (equal - apart) * (base.odd[:, None] == base.odd)])
