"""An interactive scene of mode shapes: one HTML file that needs no network, no server and no plug-in (WebGL 2)."""

from __future__ import annotations

import base64
import html
import json
from importlib import resources
from typing import TYPE_CHECKING

import matplotlib
import numpy as np

from femu_piezo.output.render import COLORS, Shape, shapes_of

if TYPE_CHECKING:
    from femu_piezo.study.modes import ModesResult


def scene_html(result: ModesResult) -> str:
    """The page: every driven mode at its pole and zero, to be turned, zoomed, animated and exaggerated."""
    shapes, titles = [], []
    for number, mode in enumerate(result.modes, start=1):
        resonances = [mode.pole] if mode.zero is None else [mode.pole, mode.zero]
        words = (mode.pole_family, mode.zero_family)
        shapes += shapes_of(result, mode, subdivisions=2)
        titles += [
            f"{number} {one.kind}, {one.frequency_Hz / 1e3:.5g} kHz: {word}"
            for one, word in zip(resonances, words, strict=False)
        ]
    surface = shapes[0].surface
    low, high = surface.points.min(axis=0), surface.points.max(axis=0)
    size = float(np.linalg.norm(high - low)) / 2
    electrode = np.zeros(len(surface.points), dtype=np.uint8)
    electrode[surface.triangles] = surface.electrode[:, None]
    data = {
        "points": _packed(((surface.points - (low + high) / 2) / size).astype("<f4")),
        "triangles": _packed(surface.triangles.astype("<u4")),
        "electrode": _packed(electrode),
        "colors": {quantity: _packed(_color_table(name)) for quantity, name in COLORS.items()},
        "shapes": [_record(shape, title, size) for shape, title in zip(shapes, titles, strict=True)],
    }
    page = resources.files("femu_piezo.output").joinpath("scene.html").read_text(encoding="utf-8")
    page = page.replace("__TITLE__", html.escape(f"{result.specimen.name}: mode shapes"))
    return page.replace("__DATA__", json.dumps(data, ensure_ascii=False).replace("<", "\\u003c"))


def _record(shape: Shape, title: str, size: float) -> dict:
    motion = shape.motion.real / size
    reach = float(np.abs(motion).max())
    return {
        "title": title,
        "quantity": shape.quantity,
        "reach": reach,
        "motion": _packed(np.round(motion / reach * 32767).astype("<i2")),
        "value": _packed(np.round(np.clip(shape.colors.real, -1, 1) * 32767).astype("<i2")),
    }


def _color_table(name: str) -> np.ndarray:
    return np.round(255 * matplotlib.colormaps[name](np.linspace(0, 1, 256))).astype(np.uint8)


def _packed(array: np.ndarray) -> str:
    return base64.b64encode(np.ascontiguousarray(array).tobytes()).decode("ascii")
