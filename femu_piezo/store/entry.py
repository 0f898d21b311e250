"""The entry of one result in the store, identified by hashes of what was measured and of what was assumed."""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from femu_piezo.batch.jobs import Job, file_checksum, program_checksum
from femu_piezo.batch.lot import QUANTITIES
from femu_piezo.batch.steps import diagnosis_columns, update_columns
from femu_piezo.files import as_json
from femu_piezo.output.records import update_record
from femu_piezo.specimen.file import Specimen
from femu_piezo.study.results import UpdateResult
from femu_piezo.threads import made_once

if TYPE_CHECKING:
    from femu_piezo.study.diagnose import Diagnosis

#: Columns that tell one result from another.
KEY = ("piece", "assumed", "step", "program")


@dataclass(frozen=True)
class Measured:
    """A file of a sweep: `hash` SHA-256 of its content, `file` its name, `time` when it was written, UTC."""

    hash: str
    file: str
    time: datetime


@dataclass(frozen=True)
class Described:
    """A specimen file: `description` what a fit takes from it except sweeps, `hash` SHA-256 of the description.

    Where the file cannot be read, `description` is None and `hash` that of the file.
    """

    hash: str
    name: str
    description: dict[str, Any] | None


@dataclass(frozen=True)
class Entry:
    """One result.

    Attributes
    ----------
    step : "update" or "diagnose";  name : of the job or the piece;  status : "ok" or "failed", with the reason
    inputs : each specimen with each of its sweeps, None where it names none
    columns : the row of a lot's table;  record : update.json or diagnosis.json, None where there is no result
    """

    step: str
    name: str
    status: str
    reason: str
    inputs: tuple[tuple[Described, Measured | None], ...]
    columns: dict[str, Any]
    record: dict[str, Any] | None
    program: str

    @made_once
    def key(self) -> tuple[str, ...]:
        """The values of `KEY`."""
        return (self.piece, self.assumed, self.step, self.program)

    @property
    def piece(self) -> str:
        """SHA-256 of the hashes of all sweeps; of those of the descriptions where there is no sweep."""
        sweeps = [measured.hash for _, measured in self.inputs if measured is not None]
        return _sha256(sweeps or [described.hash for described, _ in self.inputs])

    @property
    def assumed(self) -> str:
        """SHA-256 of the hashes of all descriptions."""
        return _sha256([described.hash for described, _ in self.inputs])

    @property
    def estimates(self) -> list[dict[str, Any]]:
        """Rows of the table of estimates: k_eff and misfit where the columns have them, constants and tangents."""
        found = {
            name: (self.columns[name], self.columns.get(f"{name}_std")) for name in QUANTITIES if name in self.columns
        }
        for name, one in self._constants.items():
            found |= {name: (one["value"], one["std"]), f"{name}_tan": (one["tan"], one["tan_std"])}
        return [
            {"quantity": name, "value": value, "std": std} for name, (value, std) in found.items() if value is not None
        ]

    @property
    def budgets(self) -> list[dict[str, Any]]:
        """Rows of the table of budgets: the parts that add in squares to the deviation of an estimate."""
        return [
            {"quantity": f"{name}{suffix}", "source": source, "std": std}
            for name, one in self._constants.items()
            for suffix, key in (("", "budget"), ("_tan", "tan_budget"))
            for source, std in (one.get(key) or {}).items()
            if std is not None
        ]

    @property
    def causes(self) -> list[dict[str, Any]]:
        """Rows of the table of causes, the most probable first."""
        found = sorted((self.record or {}).get("causes", ()), key=lambda cause: -cause["probability"])
        names = ("effect", "specimen", "probability", "parameters")
        return [{"position": position, **{name: cause[name] for name in names}} for position, cause in enumerate(found)]

    @property
    def _constants(self) -> dict[str, dict[str, Any]]:
        """Constant → value, std, tan, tan_std and budgets, of the last fit."""
        parameters = (self.record or {}).get("parameters", {})
        return parameters.get("after", parameters)


def entry_of_job(job: Job, record: dict[str, Any]) -> Entry:
    """The entry of a job of a lot and its record, as `femu_piezo.batch.worker` returns it."""
    read = job.read()
    inputs = _inputs(read.specimens) or ((_unread(job.specimen), job.sweep and _measured(job.sweep)),)
    return Entry(
        step=job.step,
        name=job.name,
        status=record["status"],
        reason=record["reason"],
        inputs=inputs,
        columns=record["columns"],
        record=record["results"].get(job.step),
        program=program_checksum(),
    )


def entry_of_result(specimens: Sequence[Specimen], result: UpdateResult | Diagnosis) -> Entry:
    """The entry of a result of `update` or `diagnose`, for specimens whose sweeps are files."""
    if isinstance(result, UpdateResult):
        step, columns, record = "update", update_columns(result), update_record(result)
    else:
        from femu_piezo.output.diagnosis import diagnosis_record

        step, columns, record = "diagnose", diagnosis_columns(result), diagnosis_record(result)
    name = " + ".join(one.name for one in specimens)
    columns = {"specimen": name, **columns}
    return Entry(step, name, "ok", "", _inputs(specimens), columns, as_json(record), program_checksum())


def _inputs(specimens: Sequence[Specimen]) -> tuple[tuple[Described, Measured | None], ...]:
    found: list[tuple[Described, Measured | None]] = []
    for one in specimens:
        described = _described(one)
        files = [part.measurement.file for part in one.of_each_sweep if part.measurement and part.measurement.file]
        found += [(described, _measured(file)) for file in files] or [(described, None)]
    return tuple(found)


def _described(specimen: Specimen) -> Described:
    """A description without paths, so that it is the same on every station: no sweeps, other files by checksum."""
    data = specimen.model_dump(exclude_none=True, exclude={"path": True, "measurement": {"file"}})
    for sweep in data.get("sweep", ()):
        del sweep["file"]
    description = json.loads(json.dumps(data, default=lambda path: f"sha256 {file_checksum(path)}"))
    return Described(_sha256(description), specimen.name, description)


def _unread(specimen: Path) -> Described:
    return Described(file_checksum(specimen), specimen.name, None)


def _measured(file: Path) -> Measured:
    """Content, name and time of a sweep; of one that is missing the time at which it was looked for."""
    try:
        seconds = file.stat().st_mtime
    except OSError:
        seconds = time.time()
    return Measured(file_checksum(file), file.name, datetime.fromtimestamp(seconds, UTC).replace(tzinfo=None))


def _sha256(data: Any) -> str:
    return hashlib.sha256(json.dumps(data, sort_keys=True).encode()).hexdigest()
