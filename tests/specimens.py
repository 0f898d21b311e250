"""Specimen files of bodies whose constants are known."""

from __future__ import annotations


def plate(name: str, size, density: float, *more: str) -> str:
    """Name and table [geometry] of a plate of `size`, its length, width and thickness in m; more : further lines."""
    sides = [f"{side} = {float(value)!r}" for side, value in zip(("length", "width", "thickness"), size, strict=True)]
    return "\n".join([f'name = "{name}"', "[geometry]", 'shape = "plate"', *sides, f"density = {density}", *more, ""])


def material(constants, free, factors=None, lossless=()) -> str:
    """The table [material] with ten constants, their real parts times `factors` (name → factor), tangents of those in
    `lossless` 0.
    """
    text = f"[material]\nfree = {list(free)}\n"
    for name, value in constants.as_dict().items():
        tangent = 0.0 if name in lossless else constants.tangent(name)
        text += f"{name} = {float(value.real * (factors or {}).get(name, 1.0))!r}\ntan_{name} = {tangent!r}\n"
    return text
