"""Figures for the browser, as the dictionaries that Plotly draws."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Literal

import numpy as np

from femu_piezo.measurement.spectrum import evenly

#: Most points of a curve that are sent to the browser; longer curves are thinned.
_MOST = 6000
#: Colours of curves that readers with red-green blindness can tell apart (Okabe and Ito).
COLORS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9")
#: Heights of charts, in pixels.
IMPEDANCE_HEIGHT, RESIDUAL_HEIGHT = 520, 320
_POLE, _ZERO, _FAULT = "#d55e00", "#0072b2", "#b3261e"

View = Literal["|Z| and phase", "R and X", "admittance circle"]
VIEWS: tuple[View, ...] = ("|Z| and phase", "R and X", "admittance circle")
Curve = tuple[np.ndarray, np.ndarray]
"""Frequency (k,) Hz and complex Z (k,) ohm."""


def impedance_chart(
    curves: Mapping[str, Curve],
    view: View,
    *,
    logarithmic: bool = False,
    resonances: Sequence[Mapping[str, Any]] = (),
    faults: Sequence[tuple[str, np.ndarray]] = (),
    masked: Sequence[tuple[float, float]] = (),
    measured: str = "",
) -> dict:
    """Chart of curves of Z by name.

    Parameters
    ----------
    resonances : of extraction.json, each with kind, frequency_Hz and std_Hz; drawn as lines with bands of ± 2 σ
    faults : (sentence, frequencies (m,) in Hz) of each fault of the first curve
    masked : bands (low, high), Hz, that are left out
    measured : name of the curve that is drawn as points
    """
    if view == "admittance circle":
        return _circles(curves, measured)
    names = ("|Z| (Ω)", "phase (°)") if view == "|Z| and phase" else ("R (Ω)", "X (Ω)")
    traces = []
    for number, (name, (frequency, z)) in enumerate(curves.items()):
        frequency, z = _thinned(frequency, z)
        panels = (np.abs(z), np.degrees(np.angle(z))) if view == "|Z| and phase" else (z.real, z.imag)
        for row, values in enumerate(panels):
            traces.append(
                _trace(frequency / 1e3, values, name, number, points=name == measured)
                | {"showlegend": row == 0}
                | ({} if row == 0 else {"yaxis": "y2"})
            )
    if faults and curves:
        frequency, z = next(iter(curves.values()))
        for words, of_fault in faults:
            value = np.abs(np.interp(of_fault, frequency, np.abs(z) if view == "|Z| and phase" else z.real))
            marker = {"symbol": "x", "size": 9, "color": _FAULT}
            traces.append(
                {"x": _list(of_fault / 1e3), "y": _list(value), "mode": "markers", "marker": marker, "name": words[:60]}
                | {"hovertext": words, "hoverinfo": "text"}
            )
    shapes = [_band(low / 1e3, high / 1e3, "rgba(128,128,128,0.3)") for low, high in masked]
    for one in resonances:
        shapes += _marked(one)
    upper = "log" if logarithmic or view == "|Z| and phase" else "linear"
    layout = _layout(shapes) | {
        "xaxis": _axis("frequency (kHz)", "log" if logarithmic else "linear") | {"anchor": "y2"},
        "yaxis": _axis(names[0], upper) | {"domain": [0.42, 1]},
        "yaxis2": _axis(names[1]) | {"domain": [0, 0.36]},
        "height": IMPEDANCE_HEIGHT,
    }
    return _figure(traces, layout)


def _circles(curves: Mapping[str, Curve], measured: str) -> dict:
    traces = []
    for number, (name, (frequency, z)) in enumerate(curves.items()):
        frequency, z = _thinned(frequency, z)
        y = 1e3 / z
        hover = [f"{f / 1e3:.6g} kHz" for f in frequency]
        traces.append(_trace(y.real, y.imag, name, number, points=name == measured) | {"hovertext": hover})
    layout = _layout() | {
        "xaxis": _axis("G (mS)"),
        "yaxis": _axis("B (mS)") | {"scaleanchor": "x"},
        "height": IMPEDANCE_HEIGHT,
    }
    return _figure(traces, layout)


def residual_chart(frequency: np.ndarray, residuals: Mapping[str, np.ndarray], words: str, band: float = 0.0) -> dict:
    """Chart of residuals of log Z by name, complex (k,): |Z| as dots, the phase as crosses; ± `band` is shaded."""
    traces = []
    for number, (name, values) in enumerate(residuals.items()):
        thin, values = _thinned(frequency, values)
        traces.append(_trace(thin / 1e3, values.real, f"{name}, |Z|", number, points=True))
        traces.append(
            _trace(thin / 1e3, values.imag, f"{name}, phase", number, points=True)
            | {"marker": {"symbol": "x", "size": 5, "color": COLORS[(number + 3) % len(COLORS)]}}
        )
    shaded = {**_band(0, 1, "rgba(0,158,115,0.18)"), "xref": "paper", "yref": "y", "y0": -band, "y1": band}
    layout = _layout([shaded] if band else []) | {
        "xaxis": _axis("frequency (kHz)"),
        "yaxis": _axis(words),
        "height": RESIDUAL_HEIGHT,
    }
    return _figure(traces, layout)


def bar_chart(values: Mapping[str, Mapping[str, float]], words: str) -> dict:
    """Chart of stacked bars: bar → part → value; words : title of the axis."""
    parts = list(dict.fromkeys(part for shares in values.values() for part in shares))
    traces = [
        {
            "type": "bar",
            "orientation": "h",
            "name": part,
            "y": list(values),
            "x": [shares.get(part, 0.0) for shares in values.values()],
            "marker": {"color": (*COLORS, "#999999", "#f0e442")[number % 8]},
        }
        for number, part in enumerate(parts)
    ]
    layout = _layout() | {
        "barmode": "stack",
        "xaxis": _axis(words),
        "yaxis": {"autorange": "reversed", "type": "category", "automargin": True},
        "height": 110 + 34 * len(values),
    }
    return _figure(traces, layout)


def control_chart(numbers: Sequence[float], values: Sequence[float], limits: Sequence[float] | None, name: str) -> dict:
    """One quantity over the pieces of a lot, with its control limits."""
    shapes = []
    for limit in limits or ():
        line = {"color": _FAULT, "dash": "dash", "width": 1.5}
        shapes.append({"type": "line", "xref": "paper", "x0": 0, "x1": 1, "y0": limit, "y1": limit, "line": line})
    traces = [_trace(np.asarray(numbers, float), np.asarray(values, float), name, 0, points=True)]
    traces[0]["mode"] = "lines+markers"
    pieces = _axis("number in the lot") | {"tick0": 1, "dtick": max(1, len(numbers) // 10)}
    layout = _layout(shapes) | {"xaxis": pieces, "yaxis": _axis(name), "height": 300}
    return _figure(traces, layout)


def _figure(traces: list[dict], layout: dict) -> dict:
    settings = {"responsive": True, "displaylogo": False, "modeBarButtonsToRemove": ["lasso2d"], "scrollZoom": False}
    return {"data": traces, "layout": layout, "config": settings}


def _layout(shapes: Sequence[dict] = ()) -> dict:
    return {
        "shapes": list(shapes),
        "paper_bgcolor": "rgba(0,0,0,0)",
        "plot_bgcolor": "rgba(0,0,0,0)",
        "margin": {"l": 64, "r": 12, "t": 44, "b": 48},
        "legend": {"orientation": "h", "y": 1.02, "yanchor": "bottom"},
        "font": {
            "family": "Roboto, sans-serif",
            "size": 13,
        },  # the font of the page by name: plotly measures text with it
        "dragmode": "zoom",
    }


def _axis(title: str, kind: str = "linear") -> dict:
    return {
        "title": {"text": title},
        "type": kind,
        "automargin": True,
        "gridcolor": "rgba(128,128,128,0.25)",
        "zeroline": False,
        **({"nticks": 5} if kind == "log" else {}),  # with more, digits below each decade lie over one another
    }


def _trace(x: np.ndarray, y: np.ndarray, name: str, number: int, *, points: bool) -> dict:
    color = COLORS[number % len(COLORS)]
    kind = {"mode": "markers", "marker": {"size": 4, "color": color}} if points else {"mode": "lines"}
    return {"x": _list(x), "y": _list(y), "name": name, "line": {"color": color, "width": 2}, **kind}


def _marked(resonance: Mapping[str, Any]) -> list[dict]:
    """The line of a resonance and its band of ± 2 σ."""
    color = _POLE if resonance["kind"] == "pole" else _ZERO
    at, std = resonance["frequency_Hz"] / 1e3, (resonance.get("std_Hz") or 0.0) / 1e3
    line = {"color": color, "dash": "dot" if resonance["kind"] == "pole" else "dash", "width": 1.2}
    found = [{"type": "line", "yref": "paper", "y0": 0, "y1": 1, "x0": at, "x1": at, "line": line}]
    return [_band(at - 2 * std, at + 2 * std, color, 0.25), *found] if std else found


def _band(low: float, high: float, color: str, opacity: float = 1.0) -> dict:
    place = {"type": "rect", "xref": "x", "yref": "paper", "x0": low, "x1": high, "y0": 0, "y1": 1}
    return {**place, "fillcolor": color, "opacity": opacity, "line": {"width": 0}, "layer": "below"}


def _thinned(x: np.ndarray, y: np.ndarray) -> Curve:
    keep = evenly(x.size, _MOST)
    return x[keep], y[keep]


def _list(values: np.ndarray) -> list[float]:
    return [float(f"{value:.9g}") for value in np.asarray(values, float)]
