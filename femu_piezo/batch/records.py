"""Results on disk: one file per job, complete at any time."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path

from femu_piezo.batch.worker import FINAL
from femu_piezo.files import SCHEMA, json_text, write_atomically

_KEYS = {"name", "checksum", "status", "reason", "columns", "results"}


class Records:
    """The records of a lot, one JSON file each in `folder`."""

    def __init__(self, folder: Path) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        self._folder = folder
        for stale in folder.glob(".*.tmp"):  # of a run that was killed while it wrote
            stale.unlink(missing_ok=True)

    @property
    def folder(self) -> Path:
        """Where the files are."""
        return self._folder

    def path(self, name: str) -> Path:
        """File of the job `name`."""
        return _path(self._folder, name)

    def read(self, name: str, checksum: str) -> dict | None:
        """The record of a job where its status is final and its checksum this one; None where it must be computed."""
        try:
            found = json.loads(self.path(name).read_bytes())
        except (OSError, ValueError, RecursionError):
            return None
        if not isinstance(found, dict) or found.pop("schema", None) != SCHEMA or set(found) != _KEYS:
            return None
        if not isinstance(found["columns"], dict):
            return None
        return found if found["checksum"] == checksum and found["status"] in FINAL else None

    def write(self, record: dict) -> None:
        """Make a record durable."""
        write_record(self._folder, record)


def write_record(folder: Path, record: dict) -> None:
    """Make a record durable in a folder of records."""
    write_atomically(_path(folder, record["name"]), json_text(record, indent=None))


def _path(folder: Path, name: str) -> Path:
    if len(name.encode()) > 200:
        name = hashlib.sha256(name.encode()).hexdigest()
    return folder / f"{name}.json"
