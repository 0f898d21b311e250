"""Specimen: a form of the file's keys, a drawing of the body, the text of the file (TOML)."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any, Literal, get_args, get_origin
from urllib.parse import urlencode

from nicegui import ui

from femu_piezo.errors import InputError
from femu_piezo.material.library import library_names
from femu_piezo.specimen.file import CONSTANTS, Limits, Material, Measurement, Readings, Simulation, Update
from femu_piezo.specimen.geometry import DIMENSIONS, Geometry, belongs_to
from femu_piezo.specimen.schema import Table
from femu_piezo.web.drafts import Draft, parsed, shown, table_of
from femu_piezo.web.drawing import drawing
from femu_piezo.web.site import Site, complain, nothing

#: Example of the content of a field, by the beginning of its key.
_EXAMPLES = {
    "length": "40 mm",
    "width": "5 mm",
    "thickness": "1 mm",
    "diameter": "10 mm",
    "density": "7900 kg/m^3",
    "mass": "1.580 g",
    "std_length": "0.02 mm",
    "std_density": "0.5 %",
    "noise": "0.1 %",
    "held_out": '["90 kHz", "120 kHz"]',
    "mask": '[["61 kHz", "61.4 kHz"]]',
    "accuracy": "0.08 %",
    "phase_accuracy": "0.8 mrad",
    "s11": "16.5e-12",
    "d31": "-255e-12",
    "eps33T": "3400 eps0",
    "tan_": "1.5 %",
    "std_": "5 %",
}
#: Keys that are shown at once; the others are in a part that opens.
_FIRST = {
    "geometry": ("density", "mass", "poling"),
    "material": ("base", "free", "simplified"),
    "measurement": ("file", "noise", "held_out", "mask", "correct_phase", "mask_faults"),
}
_TABLES: dict[str, type[Table]] = {
    "geometry": Geometry,
    "material": Material,
    "measurement": Measurement,
    "readings": Readings,
    "limits": Limits,
    "simulation": Simulation,
    "update": Update,
}


def register(site: Site) -> None:
    """The page at /specimen."""

    @ui.page("/specimen")
    def page(spec: str = "", file: str = "") -> None:
        names = site.workspace.specimens()
        if not spec and names:
            spec = names[0]
        with site.frame("specimen", {"spec": spec, "file": file}):
            site.choose([*names, *([spec] if spec and spec not in names else [])], spec, "Specimen", "specimen", "spec")
            if not spec:
                nothing(
                    "This folder has no specimen file yet: choose a sweep on its page, and describe its specimen there."
                )
                return
            try:
                _Form(site, spec, site.draft(spec)).build()
            except InputError as error:
                ui.label(str(error)).classes("error").props('role="alert"')


class _Form:
    """Form, drawing and text of a specimen; all show the same draft."""

    def __init__(self, site: Site, name: str, draft: Draft) -> None:
        self._site, self._name, self._draft = site, name, draft
        self._fields: dict[str, Any] = {}
        self._shape: str | None = None
        self._following = False

    def build(self) -> None:
        with ui.row().classes("gap-2 items-center"):
            self._undo = ui.button("Undo", color=None, on_click=lambda: self._step(self._draft.undo)).props(
                "flat no-caps"
            )
            self._redo = ui.button("Redo", color=None, on_click=lambda: self._step(self._draft.redo)).props(
                "flat no-caps"
            )
            self._save = ui.button("Save", on_click=self._write).props("no-caps")
            self._state = ui.label().props('role="status" aria-live="polite"')
            query = urlencode({"spec": self._name})
            ui.link("update", f"/update?{query}")
            ui.link("diagnosis", f"/diagnosis?{query}")
        with ui.element("div").classes("w-full grid grid-cols-1 lg:grid-cols-2 gap-4"):
            self._form = ui.column().classes("w-full min-w-0 gap-3")
            with ui.column().classes("w-full min-w-0 gap-3"):
                self._picture = ui.html("", sanitize=False).classes("w-full")
                self._editor = ui.codemirror(
                    self._draft.text, language="TOML", theme="githubLight", on_change=self._typed, line_wrapping=True
                )
                self._editor.classes("w-full border rounded").props('aria-label="specimen file (TOML)"')
                self._editor.style("min-height: 22rem; height: auto")
        self._rebuild()

    def _rebuild(self) -> None:
        """Build the form again, with the fields of the current shape."""
        self._form.clear()
        self._fields = {}
        tables = self._draft.tables()
        shape = _shape(tables)
        with self._form:
            self._field("", "name", None, tables.get("name")).classes("w-full")
            for table, model in _TABLES.items():
                given = table_of(tables, table)
                keys = self._keys(table, model, shape)
                first = [key for key in keys if key in _FIRST.get(table, ()) or self._is_dimension(table, key, shape)]
                with ui.expansion(table.capitalize(), value=table in _FIRST).classes("w-full border rounded"):
                    self._fields_of(table, model, first or keys, given)
                    rest = [key for key in keys if first and key not in first]
                    if rest:
                        opened = any(key in given for key in rest)
                        with ui.expansion("more", value=opened).classes("w-full"):
                            self._fields_of(table, model, rest, given)
        self._shape = shape
        self._tell()

    @staticmethod
    def _keys(table: str, model: type[Table], shape: str | None) -> list[str]:
        keys = list(model.model_fields)
        if table == "geometry" and shape in DIMENSIONS:
            keys = [key for key in keys if belongs_to(shape, key)]
        nested = ("residue", "load")  # tables of their own, written in the text
        return [key for key in keys if key not in nested]

    @staticmethod
    def _is_dimension(table: str, key: str, shape: str | None) -> bool:
        return table == "geometry" and (key == "shape" or key in DIMENSIONS.get(shape, ()))

    def _fields_of(self, table: str, model: type[Table], keys: Sequence[str], given: dict) -> None:
        with ui.element("div").classes("w-full grid grid-cols-1 sm:grid-cols-2 gap-x-4 gap-y-2"):
            for key in keys:
                self._field(table, key, model.model_fields[key].annotation, given.get(key))

    def _field(self, table: str, key: str, kind: Any, value: Any) -> ui.element:
        """The field of a key: a switch, a choice, or a line of text, by the type of the key."""
        where, label = f"{table}.{key}" if table else key, key.replace("_", " ")
        options = self._options(table, key, kind)
        if kind is bool:
            field = ui.switch(label, value=value is True, on_change=lambda e: self._put(table, key, e.value or None))
        elif options is not None and key == "free":
            field = ui.select(
                options,
                value=_chosen(value, options),
                multiple=True,
                label="free constants",
                on_change=self._putter(table, key),
            )
            field.props("outlined dense use-chips hide-bottom-space")
        elif options is not None:
            known = options if value is None or value in options else [*options, value]
            field = ui.select(known, value=value, label=label, clearable=True, on_change=self._putter(table, key))
            field.props("outlined dense hide-bottom-space")
        else:
            example = max((one for one in _EXAMPLES if key.startswith(one)), key=len, default="")
            field = ui.input(
                label, value=shown(value), placeholder=_EXAMPLES.get(example) and f"such as {_EXAMPLES[example]}"
            )
            field.props("outlined dense stack-label hide-bottom-space")
            words = key == "name" or str in (kind, *get_args(kind))
            field.on("change", lambda _, field=field: self._put(table, key, _read(field.value or "", words)))
        self._fields[where] = field
        return field

    def _options(self, table: str, key: str, kind: Any) -> list[str] | None:
        if (table, key) == ("material", "base"):
            return list(library_names())
        if (table, key) == ("material", "free"):
            return list(CONSTANTS)
        if (table, key) == ("measurement", "file"):
            folder = self._name.rpartition("/")[0]
            in_folder = [name for name in self._site.workspace.sweeps() if name.rpartition("/")[0] == folder]
            return [name.rpartition("/")[2] for name in in_folder]
        choices = [kind, *get_args(kind)]
        return next((list(get_args(one)) for one in choices if get_origin(one) is Literal), None)

    def _putter(self, table: str, key: str):
        return lambda event: self._put(table, key, event.value or None)

    def _put(self, table: str, key: str, value: Any) -> None:
        if self._following:
            return
        try:
            self._draft.put(table, key, value)
        except InputError as error:
            complain(str(error))
            return
        if key == "shape":
            self._drop_foreign_dimensions(value)
        self._editor.value = self._draft.text
        if key == "shape":
            self._rebuild()
        else:
            self._tell()

    def _drop_foreign_dimensions(self, shape: str | None) -> None:
        """Remove the keys of [geometry] that the new shape does not have."""
        for key in list(self._draft.tables().get("geometry", {})):
            if shape in DIMENSIONS and key in Geometry.model_fields and not belongs_to(shape, key):
                self._draft.put("geometry", key, None)

    def _typed(self, event) -> None:
        """Adapt the form to a text that was edited by hand."""
        if event.value == self._draft.text:
            return
        self._draft.set(event.value, typed=True)
        tables = self._draft.tables()
        if table_of(tables, "geometry") and _shape(tables) != self._shape:
            self._rebuild()
        elif tables:
            self._follow(tables)
            self._tell()
        else:
            self._tell()

    def _follow(self, tables: dict[str, Any]) -> None:
        """Set the fields to the values of the text; this counts as no edit."""
        self._following = True
        for where, field in self._fields.items():
            table, _, key = where.rpartition(".")
            value = (table_of(tables, table) if table else tables).get(key)
            if isinstance(field, ui.switch):
                field.value = value is True
            elif isinstance(field, ui.select):
                if key == "free":
                    field.value = _chosen(value, field.options)
                else:
                    field.value = value if value in field.options else None
            else:
                field.value = shown(value)
        self._following = False

    def _step(self, move) -> None:
        move()
        self._editor.value = self._draft.text
        self._rebuild()

    def _write(self) -> None:
        try:
            self._draft.save()
        except InputError as error:
            complain(str(error))
            return
        ui.notify(f"{self._name} is saved", type="positive")
        self._tell()

    def _tell(self) -> None:
        """Show the drawing, the state of the buttons, and the sentence of an error at its field."""
        problem = self._draft.problem()
        self._undo.set_enabled(self._draft.can_undo)
        self._redo.set_enabled(self._draft.can_redo)
        self._save.set_enabled(self._draft.changed and not problem)
        self._state.text = problem or ("not saved yet" if self._draft.changed else "saved")
        self._state.classes(replace="error" if problem else "")
        for where, field in self._fields.items():
            concerned = re.search(rf"(?<![\w.]){re.escape(where)}\b", problem) is not None
            field.props(remove="error error-message")
            if concerned and not isinstance(field, ui.switch):
                sentence = problem.partition(f"{self._name}: ")[2] or problem
                field.props["error"], field.props["error-message"] = True, sentence
            field.update()
        try:
            tables = self._draft.tables().get("geometry", {})
            self._picture.content = drawing(Geometry.model_validate({k: v for k, v in tables.items() if k != "file"}))
        except (InputError, AttributeError, TypeError, ZeroDivisionError):
            self._picture.content = "<p>A drawing appears here as soon as shape and dimensions are given.</p>"


def _shape(tables: dict[str, Any]) -> str | None:
    """The word that stands for the shape, None where there is none."""
    found = table_of(tables, "geometry").get("shape")
    return found if isinstance(found, str) else None


def _chosen(value: Any, options: Sequence[str]) -> list[str]:
    """What a list holds of the options; nothing where the value is no list."""
    return [one for one in value if one in options] if isinstance(value, list) else []


def _read(text: str, words: bool) -> Any:
    """The value of a field: its text where the key takes `words`, unless that is a list; else as `parsed` gives it."""
    found = parsed(text)
    return text.strip() if words and found is not None and not isinstance(found, list) else found
