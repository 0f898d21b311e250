"""Bare strips along the rims of a disk or ring, all of one width or left by an electrode that is off the centre.

An electrode off the centre by a times m leaves strips m (1 − a cos θ) wide along an outer rim and m (1 + a cos θ) along
an inner one, which couple the driven fields to those of Fourier order 1. A strip is narrow against its radius, so the
body is taken at θ as with a strip of uniform width m(θ). With T_nn'(m) the S of one rim (`femu_piezo.effects.local.
end_strips`) between fields of orders n and n' as they are at θ = 0, and D_nn(m) the rest of the S of all rims together,

    S_nn' = Σ ⟨cosⁿθ cosⁿ'θ T_nn'(m(θ))⟩ + ⟨cos²ⁿθ⟩ D_nn(m)

over the rims, ⟨ ⟩ the mean over θ. T_00 and T_11 are those of strips of uniform width, from whose ψ the base fields of
their order and momentum are subtracted; between the orders the mean of both ψᵗKψ is taken. Against a full solution the
sum is exact to 0.2 % (disk) and 2 % (ring) at a = 0; the change by a, proportional to a², has the right shape but is
off by 40 % and 13 %, so that a is found 15 % and 6 % too small: the fields of order 1 do not represent all of the
response to a wider strip on one side. More of them near the rim do not help: S assumes fields that are slow across it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from femu_piezo.effects.local.blocks import Blocks
from femu_piezo.effects.local.end_strips import (
    NODES,
    ORDER,
    REACH,
    WIDEST,
    Answers,
    Base,
    answers,
    between_widths,
    deep,
    graded,
    in_region,
    stationary,
)
from femu_piezo.effects.local.round_fields import ORDERS, RIMS, RoundFields
from femu_piezo.effects.local.sectors import DRIVEN, Sectors
from femu_piezo.forward.gradient_products import FIELDS
from femu_piezo.forward.revolution import Line, Section
from femu_piezo.threads import Once, in_parallel

#: Number of angles over half a turn at which the width is taken.
_ANGLES = 12


@dataclass(frozen=True)
class BareRims:
    """S of strips along the rims, interpolated between several widths.

    Attributes
    ----------
    widths : (w,) m
    apart : for each rim, for n + n' = 0, 1, 2: [w, 10] (r, r) ∂T_nn'/∂c of every e-form constant at the reference
    meeting : [m, 10] (r, r) ∂D/∂c at the first m widths
    further : makes these strips with more widths, for one wider than the last width
    """

    widths: np.ndarray
    apart: tuple[tuple[Blocks, Blocks, Blocks], ...]
    meeting: Blocks
    further: Callable[[], BareRims] | None = None

    def at(self, width: float, asymmetry: float = 0.0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """∂S/∂c (10, r, r) of strips m (1 ∓ a cos θ) wide, and its slopes in m and in a."""
        if self.further is not None and width * (1 + asymmetry) > self.widths[-1]:
            return self.further().at(width, asymmetry)
        cosine = np.cos(np.pi * (np.arange(_ANGLES) + 0.5) / _ANGLES)
        shares, slopes = between_widths(self.widths[: len(self.meeting.inner)], width)
        value, by_width = self.meeting.combined(shares), self.meeting.combined(slopes)
        by_asymmetry = np.zeros_like(value)
        for side, of_orders in zip((-1.0, 1.0), self.apart, strict=False):
            relative = 1 + side * asymmetry * cosine
            shares, slopes = between_widths(self.widths, width * relative)
            for power, blocks in enumerate(of_orders):
                weight = cosine[:, None] ** power / _ANGLES
                value = value + blocks.combined(np.sum(weight * shares, axis=0))
                by_width = by_width + blocks.combined(np.sum(weight * relative[:, None] * slopes, axis=0))
                moved = side * width * cosine[:, None] * slopes
                by_asymmetry = by_asymmetry + blocks.combined(np.sum(weight * moved, axis=0))
        return value, by_width, by_asymmetry

    def embedded(self, numbers: np.ndarray, size: int) -> BareRims:
        """These strips over `size` unknowns, in which the present unknowns have the given indices."""
        apart = tuple(tuple(blocks.embedded(numbers, size) for blocks in rim) for rim in self.apart)
        further = None if self.further is None else lambda: self.further().embedded(numbers, size)
        return BareRims(self.widths, apart, self.meeting.embedded(numbers, size), further)


def measure_bare_rims(sectors: Sectors) -> BareRims:
    """S of strips along the rims of a disk or ring, up to a tenth of the way across.

    sectors : the driven one and those of order 1
    """
    fields: RoundFields = sectors.all_fields
    base, widest = _base(sectors), WIDEST * float(np.ptp(fields.model.domain.radii))
    usual, kept = np.count_nonzero(NODES <= 1), Once()
    orders = base.odd[:, None].astype(int) + base.odd  # n + n'

    def made(nodes: np.ndarray) -> list[np.ndarray]:
        return list(in_parallel(lambda width: _freed(fields, base, width), (widest * nodes).tolist()))

    def strips(found: list[np.ndarray]) -> BareRims:
        *rims, meeting = np.array(found).swapaxes(0, 1)
        apart = tuple(
            tuple(Blocks(rim * (orders == power), base.kept, sectors.size) for power in range(3)) for rim in rims
        )
        return BareRims(widest * NODES[: len(found)], apart, Blocks(meeting[:usual], base.kept, sectors.size))

    first = made(NODES[:usual])
    return replace(strips(first), further=lambda: kept.get("further", lambda: strips([*first, *made(NODES[usual:])])))


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
            own=even.joined(after, after, base.units),
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
    parts = [answered.apart(base, chosen, 1.0) for chosen in of_orders]
    crossed = np.zeros((len(base.units), base.kept.size, answered.own.shape[1]))
    for chosen, (_, between) in zip(of_orders, parts, strict=True):
        crossed[:, chosen] = between
    found = stationary(sum(own for own, _ in parts) / 2, crossed, base.constants)
    for chosen, part in zip(of_orders, parts, strict=True):
        found[(..., *np.ix_(chosen, chosen))] = stationary(*part, base.constants)
    return found
