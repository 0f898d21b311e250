"""The table of a lot: one row per job, as CSV and Parquet with the same columns."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping, Sequence
from datetime import datetime
from pathlib import Path

from femu_piezo.files import write_atomically
from femu_piezo.specimen.file import CONSTANTS

#: Columns that `update` fills, in the order of the table; a table has those of the constants that some job frees.
_PARTS = ("", "_std", "_tan", "_tan_std", "_std_from")
CONSTANT_COLUMNS = tuple(f"{name}{part}" for name in CONSTANTS for part in _PARTS)
UPDATE_COLUMNS = (
    *CONSTANT_COLUMNS,
    "pole_Hz",
    "pole_loss",
    "zero_Hz",
    "zero_loss",
    "k_eff",
    "rms_log_error",
    "iterations",
    "method",
    "doubt",
    "notes",
)
#: What stands between the sentences of the columns "doubt" and "notes".
NOTES_APART = " · "
#: Columns that `diagnose` fills: "size" is the first parameter of the most probable cause (SI), errors are
#: rms |Δ log Z| of data that no fit saw, "diagnosis" says all of it in words.
DIAGNOSIS_COLUMNS = (
    "verdict",
    "cause",
    "probability",
    "size",
    "size_std",
    "size_unit",
    "further_causes",
    "alike",
    "error_before",
    "error_after",
    "error_noise",
    "diagnosis",
)

_FIRST = ("number", "file", "specimen", "status", "reason")
_TEXT = {"file", "specimen", "status", "reason", "method", "doubt", "notes"}
_TEXT |= {"verdict", "cause", "size_unit", "further_causes", "alike", "diagnosis"}
_WHOLE = {"number", "iterations"}


def rows_of(records: Sequence[dict], diagnoses: Mapping[str, dict] | None = None) -> list[dict]:
    """Rows in the order of the records of the updates, numbered from 1.

    Parameters
    ----------
    diagnoses : name → record of a diagnosis; where one has no result the column "diagnosis" says why. None where no
        diagnosis was asked for: the rows then have no columns of it
    """
    rows = []
    for number, record in enumerate(records, 1):
        head = {"number": number, "file": record["name"], "status": record["status"], "reason": record["reason"]}
        rows.append({**record["columns"], **head})
        if diagnoses is not None:
            rows[-1] |= dict.fromkeys(DIAGNOSIS_COLUMNS) | _diagnosis(diagnoses.get(record["name"]))
    return rows


def _diagnosis(record: dict | None) -> dict:
    if record is None:
        return {}
    if record["status"] != "ok":
        return {"diagnosis": f"no diagnosis: {record['reason']}"}
    return {name: value for name, value in record["columns"].items() if name in DIAGNOSIS_COLUMNS}


def columns_of(rows: Sequence[dict]) -> list[str]:
    """The columns in their order; those of constants and of a diagnosis only where some row has them."""
    present = {name for row in rows for name in row}
    known = [*_FIRST, *(name for name in UPDATE_COLUMNS if name in present or name not in CONSTANT_COLUMNS)]
    return known + [name for name in DIAGNOSIS_COLUMNS if name in present]


def write_table(rows: Sequence[dict], csv_path: Path, parquet_path: Path) -> None:
    """Write both files, each whole or not at all; the same rows give the same bytes. Values in SI units."""
    columns = columns_of(rows)
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(columns)
    writer.writerows([_cell(row.get(name)) for name in columns] for row in rows)
    write_atomically(csv_path, text.getvalue())
    write_atomically(parquet_path, as_parquet(rows, columns))


def as_parquet(rows: Sequence[dict], columns: Sequence[str]) -> bytes:
    """The content of a Parquet file of some columns of the rows."""
    import pyarrow
    import pyarrow.parquet

    fields = [(name, _type(pyarrow, name, rows)) for name in columns]
    table = pyarrow.table(
        [pyarrow.array([row.get(name) for row in rows], kind) for name, kind in fields], names=columns
    )
    buffer = io.BytesIO()
    pyarrow.parquet.write_table(table, buffer)
    return buffer.getvalue()


def _cell(value) -> str:
    if value is None:
        return ""
    if isinstance(value, float):
        return repr(value)
    return " ".join(str(value).splitlines())


def _type(pyarrow, name: str, rows: Sequence[dict]):
    if name in _TEXT or any(isinstance(row.get(name), str) for row in rows):
        return pyarrow.string()
    if any(isinstance(row.get(name), datetime) for row in rows):
        return pyarrow.timestamp("us", tz="UTC")
    return pyarrow.int64() if name in _WHOLE else pyarrow.float64()
