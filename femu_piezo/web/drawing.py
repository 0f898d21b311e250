"""A drawing of the body of a specimen: outline, electrodes, poling (SVG)."""

from __future__ import annotations

import html
import math

import numpy as np

from femu_piezo.specimen.geometry import Geometry

_BODY, _SIDE, _EDGE, _ELECTRODE, _POLING = "#d9cdb8", "#b9aa8f", "#4a4335", "#c9a227", "#b3261e"
_WIDTH, _HEIGHT, _MARGIN = 460.0, 260.0, 46.0
#: Directions of x, y and z on the paper.
_AXES = np.array([[0.92, 0.16], [0.46, -0.44], [0.0, -1.0]])
_CORNERS = 72


def drawing(geometry: Geometry) -> str:
    """The body as SVG with its dimensions, HTML; a sentence where it comes from a mesh file."""
    if geometry.shape == "mesh":
        return "<p>The body is that of the mesh file.</p>"
    outline, hole, thickness = _outline(geometry), _hole(geometry), geometry.thickness
    points = [np.column_stack([outline, np.full(len(outline), z)]) for z in (0.0, thickness)]
    flat = np.concatenate(points) @ _AXES
    low, high = flat.min(axis=0), flat.max(axis=0)
    scale = min((_WIDTH - 2 * _MARGIN) / (high[0] - low[0]), (_HEIGHT - 2 * _MARGIN) / (high[1] - low[1]))
    shift = np.array([_WIDTH, _HEIGHT]) / 2 - scale * (low + high) / 2

    def paper(x: np.ndarray, z: float) -> np.ndarray:
        return scale * (np.column_stack([x, np.full(len(x), z)]) @ _AXES) + shift

    top, bottom = paper(outline, thickness), paper(outline, 0.0)
    shapes = [
        _polygon([bottom[i], bottom[j], top[j], top[i]], _SIDE)
        for i, j in zip(range(len(outline)), np.roll(range(len(outline)), -1), strict=True)
        if _is_visible(outline[i], outline[j])
    ]
    shapes.append(_polygon(top, _BODY))
    along = geometry.poling == "length"
    if along:
        ends = [k for k in range(len(outline)) if outline[k, 0] > outline[:, 0].max() - 1e-12]
        shapes.append(_polygon([bottom[ends[0]], bottom[ends[-1]], top[ends[-1]], top[ends[0]]], _ELECTRODE))
    else:
        shapes.append(_polygon(paper(_electrode(geometry, outline), thickness), _ELECTRODE))
    if hole is not None:
        shapes.append(_polygon(paper(hole, thickness), _SIDE))
    shapes.append(_arrow(_poling(geometry), scale, shift, thickness, outline))
    words = ", ".join(f"{name.replace('_', ' ')} {1e3 * value:.4g} mm" for name, value in _dimensions(geometry).items())
    places = "on both ends" if along else "on both faces"
    told = f"{geometry.shape}: {words}; electrodes {places}; the arrow shows the poling"
    return (
        f'<svg viewBox="0 0 {_WIDTH:g} {_HEIGHT:g}" role="img" aria-label="{html.escape(told)}" '
        f'style="width:100%;max-width:{_WIDTH:g}px">{"".join(shapes)}</svg><p>{html.escape(told)}</p>'
    )


def _dimensions(geometry: Geometry) -> dict[str, float]:
    names = ("length", "width", "width_end", "diameter", "inner_diameter", "thickness")
    return {name: getattr(geometry, name) for name in names if getattr(geometry, name) is not None}


def _circle(radius: float, middle=(0.0, 0.0)) -> np.ndarray:
    angle = 2 * np.pi * np.arange(_CORNERS) / _CORNERS
    return np.array(middle) + radius * np.column_stack([np.cos(angle), np.sin(angle)])


def _outline(g: Geometry) -> np.ndarray:
    """(n, 2) corners of the face, counter-clockwise about its middle."""
    if g.shape in ("disk", "ring"):
        return _circle(g.diameter / 2)
    x, near = g.length / 2, (g.width or g.length) / 2
    far = near if g.width_end is None else g.width_end / 2
    corners = np.array([[-x, -near], [x, -far], [x, far], [-x, near]])
    return corners if not g.corner_radius else _rounded(corners, g.corner_radius)


def _rounded(corners: np.ndarray, radius: float) -> np.ndarray:
    middles = corners - np.sign(corners) * radius
    arcs = [
        middle + radius * np.column_stack([np.cos(angle), np.sin(angle)])
        for middle, start in zip(middles, (math.pi, -math.pi / 2, 0.0, math.pi / 2), strict=True)
        for angle in [start + np.linspace(0, math.pi / 2, 9)]
    ]
    return np.concatenate(arcs)


def _hole(g: Geometry) -> np.ndarray | None:
    if g.shape == "ring":
        return _circle(g.inner_diameter / 2)
    return None if g.hole_diameter is None else _circle(g.hole_diameter / 2, g.hole_position or (0.0, 0.0))


def _electrode(g: Geometry, outline: np.ndarray) -> np.ndarray:
    """(n, 2) outline of the electrode on the upper face."""
    low, high = outline.min(axis=0), outline.max(axis=0)
    middle, half = (low + high) / 2, (high - low) / 2
    margin = g.electrode_margin or 0.0
    covered = middle + (outline - middle) * np.maximum(1 - margin / half, 0.02)
    if g.electrode_length is not None:
        start = low[0] + (g.electrode_start or 0.0)
        covered[:, 0] = np.clip(covered[:, 0], start, start + g.electrode_length)
    if g.wrap_length is not None:
        covered[:, 0] = np.maximum(covered[:, 0], low[0] + g.wrap_length + (g.wrap_gap or 0.0))
    return covered


def _is_visible(first: np.ndarray, second: np.ndarray) -> bool:
    """Whether the side between two corners is seen: its outward normal has a part towards the lower edge."""
    along = second - first
    normal = np.array([along[1], -along[0], 0.0])
    return float((normal @ _AXES)[1]) > 1e-15


def _poling(g: Geometry) -> np.ndarray:
    if isinstance(g.poling, tuple):
        return np.array(g.poling) / np.linalg.norm(g.poling)
    return np.array([1.0, 0.0, 0.0] if g.poling == "length" else [0.0, 0.0, 1.0])


def _arrow(direction: np.ndarray, scale: float, shift: np.ndarray, thickness: float, outline: np.ndarray) -> str:
    middle = np.append((outline.min(axis=0) + outline.max(axis=0)) / 2, thickness)
    start = scale * (middle @ _AXES) + shift
    step = direction @ _AXES
    end = start + 44 * step / max(np.linalg.norm(step), 1e-9)
    side = np.array([-(end - start)[1], (end - start)[0]]) / 44
    back = start + 0.72 * (end - start)
    head = _polygon([end, back + 6 * side, back - 6 * side], _POLING)
    line = f'<line x1="{start[0]:.1f}" y1="{start[1]:.1f}" x2="{back[0]:.1f}" y2="{back[1]:.1f}" stroke="{_POLING}"'
    label = f'<text x="{end[0] + 8:.1f}" y="{end[1] + 4:.1f}" fill="{_POLING}" font-size="14">P</text>'
    return f'{line} stroke-width="3"/>{head}{label}'


def _polygon(points, fill: str) -> str:
    corners = " ".join(f"{x:.1f},{y:.1f}" for x, y in points)
    return f'<polygon points="{corners}" fill="{fill}" stroke="{_EDGE}" stroke-width="0.8" stroke-linejoin="round"/>'
