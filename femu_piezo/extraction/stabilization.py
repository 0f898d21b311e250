"""Stabilization diagrams: poles that stay where they are while the model order grows are physical."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.polynomial import chebyshev

from femu_piezo.extraction.fit import NormalisedSweep
from femu_piezo.measurement.spectrum import ImpedanceSpectrum
from femu_piezo.resonances import Kind

FREQUENCY_TOLERANCE = 2e-3
LOSS_TOLERANCE = 0.1
MIN_COLUMN = 4
SANATHANAN_STEPS = 3


@dataclass(frozen=True)
class Column:
    """A run of poles that agree from one order to the next.

    Attributes
    ----------
    eigenvalue : λ at the order where it moved least, rad²/s²
    orders : orders the column passes through
    """

    eigenvalue: complex
    orders: tuple[int, ...]


@dataclass(frozen=True)
class StabilizationDiagram:
    """Poles over model order, as the paper's figures 11 and 13.

    Attributes
    ----------
    kind : "pole" (of Y) or "zero"
    order : (m,) model order of each point
    eigenvalue : (m,) complex λ, rad²/s²
    stable : (m,) bool, frequency and loss agree with a pole of the order below within the tolerances
    columns : the stable columns found, by frequency
    """

    kind: Kind
    order: np.ndarray
    eigenvalue: np.ndarray
    stable: np.ndarray
    columns: tuple[Column, ...]


def stabilize(kind: Kind, by_order: dict[int, np.ndarray], *, min_column: int = MIN_COLUMN) -> StabilizationDiagram:
    """Find the stable columns in the poles of growing orders.

    A pole continues a column of the order below where its frequency agrees within `FREQUENCY_TOLERANCE`
    (relative) and its loss within `LOSS_TOLERANCE` (relative); the nearest one is taken. Columns of at least
    `min_column` orders remain.

    Parameters
    ----------
    by_order : order → (k,) complex λ of that order, rad²/s²; only Re λ > 0 and Im λ > 0 are looked at
    """
    open_columns: list[list[tuple[int, complex]]] = []
    closed: list[list[tuple[int, complex]]] = []
    points: list[tuple[int, complex, bool]] = []
    for order in sorted(by_order):
        values = [complex(v) for v in by_order[order] if v.real > 0 and v.imag > 0]
        following: list[list[tuple[int, complex]]] = []
        free = list(open_columns)
        for value in sorted(values, key=lambda v: v.real):
            near = [c for c in free if _agree(c[-1][1], value)]
            points.append((order, value, bool(near)))
            if near:
                column = min(near, key=lambda c: abs(c[-1][1] - value))
                free.remove(column)
                following.append([*column, (order, value)])
            else:
                following.append([(order, value)])
        closed += free
        open_columns = following
    long = [c for c in closed + open_columns if len(c) >= min_column]
    columns = tuple(sorted((_column(c) for c in long), key=lambda c: c.eigenvalue.real))
    return StabilizationDiagram(
        kind,
        np.array([p[0] for p in points], int),
        np.array([p[1] for p in points], complex),
        np.array([p[2] for p in points], bool),
        columns,
    )


def rational_stabilization(
    spectrum: ImpedanceSpectrum, max_order: int = 14
) -> tuple[StabilizationDiagram, StabilizationDiagram]:
    """Diagrams of poles and of zeros from rational least-squares fits of growing order, for any frequency grid.

    Y/(jω) = N(x)/D(x) with Chebyshev polynomials of degree n + 1 over n in x ~ ω², linearised by Levy (1959)
    and reweighted by 1/|D| (Sanathanan and Koerner 1963). Quick and free of choices, but biased by noise: the
    diagram shows which modes are there, the maximum-likelihood fit says where.
    """
    data = NormalisedSweep.of(spectrum.omega, spectrum.admittance, np.ones(len(spectrum)))
    low, high = (2 * np.pi * spectrum.frequency[0]) ** 2, (2 * np.pi * spectrum.frequency[-1]) ** 2
    poles: dict[int, np.ndarray] = {}
    zeros: dict[int, np.ndarray] = {}
    for order in range(1, min(max_order, len(spectrum) // 3) + 1):
        numerator, denominator = _sanathanan_koerner(data, order)
        for store, polynomial in ((poles, denominator), (zeros, numerator)):
            value = data.axis.eigenvalue(chebyshev.chebroots(polynomial))
            store[order] = value[(value.real >= low) & (value.real <= high) & (value.imag < value.real)]
    return stabilize("pole", poles), stabilize("zero", zeros)


def _sanathanan_koerner(data: NormalisedSweep, order: int) -> tuple[np.ndarray, np.ndarray]:
    top = chebyshev.chebvander(data.x, order + 1) / data.charge[:, None]
    bottom = chebyshev.chebvander(data.x, order)
    weight = np.ones(len(data))
    for _ in range(SANATHANAN_STEPS):
        columns = np.hstack([top, -bottom[:, :-1]]) * weight[:, None]
        solution = np.linalg.lstsq(columns, bottom[:, -1] * weight, rcond=None)[0]
        numerator, denominator = solution[: order + 2], np.append(solution[order + 2 :], 1.0)
        weight = 1 / np.abs(bottom @ denominator)
    return numerator, denominator


def _agree(before: complex, after: complex) -> bool:
    frequency = abs(np.sqrt(after.real / before.real) - 1)
    loss = abs((after.imag / after.real) / (before.imag / before.real) - 1)
    return bool(frequency <= FREQUENCY_TOLERANCE and loss <= LOSS_TOLERANCE)


def _column(members: list[tuple[int, complex]]) -> Column:
    values = np.array([value for _, value in members])
    moved = np.abs(np.diff(values))
    best = int(np.argmin(moved)) + 1
    return Column(complex(values[best]), tuple(order for order, _ in members))


def inside(diagram: StabilizationDiagram, low: float, high: float) -> StabilizationDiagram:
    """The diagram with only the columns between two frequencies, Hz."""
    keep = tuple(c for c in diagram.columns if low <= np.sqrt(c.eigenvalue.real) / (2 * np.pi) <= high)
    return replace(diagram, columns=keep)
