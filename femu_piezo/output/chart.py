"""Charts of a report: data and axes as JSON, drawn as SVG in the browser by the page's own script (report.js)."""

from __future__ import annotations

import html
import json
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

#: Significant digits of the points in a page; a screen shows four.
_DIGITS = 7


@dataclass(frozen=True)
class Axis:
    """One axis. limits : fixed (low, high); where None, the axis fits the data in view."""

    label: str
    log: bool = False
    limits: tuple[float, float] | None = None


@dataclass(frozen=True)
class Series:
    """One curve: x (n,) and y (n,) real; a nan leaves a gap."""

    name: str
    x: np.ndarray
    y: np.ndarray
    color: str
    kind: Literal["line", "dashed", "points"] = "line"


@dataclass(frozen=True)
class Band:
    """A shaded range of one axis with its meaning."""

    axis: Literal["x", "y"]
    low: float
    high: float
    name: str
    color: str = "#f3e6c4"


@dataclass(frozen=True)
class Chart:
    """A chart that can be zoomed; charts of one group share the range of x.

    Attributes
    ----------
    group : its name
    views : name → (low, high) of x, offered as buttons
    height : of the drawing, whose width is 860 in the same unit
    """

    x: Axis
    y: Axis
    series: tuple[Series, ...]
    group: str
    bands: tuple[Band, ...] = ()
    views: dict[str, tuple[float, float]] = field(default_factory=dict)
    height: int = 300
    caption: str = ""

    def html(self) -> str:
        """The <figure> that report.js fills."""
        record = {
            "x": _axis(self.x),
            "y": _axis(self.y),
            "group": self.group,
            "height": self.height,
            "views": {name: list(limits) for name, limits in self.views.items()},
            "bands": [vars(band) for band in self.bands],
            "series": [
                {"name": one.name, "color": one.color, "kind": one.kind, "x": _numbers(one.x), "y": _numbers(one.y)}
                for one in self.series
            ],
        }
        caption = f"<figcaption>{html.escape(self.caption)}</figcaption>" if self.caption else ""
        return (
            f'<figure class="chart" aria-label="{html.escape(self.y.label)} over {html.escape(self.x.label)}">'
            f'<script type="application/json">{embedded(record)}</script>{caption}</figure>'
        )


def _axis(axis: Axis) -> dict:
    return {"label": axis.label, "log": axis.log, "limits": None if axis.limits is None else list(axis.limits)}


def _numbers(values: np.ndarray) -> list[float | None]:
    return [float(f"{value:.{_DIGITS}g}") if np.isfinite(value) else None for value in np.asarray(values, dtype=float)]


def embedded(record: dict | list) -> str:
    """JSON that can stand inside a <script> element."""
    return json.dumps(record, ensure_ascii=False, allow_nan=False, separators=(",", ":")).replace("<", "\\u003c")
