"""Edits of a specimen file that are not saved yet: every state of the text, so that any step can be undone."""

from __future__ import annotations

import hashlib
import json
import time
import tomllib
from collections.abc import MutableMapping
from typing import Any

import tomlkit
from tomlkit.exceptions import TOMLKitError

from femu_piezo.errors import InputError
from femu_piezo.files import write_atomically
from femu_piezo.web.workspace import Workspace

#: Most states of a text that are kept, and seconds without typing after which a new step begins.
_DEEPEST, _PAUSE = 200, 2.0


class Draft:
    """The text of a specimen file under edit, kept over a restart.

    Parameters
    ----------
    name : of the specimen file in the workspace
    who : identity of the browser; each has its own edits
    """

    def __init__(self, workspace: Workspace, name: str, who: str) -> None:
        self._workspace, self._name = workspace, name
        key = hashlib.sha256(f"{who}\0{name}".encode()).hexdigest()[:24]
        folder = workspace.own_folder / "drafts"
        folder.mkdir(exist_ok=True)
        self._file = folder / f"{key}.json"
        self._typed_at = 0.0
        self._read()

    def _read(self) -> None:
        """Load the kept states. A file changed elsewhere adds its text as a step; undo leads back to the edits."""
        self._saved = self._on_disk()
        self._texts, self._at = [self._saved], 0
        try:
            kept = json.loads(self._file.read_text(encoding="utf-8"))
            texts, at = list(map(str, kept["texts"])), int(kept["at"])
            if 0 <= at < len(texts):
                self._texts, self._at = texts, at
                if kept["saved"] != self._saved:
                    self._texts, self._at = [*texts[: at + 1], self._saved], at + 1
                    self._keep()
        except (OSError, ValueError, KeyError, TypeError):
            pass

    def _on_disk(self) -> str:
        path = self._workspace.path(self._name)
        try:
            return path.read_text(encoding="utf-8-sig")
        except FileNotFoundError:
            return ""
        except (OSError, UnicodeDecodeError):
            raise InputError(f"{self._name}: this is not a text file that can be read") from None

    @property
    def text(self) -> str:
        """The current text."""
        return self._texts[self._at]

    @property
    def changed(self) -> bool:
        """Whether the text differs from the saved one."""
        return self.text != self._saved

    @property
    def can_undo(self) -> bool:
        """Whether there is a step to undo."""
        return self._at > 0

    @property
    def can_redo(self) -> bool:
        """Whether there is an undone step to do again."""
        return self._at < len(self._texts) - 1

    def set(self, text: str, *, typed: bool = False) -> None:
        """Set the text: as a further step or, where `typed` within `_PAUSE` of the last typing, in its place."""
        before = self.text
        self._read()  # another window may have edited meanwhile
        if text == self.text or text == before:
            return
        now, continues = time.monotonic(), typed and self._at > 0 and time.monotonic() - self._typed_at < _PAUSE
        self._texts = [*self._texts[: self._at + (not continues)], text][-_DEEPEST:]
        self._at = len(self._texts) - 1
        self._typed_at = now if typed else 0.0
        self._keep()

    def undo(self) -> None:
        """One step back."""
        self._move(-1)

    def redo(self) -> None:
        """One step forward again."""
        self._move(1)

    def _move(self, step: int) -> None:
        self._read()
        self._typed_at = 0.0
        self._at = min(max(self._at + step, 0), len(self._texts) - 1)
        self._keep()

    def _keep(self) -> None:
        write_atomically(self._file, json.dumps({"saved": self._saved, "texts": self._texts, "at": self._at}))

    def save(self) -> None:
        """Write the specimen file; InputError where the text is no specimen, or the file was changed elsewhere."""
        self.problem_or_raise()
        if self._on_disk() != self._saved:
            self._read()
            raise InputError(
                f"{self._name}: the file was changed elsewhere and is shown as it is now; Undo brings your edits back"
            )
        write_atomically(self._workspace.path(self._name), self.text)
        self._saved = self.text
        self._keep()

    def problem_or_raise(self) -> None:
        """Raise InputError with the sentence of the command line where the text is no specimen."""
        path = self._workspace.path(self._name)
        trial = path.with_name(f".{path.stem}.{self._file.stem}.toml")
        try:
            write_atomically(trial, self.text)
            self._workspace.specimen(self._workspace.name(trial))
        except InputError as error:
            raise InputError(str(error).replace(str(trial), self._name)) from None
        finally:
            trial.unlink(missing_ok=True)

    def problem(self) -> str:
        """The sentence of `problem_or_raise`, "" where nothing is wrong."""
        try:
            self.problem_or_raise()
        except InputError as error:
            return str(error)
        return ""

    def tables(self) -> dict[str, Any]:
        """The tables of the text as they stand; empty where it is no TOML."""
        try:
            return tomllib.loads(self.text)
        except (tomllib.TOMLDecodeError, ValueError, RecursionError):
            return {}

    def put(self, table: str, key: str, value: Any) -> None:
        """Set a key of a table ("" for the top), or take it out where the value is None; the rest stays as written."""
        try:
            document = tomlkit.parse(self.text)
        except (TOMLKitError, RecursionError):
            raise InputError(
                f"{self._name}: the text is not valid TOML at present; correct it on the right first"
            ) from None
        if table and table not in document:
            if value is None:
                return
            document.add(table, tomlkit.table())
        place = document[table] if table else document
        if not isinstance(place, MutableMapping):
            raise InputError(f"{self._name}: {table} is not a table; write [{table}] and its keys below")
        if value is None:
            if key in place:
                place.remove(key)
        else:
            place[key] = value
        self.set(tomlkit.dumps(document))


def table_of(tables: dict[str, Any], name: str) -> dict[str, Any]:
    """A table of a text that is being written; empty where the name is missing or stands for something else."""
    found = tables.get(name)
    return found if isinstance(found, dict) else {}


def parsed(text: str) -> Any:
    """The value of the text in a field: a number, a list, true or false as in TOML, else a string such as "40 mm"."""
    text = text.strip()
    if not text:
        return None
    try:
        return tomllib.loads(f"x = {text}")["x"]
    except (tomllib.TOMLDecodeError, ValueError, RecursionError):
        return text


def shown(value: Any) -> str:
    """The text of a field with a value, from which `parsed` gets the value back."""
    if value is None:
        return ""
    if isinstance(value, str):
        return value
    if isinstance(value, bool):
        return str(value).lower()
    return tomlkit.item(value).as_string() if isinstance(value, (list, dict)) else repr(value)
