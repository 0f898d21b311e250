"""The jobs of a lot: which files belong together, and the checksums that tell whether a result still holds."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import femu_piezo
from femu_piezo.errors import InputError
from femu_piezo.measurement.spectrum import ENDINGS
from femu_piezo.specimen.file import Specimen, read_specimens, with_measurement

_ABSENT = "absent"


@dataclass(frozen=True)
class Job:
    """One step of one row of the lot.

    Attributes
    ----------
    name : file name within the lot's folder, unique there
    specimen : specimen file
    sweep : measured sweep in place of the specimen file's own; None to use that
    step : what to compute, a name of `femu_piezo.batch.steps.STEPS`
    correct_phase, mask_faults : what to correct in the sweep, whatever the specimen file says
    """

    name: str
    specimen: Path
    sweep: Path | None = None
    step: str = "update"
    correct_phase: bool = False
    mask_faults: bool = False

    def read(self) -> Inputs:
        """The specimens to update together with all their files."""
        files = [self.specimen] if self.sweep is None else [self.specimen, self.sweep]
        try:
            specimens = read_specimens([self.specimen], self.sweep)
        except InputError as error:
            return Inputs(tuple(files), (), error)
        for one in specimens:
            files += one.files
        asked = {"correct_phase": self.correct_phase, "mask_faults": self.mask_faults}
        specimens = with_measurement(specimens, **asked)
        return Inputs(tuple(dict.fromkeys(files)), tuple(specimens), None)

    def checksum(self, program: str, contents: Iterable[str]) -> str:
        """SHA-256 over `program_checksum`, options and `Inputs.contents`: a result holds for the same one."""
        digest = hashlib.sha256(f"{program}\0{self.name}\0{self.step}\0{self.correct_phase}{self.mask_faults}".encode())
        for content in contents:
            digest.update(b"\0" + content.encode())
        return digest.hexdigest()


@dataclass(frozen=True)
class Inputs:
    """What a job works on.

    Attributes
    ----------
    files : every file the result depends on, as far as the specimen file could be read
    specimens : specimens to update together;  error : why there are none
    """

    files: tuple[Path, ...]
    specimens: tuple[Specimen, ...]
    error: InputError | None

    def contents(self) -> tuple[str, ...]:
        """`file_checksum` of every file, in their order; read anew each time, as files may change."""
        return tuple(file_checksum(path) for path in self.files)

    def of_sweeps(self, contents: Iterable[str]) -> tuple[str, ...]:
        """Those of the measured sweeps among the contents of all files."""
        known = dict(zip(self.files, contents, strict=True))
        tables = (part.measurement for one in self.specimens for part in one.of_each_sweep)
        return tuple(known[table.file] for table in tables if table is not None and table.file is not None)


def same_sweeps(sweeps: Mapping[str, tuple[str, ...]]) -> tuple[tuple[str, ...], ...]:
    """The names of jobs with the same sweeps, several in each group; sweeps : name → their contents."""
    groups: dict[tuple[str, ...], list[str]] = {}
    for name, contents in sweeps.items():
        groups.setdefault(contents, []).append(name)
    return tuple(tuple(names) for key, names in groups.items() if len(names) > 1 and key and _ABSENT not in key)


def find_jobs(
    folder: Path, specimen: Path | None = None, *, correct_phase: bool = False, mask_faults: bool = False
) -> list[Job]:
    """The jobs of a folder in natural order of their names ("plate 9" before "plate 10").

    Parameters
    ----------
    specimen : None for a folder of specimen files (.toml); else the specimen file of a folder of sweeps

    Raises
    ------
    InputError : there is no such folder, or nothing to do in it
    """
    endings = (".toml",) if specimen is None else ENDINGS
    try:
        files = [path for path in sorted(folder.iterdir()) if path.suffix.lower() in endings]
        files = [path for path in files if path.is_file() or not path.exists()]  # a link to nothing is a row of its own
    except OSError as error:
        raise InputError(
            f"{folder}: this is no folder that can be read ({error.strerror}); give the folder of the lot"
        ) from None
    files = [path.absolute() for path in files if not path.name.startswith(".")]
    if not files:
        other = "" if specimen else "; for a folder of sweeps of one kind of specimen give --specimen SPEC"
        raise InputError(f"{folder}: there are no files {' '.join('*' + e for e in endings)} in this folder{other}")
    if specimen is not None and not specimen.is_file():
        raise InputError(f"{specimen}: there is no such specimen file; check --specimen")
    files.sort(key=lambda path: natural_order(path.name))
    options = {"correct_phase": correct_phase, "mask_faults": mask_faults}
    if specimen is None:
        return [Job(path.name, path, **options) for path in files]
    return [Job(path.name, specimen.absolute(), path, **options) for path in files]


def natural_order(name: str) -> tuple:
    """Sorting key that takes digits as numbers."""
    parts = re.split(r"(\d+)", name)
    return tuple((part.casefold(), 0) if index % 2 == 0 else ("", int(part)) for index, part in enumerate(parts)), name


@cache
def program_checksum() -> str:
    """Version and SHA-256 of the program's own sources: any change of them makes a lot compute again."""
    digest = hashlib.sha256(femu_piezo.__version__.encode())
    root = Path(femu_piezo.__file__).parent
    for path in sorted(root.rglob("*.py")):
        digest.update(f"\0{path.relative_to(root).as_posix()}\0".encode() + path.read_bytes())
    return f"{femu_piezo.__version__}+{digest.hexdigest()[:16]}"


def file_checksum(path: Path) -> str:
    """SHA-256 of the content of a file; "absent" where it cannot be read."""
    try:
        with open(path, "rb") as stream:
            return hashlib.file_digest(stream, "sha256").hexdigest()
    except OSError:
        return _ABSENT
