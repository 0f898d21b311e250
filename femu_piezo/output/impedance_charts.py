"""|Z| and phase of several curves, as the reports show them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from femu_piezo.output.chart import Axis, Band, Chart, Series


@dataclass(frozen=True)
class Curve:
    """One curve. words : in the legend; impedance : (n,) complex, ohm."""

    words: str
    impedance: np.ndarray
    color: str
    kind: Literal["line", "dashed", "points"]


def impedance_charts(
    x: np.ndarray,
    axis: Axis,
    curves: Sequence[Curve],
    group: str,
    bands: tuple[Band, ...] = (),
    views: Mapping[str, tuple[float, float]] | None = None,
) -> list[Chart]:
    """|Z| and phase of curves over x (n,), zoomed together with their group; views are offered above |Z|."""
    parts = (
        (Axis("|Z| (Ω)", log=True), np.abs, dict(views or {}), 320),
        (Axis("phase of Z (°)", limits=(-95.0, 95.0)), lambda z: np.degrees(np.angle(z)), {}, 240),
    )
    return [
        Chart(
            axis,
            vertical,
            tuple(Series(curve.words, x, part(curve.impedance), curve.color, curve.kind) for curve in curves),
            group,
            bands,
            buttons,
            height=height,
        )
        for vertical, part, buttons, height in parts
    ]


def view(name: str, low: float, high: float, frequency: np.ndarray, factor: float) -> dict[str, tuple[float, float]]:
    """A range of frequency, Hz, as far as it is in the sweep (n,), in the unit of the axis; none where it is not."""
    low, high = max(low, frequency[0]), min(high, frequency[-1])
    return {name: (float(low * factor), float(high * factor))} if low < high else {}
