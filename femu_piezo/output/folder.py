"""Writing a folder of results: everything is computed first, every file appears whole."""

from __future__ import annotations

import io
import os
import re
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from femu_piezo.errors import InputError
from femu_piezo.files import json_text, path_of, write_atomically

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_made: list[Path] = []
#: Difference of the clocks of a file system and of the machine that is allowed for, s.
_CLOCK = 2.0


def prepare_folder(folder: Path | str) -> Path:
    """Create the result folder, so that a wrong place is known before the work; InputError where it cannot be."""
    out = path_of(folder)
    try:
        _made.extend(one for one in (*reversed(out.parents), out) if not one.exists())
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{out}: cannot be used as result folder ({error.strerror}); choose another folder") from None
    if not os.access(out, os.W_OK):
        raise InputError(f"{out}: the folder cannot be written to; choose another folder")
    return out


def older_files(folder: Path, names: Iterable[str], began: float) -> list[str]:
    """Files of a result folder that a run did not write, but an earlier one may have, in natural order.

    Parameters
    ----------
    names : what the command may write; "impedance.png" stands for impedance_2.png as well
    began : when the run began to write, s since 1970
    """
    stems = (re.escape(name).replace(r"\.", r"(_\d+)?\.", 1) for name in names)
    ours = re.compile("|".join(stems))
    found = [path for path in folder.iterdir() if ours.fullmatch(path.name)]
    return sorted(path.name for path in found if path.stat().st_mtime < began - _CLOCK)


def remove_empty_folders() -> None:
    """Remove the empty folders that `prepare_folder` made, so that a refused run leaves none behind."""
    while _made:
        folder = _made.pop()
        if folder.is_dir() and not any(folder.iterdir()):
            folder.rmdir()


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Hold the folder for one run; InputError where another run holds it. A killed run holds nothing."""
    try:
        import fcntl
    except ImportError:  # Windows: nothing prevents two runs at once
        yield
        return
    path = folder / ".lock"
    with open(path, "a") as stream:
        try:
            fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
            held = os.path.samestat(os.fstat(stream.fileno()), path.stat())  # not removed by a run that just ended
        except OSError:
            held = False
        if not held:
            raise InputError(f"{folder}: another run writes to this folder; wait for its end, or choose another --out")
        try:
            yield
        finally:
            path.unlink(missing_ok=True)


def write_json(path: Path, record: dict) -> None:
    """One JSON file, whole or not at all; NaN is refused."""
    write_atomically(path, json_text(record))


def write_figure(path: Path, figure: Figure, dots_per_inch: int = 150) -> None:
    """One PNG, whole or not at all."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=dots_per_inch)
    write_binary(path, buffer.getvalue())


def write_binary(path: Path, data: bytes) -> None:
    """One binary file, whole or not at all."""
    write_atomically(path, data)
