"""The folder that a page shows: its specimens, sweeps and results, and nothing outside."""

from __future__ import annotations

import os
import re
import tomllib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from femu_piezo.errors import InputError
from femu_piezo.files import write_atomically
from femu_piezo.measurement.spectrum import ENDINGS
from femu_piezo.specimen.file import Specimen, read_specimens

RESULTS = "results"
"""Folder of the results, beside the specimens."""

OWN = ".femu-piezo"
"""Folder of what the page keeps for itself: unsaved edits, jobs, times."""

LARGEST_UPLOAD = 50_000_000
"""Largest uploaded file, bytes."""

_ACCEPTED = (*ENDINGS, ".toml", ".msh", ".inp")
#: Depth of the folders that are listed, and bytes of a specimen file that are checked.
_DEEPEST, _LONGEST = 3, 1_000_000
#: Bytes of the name of an uploaded file; file systems take 255, and temporary files have longer names.
_LONGEST_NAME = 180
#: Files that a folder lists at most, and that it may hold before uploads are refused.
_MOST_LISTED, _MOST_FILES = 2000, 20_000


class Outside(InputError):
    """A specimen file names a file outside the folder, or an environment variable."""


def lot_of(name: str) -> str:
    """The name of the folder that holds the specimen file of a name."""
    return name.rpartition("/")[0] or "."


@dataclass(frozen=True)
class Workspace:
    """A folder as the page sees it. Files are named by their path relative to it, with slashes.

    Attributes
    ----------
    folder : absolute, without symbolic links
    """

    folder: Path

    @classmethod
    def of(cls, folder: Path | str) -> Workspace:
        """The workspace of an existing folder; InputError where there is none."""
        path = Path(folder)
        if not path.is_dir():
            raise InputError(f"{path}: there is no such folder; give the folder that holds your sweeps")
        return cls(path.resolve())

    def path(self, name: str) -> Path:
        """The file or folder of a name; InputError where it lies outside, or in the folder `OWN`."""
        if "\0" in name or not name:
            raise InputError(f"{name!r} is not a path in this folder")
        found = (self.folder / name).resolve()
        if not found.is_relative_to(self.folder) or OWN in found.relative_to(self.folder).parts:
            raise InputError(f"{name!r} lies outside the folder of this page; choose a file in it")
        return found

    def name(self, path: Path) -> str:
        """The name of a file in the folder."""
        return path.relative_to(self.folder).as_posix()

    @property
    def own_folder(self) -> Path:
        """The folder `OWN`; made where it is missing."""
        folder = self.folder / OWN
        folder.mkdir(exist_ok=True)
        return folder

    def _files(self, endings: tuple[str, ...]) -> Iterator[str]:
        """Names of files with some endings, those of results and hidden ones left out, upper folders first."""
        folders, count = [(self.folder, 0)], 0
        while folders:
            folder, depth = folders.pop(0)
            try:
                entries = sorted(folder.iterdir())
            except OSError:
                continue
            for entry in entries:
                if entry.name.startswith(".") or entry.is_symlink():
                    continue
                if entry.is_dir():
                    if depth < _DEEPEST and not (depth == 0 and entry.name == RESULTS):
                        folders.append((entry, depth + 1))
                elif entry.suffix.lower() in endings and count < _MOST_LISTED:
                    count += 1
                    yield self.name(entry)

    def specimens(self) -> list[str]:
        """Specimen and study files."""
        return list(self._files((".toml",)))

    def sweeps(self) -> list[str]:
        """Files that may be sweeps."""
        return list(self._files(ENDINGS))

    def lots(self) -> list[str]:
        """Folders that hold specimens; the folder itself, ".", only where it holds several."""
        folders = [lot_of(name) for name in self.specimens()]
        return sorted({one for one in folders if one != "." or folders.count(".") > 1})

    def results(self, source: str, command: str) -> str:
        """Name of the folder where the results of a command on a file or lot go."""
        return f"{RESULTS}/{command if source == '.' else f'{source}/{command}'}"

    def specimen(self, name: str) -> list[Specimen]:
        """The specimens of a file, all of whose files lie in the folder; InputError where one does not."""
        path = self.path(name)
        self._refuse_harmful(path)
        found = read_specimens([path])
        for specimen in found:
            for path in specimen.files:
                self._refuse_outside(path)
        return found

    def _refuse_harmful(self, path: Path, studied: bool = True) -> None:
        """Raise Outside where a file, not read yet, names environment variables or, as a study, specimens outside.

        Messages of errors would show their values.
        """
        try:
            text = path.read_bytes()[:_LONGEST].decode("utf-8-sig")
            members = tomllib.loads(text).get("specimens")
        except (OSError, ValueError, RecursionError):
            return  # reading it says what is wrong
        if "${" in text:
            raise Outside(f"{path.name}: the page reads no environment variables; write the path without ${{…}}")
        for member in members if isinstance(members, list) and studied else ():
            if isinstance(member, str):
                file = path.parent / os.path.expanduser(member)
                self._refuse_outside(file)
                self._refuse_harmful(file, studied=False)  # a study names no studies

    def _refuse_outside(self, path: Path) -> None:
        if not path.resolve().is_relative_to(self.folder):
            raise Outside(
                f"{path.name}: this file, which the specimen file names, lies outside the folder of this page; copy it "
                "into the folder"
            )

    def take(self, name: str, content: bytes) -> str:
        """Keep an uploaded file under its name, with a number added where another file has that name; the name kept.

        Raises InputError where it is too large or of a kind that is not read, or the folder is full.
        """
        clean = re.sub(r"[^\w.+ ()=,-]", "_", Path(name.replace("\\", "/")).name)
        clean = clean.encode()[-_LONGEST_NAME:].decode(errors="ignore").lstrip(". ")
        if Path(clean).suffix.lower() not in _ACCEPTED:
            raise InputError(f"{name}: files of this kind are not read; give one of {', '.join(_ACCEPTED)}")
        if len(content) > LARGEST_UPLOAD:
            raise InputError(
                f"{name}: the file has {len(content) / 1e6:.0f} MB, more than the {LARGEST_UPLOAD / 1e6:.0f} MB "
                "allowed; is this the right file?"
            )
        if sum(1 for _ in self.folder.iterdir()) > _MOST_FILES:
            raise InputError(f"{self.folder.name}: the folder holds more than {_MOST_FILES} files; use another one")
        path, number = self.folder / clean, 1
        while path.is_dir() or (path.exists() and path.read_bytes() != content):
            number += 1
            path = self.folder / f"{Path(clean).stem}-{number}{Path(clean).suffix}"
        write_atomically(path, content)
        return self.name(path)

    def free_name(self, name: str) -> str:
        """A name that no file has yet, with a number where needed."""
        path, number = self.path(name), 1
        while path.exists():
            number += 1
            path = self.path(f"{name.removesuffix('.toml')}-{number}.toml")
        return self.name(path)
