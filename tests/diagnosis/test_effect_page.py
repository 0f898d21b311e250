"""The page of effects names every effect of the library with its parameters and units, and no other."""

from __future__ import annotations

import re
from pathlib import Path

from femu_piezo.effects.effect import EffectContext
from femu_piezo.effects.library import library
from femu_piezo.geometry.reshaping import EndWidth, InnerDiameter
from femu_piezo.material.library import library_material

PAGE = Path(__file__).resolve().parents[2] / "tutorials" / "effects.md"


def rows() -> dict[str, str]:
    """Effect → text of the cell with its parameters."""
    found = {}
    for line in PAGE.read_text(encoding="utf-8").splitlines():
        cells = [cell.strip() for cell in line.split("|")]
        if len(cells) > 4 and cells[1].startswith("`"):
            found |= dict.fromkeys(re.findall(r"`(\w+)`", cells[1]), cells[2])
    return found


def test_page_and_library_agree():
    constants = library_material("pzt-5h").constants
    context = EffectContext(
        1e5,
        ("s11",),
        constants,
        {"length": (0,), "width": (1,), "thickness": (2,)},
        7500.0,
        1e-3,
        1e3,
        (12e-3, 5e-3, 1e-3),
    )
    axes, radii = {"diameter": (0, 1), "thickness": (2,)}, (0.0, 10e-3)
    reshaped = {"inner_diameter": InnerDiameter(2e-3, 10e-3), "width_end": EndWidth(20e-3, 6e-3, 3e-3)}
    disk = EffectContext(1e5, ("s11",), constants, axes, 7500.0, 1e-3, 1e3, radii=radii, reshapings=reshaped)
    effects = [*library(context), *library(disk)]
    page = rows()
    assert set(page) == {effect.name for effect in effects}
    for effect in effects:
        for parameter in effect.parameters:
            if effect.name != "wrong_insensitive_parameter":
                words = f"`{parameter.name}` {parameter.unit}"
                assert words in page[effect.name], (effect.name, words)
                assert (f"({words}" in page[effect.name]) == parameter.optional
