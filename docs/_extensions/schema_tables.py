"""Tables of the documentation that are made from the package: keys of specimen files, effects, the material library.

```{schema} measurement     keys of one table of a specimen file: unit, bounds, default
```{shapes}                 dimensions and features of each shape
```{effects}                parameters of the effects: unit, bounds, usual size
```{materials}              the material library with its sources
```{rules}                  thresholds of a diagnosis with their principles
"""

from __future__ import annotations

import types
import typing
from collections.abc import Iterator
from pathlib import Path

from docutils import nodes
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective

from femu_piezo.diagnosis.rules import Rules
from femu_piezo.effects.effect import EffectContext
from femu_piezo.effects.library import library
from femu_piezo.material.library import library_material, library_names
from femu_piezo.specimen.file import Specimen
from femu_piezo.specimen.geometry import DIMENSIONS, OPTIONAL
from femu_piezo.specimen.schema import Quantity, Table

TABLES = {table.model_config["title"]: table for table in Table.__subclasses__() if table is not Specimen}


def keys(table: type[Table]) -> Iterator[tuple[str, ...]]:
    """Rows key, value, bounds, default and meaning; keys that differ in their name alone share a row."""
    rows: dict[tuple[str, ...], list[str]] = {}
    for name, field in table.model_fields.items():
        hint = typing.Annotated[(field.annotation, *field.metadata)] if field.metadata else field.annotation
        value, bounds = _kind(hint)
        default = "must be given" if field.is_required() else _default(table, name, field.default)
        rows.setdefault((value, bounds, default, field.description or ""), []).append(name)
    for (value, bounds, default, meaning), names in rows.items():
        yield ", ".join(f"`{name}`" for name in names), value, bounds, default, meaning


def _default(table: type[Table], name: str, default: object) -> str:
    try:
        return f"{table.usual(name):g}"
    except KeyError:
        return "" if default is None else f"`{_toml(default)}`"


def _toml(value: object) -> str:
    return f'"{value}"' if isinstance(value, str) else str(value).lower() if isinstance(value, bool) else f"{value:g}"


def _kind(hint: object) -> tuple[str, str]:
    """What a key takes, and its bounds."""
    origin, arguments = typing.get_origin(hint), typing.get_args(hint)
    if origin is typing.Annotated:
        asked = next((part for part in arguments if isinstance(part, Quantity)), None)
        if asked is None:
            return _kind(arguments[0])
        unit = "number" if asked.unit == "1" else asked.unit
        return unit, f"{asked.low:g} … {asked.high:g}"
    if origin is typing.Literal:
        return "one of", ", ".join(f"`{_toml(value)}`" for value in arguments)
    if origin in (typing.Union, types.UnionType):
        kinds = [_kind(part) for part in arguments if part is not types.NoneType]
        return " or ".join(kind[0] for kind in kinds), kinds[0][1]
    if origin is tuple:
        parts = [part for part in arguments if part is not Ellipsis]
        inner, bounds = _kind(parts[0])
        return f"list of {inner}" if len(parts) < len(arguments) else f"{len(parts)} × {inner}", bounds
    if isinstance(hint, type) and issubclass(hint, Table):
        return f"table `{hint.model_config['title']}`", ""
    return {float: "number", str: "string", int: "whole number", bool: "`true` or `false`", Path: "path"}[hint], ""


def markdown(head: tuple[str, ...], rows: Iterator[tuple[str, ...]]) -> str:
    """A table in Markdown."""
    lines = [head, ("---",) * len(head), *rows]
    return "\n".join("| " + " | ".join(cell.replace("|", "\\|") for cell in line) + " |" for line in lines)


class _Made(SphinxDirective):
    """A directive whose content is a table in Markdown."""

    def table(self) -> str:
        raise NotImplementedError

    def run(self) -> list[nodes.Node]:
        return self.parse_text_to_nodes(self.table())


class SchemaDirective(_Made):
    """The keys of one table of a specimen file."""

    required_arguments = 1

    def table(self) -> str:
        return markdown(("key", "value", "bounds", "default", "meaning"), keys(TABLES[self.arguments[0]]))


class ShapesDirective(_Made):
    """Which dimensions a shape must and may have."""

    def table(self) -> str:
        rows = ((f"`{shape}`", _codes(DIMENSIONS[shape]), _codes(OPTIONAL[shape])) for shape in DIMENSIONS)
        return markdown(("shape", "required keys", "optional keys"), rows)


class EffectsDirective(_Made):
    """The parameters of the effects, of a plate 40 × 5 × 1 mm and a disk 20 × 1 mm of PZT-5H."""

    def table(self) -> str:
        constants = library_material("pzt-5h").constants
        axes = {"length": (0,), "width": (1,), "thickness": (2,)}, {"diameter": (0, 1), "thickness": (2,)}
        plate = EffectContext(36e3, ("s11",), constants, axes[0], 7500.0, 1e-3, 1e3, (40e-3, 5e-3, 1e-3))
        disk = EffectContext(100e3, ("s11",), constants, axes[1], 7500.0, 1e-3, 1e3)
        effects = {effect.name: effect for effect in (*library(disk), *library(plate))}
        rows = (
            (
                f"`{name}`",
                f"`{one.name}`",
                one.unit,
                f"{one.low:.3g} … {one.high:.3g}",
                f"{one.rest:g}",
                f"{one.spread:.3g}",
            )
            for name, effect in sorted(effects.items())
            for one in effect.parameters
        )
        return markdown(("effect", "parameter", "unit", "bounds of a fit", "no effect at", "usual size"), rows)


class MaterialsDirective(_Made):
    """The material library."""

    def table(self) -> str:
        found = [library_material(name) for name in library_names()]
        return markdown(
            ("base", "density, kg/m^3", "source"), ((f"`{one.name}`", f"{one.density:g}", one.source) for one in found)
        )


class RulesDirective(_Made):
    """The thresholds of a diagnosis."""

    def table(self) -> str:
        rules = Rules().to_json().items()
        rows = ((f"`{name}`", f"{one['value']:g}", one["principle"]) for name, one in rules)
        return markdown(("rule", "value", "principle"), rows)


def _codes(names: tuple[str, ...]) -> str:
    return ", ".join(f"`{name}`" for name in names)


def setup(app: Sphinx) -> dict[str, bool]:
    """Register the directives."""
    app.add_directive("schema", SchemaDirective)
    app.add_directive("shapes", ShapesDirective)
    app.add_directive("effects", EffectsDirective)
    app.add_directive("materials", MaterialsDirective)
    app.add_directive("rules", RulesDirective)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
