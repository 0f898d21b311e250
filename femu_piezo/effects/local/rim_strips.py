"""Bare strips along the rims of a disk or ring, all of one width or left by an electrode that is off the centre.

An electrode off the centre by a times m leaves strips m (1 − a cos θ) wide along an outer rim and m (1 + a cos θ) along
an inner one, which couple the driven fields to those of Fourier order 1. A strip is narrow against its radius, so the
body is taken at θ as with a strip of uniform width m(θ). Let T_nn'(m) be the S of one rim between fields of orders n
and n' as they are at θ = 0 (`femu_piezo.effects.local.bare_strips`), and D_nn(m) the rest of the S of all rims
together. Then

    S_nn' = Σ ⟨cosⁿθ cosⁿ'θ T_nn'(m(θ))⟩ + ⟨cos²ⁿθ⟩ D_nn(m)

over the rims, ⟨ ⟩ the mean over θ. T_00 and T_11 are those of strips of uniform width, from whose ψ the base fields of
their order and momentum are subtracted; between the orders the mean of both ψᵗKψ is taken. Against a full solution the
sum is exact to 0.2 % (disk) and 2 % (ring) at a = 0; the change by a, proportional to a², has the right shape but is
off by 40 % and 5 %, so that a is found 15 % and 2 % too small: the fields of order 1 do not represent all of the
response to a wider strip on one side. More of them near the rim do not help: S assumes fields that are slow across it.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np

from femu_piezo.effects.local.bare_strips import (
    ORDER,
    REACH,
    WIDEST,
    Answers,
    BareStrips,
    Base,
    Part,
    answers,
    deep,
    graded,
    in_region,
    stationary,
    strips_at_nodes,
)
from femu_piezo.effects.local.blocks import Blocks
from femu_piezo.effects.local.round_fields import ORDERS, RIMS, RoundFields
from femu_piezo.effects.local.sectors import DRIVEN, Sectors
from femu_piezo.forward.gradient_products import FIELDS
from femu_piezo.forward.revolution import Line, Section

#: cos θ at the angles over half a turn at which the width is taken.
_COSINES = np.cos(np.pi * (np.arange(12) + 0.5) / 12)


def compute_bare_rims(sectors: Sectors) -> BareStrips:
    """S of strips m (1 ∓ a cos θ) wide along the rims of a disk or ring, up to a tenth of the way across.

    sectors : the driven one and those of order 1
    """
    fields: RoundFields = sectors.all_fields
    base, widest = _base(sectors), WIDEST * float(np.ptp(fields.model.domain.radii))
    orders = base.odd[:, None].astype(int) + base.odd  # n + n'

    def parts(rims: np.ndarray, rest: np.ndarray) -> tuple[Part, ...]:
        found = [Part(Blocks(rest, base.kept, sectors.size), _uniform, np.ones(1))]
        for side, rim in zip((-1.0, 1.0), rims, strict=False):
            for power in range(3):
                blocks = Blocks(rim * (orders == power), base.kept, sectors.size)
                found.append(Part(blocks, partial(_along, side), _weights(power)))
        return tuple(found)

    return strips_at_nodes(widest, lambda width: _freed(fields, base, width), parts, unequal=True)


def _uniform(asymmetry: float) -> tuple[np.ndarray, np.ndarray]:
    """Mean width over m, and its slope in a."""
    return np.ones(1), np.zeros(1)


def _along(side: float, asymmetry: float) -> tuple[np.ndarray, np.ndarray]:
    """Width over m at the angles, along the outer rim (side −1) or the inner one (1), and its slope in a."""
    return 1 + side * asymmetry * _COSINES, side * _COSINES


def _weights(power: int) -> np.ndarray:
    """Weights of the angles in the mean ⟨cosᵖθ ·⟩."""
    return _COSINES**power / _COSINES.size


def _base(sectors: Sectors) -> Base:
    """Driven fields, fields of order 1 (`odd`) and the hot potential; forms and momenta of order 1 as at θ = 0."""
    fields: RoundFields = sectors.all_fields
    even, odd, units = fields.order(0), fields.order(1), fields.model.unit_tensors
    plain = Base.of(Sectors((DRIVEN,), fields), fields.on_section, even, fields.constants, units)
    names = [name for name in sectors.names if name in (ORDERS[1], RIMS)]
    first_order, numbers = fields.of_order(1, names), sectors.numbers(names)
    moving, count = plain.kept.size - 1, first_order.shape[1]
    at, driven = moving + np.arange(count), np.append(np.arange(moving), moving + count)
    bulk, momenta = np.zeros((len(units), *[plain.kept.size + count] * 2)), np.zeros([moving + count] * 2)
    bulk[(..., *np.ix_(driven, driven))], momenta[:moving, :moving] = plain.bulk, plain.momenta
    bulk[(..., *np.ix_(at, at))] = 2 * odd.within(first_order, units)
    momenta[moving:, moving:] = 2 * first_order.T @ (odd.mass @ first_order)
    return replace(
        plain,
        kept=np.insert(sectors.numbers([DRIVEN])[plain.kept], moving, numbers),
        odd=np.isin(np.arange(plain.kept.size + count), at),
        fields=np.insert(plain.fields, [moving] * count, first_order, axis=1),
        bulk=bulk,
        momenta=momenta,
    )


def _freed(fields: RoundFields, base: Base, width: float) -> np.ndarray:
    """(2 or 3, 10, k, k): ∂T/∂c of the outer rim, of the inner one of a ring, and ∂D/∂c."""
    whole, (inner, outer) = fields.section, fields.model.domain.radii
    height, ring = whole.axial.ends[-1], inner > 0
    start = (inner + outer) / 2 if ring else max(0.0, outer - width - 2 * REACH * height)
    ends = graded(start, outer - width, outer, height)
    if ring:
        ends = np.concatenate([2 * start - ends[:0:-1], ends])
    section = Section(Line(ends, ORDER), Line(deep(height), ORDER), whole.density)
    even, odd = section.order(0), section.order(1)
    r, z = (part.ravel() for part in np.meshgrid(section.radial.places, section.axial.places, indexing="ij"))
    top, near = z > height * (1 - 1e-9), 1e-9 * outer
    held = np.zeros((FIELDS, r.size), dtype=bool)
    held[:, (r < start + near) & (not ring) & (start > 0)] = True
    held[0, r == 0] = True
    held[1] = True
    held[2:, z == 0] = True
    held[3, top] = True
    rims = [np.flatnonzero(top & (r > outer - width + near))]
    rims += [np.flatnonzero(top & (r < inner + width - near))] * ring
    inside = in_region(whole.to_nodes_of(section), base.fields)
    operator, odd_operator = even.stiffness(base.tensor), odd.stiffness(base.tensor)
    gradients = np.where(base.odd, odd.at_points(inside), even.at_points(inside))

    def answered(strip: np.ndarray) -> Answers:
        rows = 3 * r.size + strip
        charges = np.where(base.odd, 2 * (odd_operator[rows] @ inside), operator[rows] @ inside)
        psi = answers(lambda free: free.T @ operator @ free, held, strip, charges)
        after = even.at_points(psi)
        return Answers(
            within=even.joined(after, after, base.units),
            between=even.joined(gradients, after, base.units),
            momentum=inside[:, :-1].T @ (even.mass @ psi),
        )

    apart = [_of_both_orders(answered(strip), base) for strip in rims]
    together = apart[0] if len(rims) == 1 else _of_both_orders(answered(np.concatenate(rims)), base)
    mean = np.where(base.odd, 0.5, 1.0) * (base.odd[:, None] == base.odd)
    return np.array([*apart, mean * (together - sum(apart))])


def _of_both_orders(answered: Answers, base: Base) -> np.ndarray:
    """∂T/∂c (10, k, k) of the answers of one region, on and between the fields of orders 0 and 1."""
    of_orders = ~base.odd, base.odd
    parts = [answered.without_momentum(base, chosen, 1.0) for chosen in of_orders]
    crossed = np.zeros((len(base.units), base.kept.size, answered.within.shape[1]))
    for chosen, (_, between) in zip(of_orders, parts, strict=True):
        crossed[:, chosen] = between
    found = stationary(sum(within for within, _ in parts) / 2, crossed, base.constants)
    for chosen, part in zip(of_orders, parts, strict=True):
        found[(..., *np.ix_(chosen, chosen))] = stationary(*part, base.constants)
    return found
