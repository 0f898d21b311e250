"""Tables of a specimen file as frozen pydantic models whose errors are one sentence each."""

from __future__ import annotations

import difflib
import inspect
import typing
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationError, ValidationInfo, model_validator

from femu_piezo.errors import InputError
from femu_piezo.units import parse_quantity, shown


class Table(BaseModel):
    """One table of a specimen file: frozen, no unknown keys, wrong values told in one sentence.

    `title` in the model's configuration is the name of the table; `missing` says, for each key that must be
    there, what to write. Building a model, from a file (named in the context "file") or in Python, raises
    `InputError`. The docstring of a table ends in the descriptions of its keys.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, allow_inf_nan=False)
    missing: ClassVar[dict[str, str]] = {}

    @classmethod
    def __pydantic_init_subclass__(cls, **kwargs: Any) -> None:
        keys = [f"{name}\n    {field.description}" for name, field in cls.model_fields.items() if field.description]
        cls.__doc__ = "\n".join([inspect.cleandoc(cls.__doc__ or ""), "", "Attributes", "----------", *keys])

    @classmethod
    def usual(cls, name: str) -> float:
        """The number, SI, that is taken where a file does not give the key `name`; KeyError where there is none."""
        extra = cls.model_fields[name].json_schema_extra
        if not isinstance(extra, dict):
            raise KeyError(f"nothing stands in for {name}")
        return float(str(extra["usual"]))

    @model_validator(mode="wrap")
    @classmethod
    def _one_sentence(cls, data: Any, handler: Any, info: ValidationInfo) -> Any:
        try:
            table = handler(data)
            problem = table.problem()
        except ValidationError as error:
            # an unknown key is told first: it is often the reason why another is missing
            first = min(error.errors(), key=lambda detail: detail["type"] != "extra_forbidden")
            problem = _sentence(first, cls)
        if problem:
            file = (info.context or {}).get("file")
            raise InputError(f"{file}: {problem}" if file else problem)
        return table

    def stated(self, name: str) -> float:
        """The number of the key `name`, SI; where it is absent, that of `usual`."""
        value = getattr(self, name)
        return self.usual(name) if value is None else value

    def __repr_args__(self):
        """What is given, without the keys that are absent."""
        return [(key, value) for key, value in super().__repr_args__() if value is not None]

    def problem(self) -> str | None:
        """What is wrong between several keys: key, value and what would be right. None if nothing."""
        return None

    @classmethod
    def si_unit(cls, key: str) -> str | None:
        """SI unit of the numbers of a key, "1" for a pure number; None where it takes no quantity."""
        field = cls.model_fields[key]
        parts = _parts((field.annotation, *field.metadata))
        return next((part.unit for part in parts if isinstance(part, Quantity)), None)


def _parts(hints: Iterable[object]) -> Iterator[object]:
    """Types and metadata inside of type hints."""
    for hint in hints:
        yield hint
        yield from _parts(typing.get_args(hint))


def _sentence(error: Any, table: type[Table]) -> str:
    """A pydantic error as one sentence: key, value, what would be right."""
    alternatives = ("float", "str")  # of a value that may be either, which pydantic names as if they were keys
    names = [table.model_config["title"], *(str(part) for part in error["loc"] if part not in alternatives)]
    key = ".".join(name for name in names if name)
    if error["type"] == "value_error":
        return f"{key}: {error['ctx']['error']}"
    if error["type"] == "extra_forbidden":
        known = [field for field in table.model_fields if field != "path"]
        near = difflib.get_close_matches(names[-1], known, 1)
        hint = f"did you mean {near[0]!r}?" if near else f"known are {', '.join(known)}"
        return f"{shown(key)[1:-1]} is not a key that is known; {hint}"
    if error["type"] == "missing":
        return f"{key} is missing" + (f"; {table.missing[names[-1]]}" if names[-1] in table.missing else "")
    if error["type"] in ("model_type", "dict_type"):
        return f"{key} = {shown(error['input'])} is not a table; write [{key}] and its keys below"
    message = (error["msg"][0].lower() + error["msg"][1:]).replace("a valid boolean", "true or false")
    message = message.replace("a valid tuple", "a list")
    return f"{key} = {shown(error['input'])} cannot be used; {message}"


def key_in_file(info: ValidationInfo) -> str:
    """The file, where there is one, and the key of a value that is being read, for messages."""
    file = (info.context or {}).get("file")
    return (f"{file}: " if file else "") + f"{info.config['title']}.{info.field_name}"


@dataclass(frozen=True)
class Quantity(BeforeValidator):
    """A validator with its limits: low ≤ value ≤ high in SI `unit`; `hint` is the advice where a value is outside."""

    unit: str = "1"
    low: float = 0.0
    high: float = 0.0
    hint: str = ""


def quantity(unit: str, low: float, high: float, hint: str) -> Quantity:
    """A validator: a number or "40 mm" to SI `unit`, low ≤ value ≤ high, else `hint` is said."""

    def parse(value: object, info: ValidationInfo) -> float | None:
        if value is None:
            return None
        where = key_in_file(info)
        number = parse_quantity(value, unit, where)
        if not low <= number <= high:
            unit_text = "" if unit == "1" else f" {unit}"
            raise InputError(f"{where}: {shown(value)} is outside {low:g} … {high:g}{unit_text}; {hint}")
        return number

    return Quantity(parse, unit=unit, low=low, high=high, hint=hint)


def described(description: str, default: Any = None, usual: float | None = None) -> Any:
    """A key of a table: its description, its default (... where it must be given), and the number in place of None.

    usual : SI; see `Table.usual`
    """
    return Field(default, description=description, json_schema_extra=None if usual is None else {"usual": usual})


def _to_tuple(value: object) -> object:
    return tuple(value) if isinstance(value, list) else value


def _to_pair(value: object) -> object:
    if isinstance(value, (list, tuple)) and len(value) != 2:
        raise ValueError(f"{shown(list(value))} has {len(value)} entries; give two, the lower one first")
    return _to_tuple(value)


def _to_path(value: object) -> object:
    if isinstance(value, (str, Path)) or value is None:
        return value if value is None else Path(value)
    raise ValueError(f"a path is a string, not {shown(value)}; write it in quotes")


LIST = BeforeValidator(_to_tuple)
"""Converts the lists of TOML to the tuples of frozen models."""

PAIR = BeforeValidator(_to_pair)
"""Converts a list of two to a tuple and refuses other lengths."""

PATH = BeforeValidator(_to_path)
"""Converts a string to a path."""
