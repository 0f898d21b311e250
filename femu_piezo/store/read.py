"""Reading of results from the database, as rows of the table of a lot."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import UTC, datetime
from typing import Any

from sqlalchemy import Connection, func, select

from femu_piezo.batch.table import DIAGNOSIS_COLUMNS, rows_of
from femu_piezo.store import schema
from femu_piezo.store.database import Database

#: Columns that a row has beside those of the table of a lot.
STORE_COLUMNS = ("lot", "measured", "written", "station", "program", "sweep")
#: Name that pieces without a lot are listed under.
NO_LOT = "no lot"


def read_pieces(database: Database, lots: Sequence[str] = ()) -> list[dict[str, Any]]:
    """One row for each piece: its last update, and the columns of its last diagnosis, in the order of measurement.

    Columns are `STORE_COLUMNS` and those of the table of a lot; times are UTC, `sweep` is the SHA-256 of the file.

    Parameters
    ----------
    lots : names of the lots wanted; all where there are none
    """
    steps = ("update", "diagnose")
    updates, diagnoses = database.read(lambda connection: [_last(connection, step, lots) for step in steps])
    found = diagnoses | updates
    for piece in updates.keys() & diagnoses.keys():  # the lot of the update, or else of the diagnosis
        found[piece]["lot"] = updates[piece]["lot"] or diagnoses[piece]["lot"]
    wanted = [piece for piece, row in found.items() if not lots or row["lot"] in lots]
    wanted.sort(key=lambda piece: (found[piece]["measured"], found[piece]["name"]))
    rows = rows_of([found[piece] for piece in wanted])
    for piece, row in zip(wanted, rows, strict=True):
        row |= {name: found[piece][name] for name in STORE_COLUMNS}
        row["lot"] = row["lot"] or NO_LOT
        if piece in diagnoses:
            row |= {name: diagnoses[piece]["columns"].get(name) for name in DIAGNOSIS_COLUMNS}
    return rows


def _last(connection: Connection, step: str, lots: Sequence[str]) -> dict[str, dict[str, Any]]:
    """Piece → its last result of a step: a record as `rows_of` takes it, and the columns of the store.

    lots : only of pieces that have a result in one of these; of all where there are none
    """
    results, inputs, sweeps = schema.results, schema.inputs, schema.sweeps
    place = func.row_number().over(
        partition_by=results.c.piece, order_by=(results.c.written.desc(), results.c.id.desc())
    )
    ordered = select(results.c.id, place.label("place")).where(results.c.step == step)
    if lots:
        named = select(results.c.piece).join(schema.lots).where(schema.lots.c.name.in_(lots))
        ordered = ordered.where(results.c.piece.in_(named))
    every = ordered.subquery()
    last = select(every.c.id).where(every.c.place == 1)
    names = ("piece", "name", "status", "reason", "columns", "written", "station", "program")
    query = (
        select(
            *(results.c[name] for name in names),
            schema.lots.c.name.label("lot"),
            sweeps.c.measured,
            sweeps.c.hash.label("sweep"),
        )
        .join_from(results, inputs, (inputs.c.result_id == results.c.id) & (inputs.c.position == 0))
        .outerjoin(schema.lots, schema.lots.c.id == results.c.lot_id)
        .outerjoin(sweeps, sweeps.c.id == inputs.c.sweep_id)
        .where(results.c.id.in_(last))
    )
    found = {}
    for row in connection.execute(query).mappings():
        measured = row["measured"] or row["written"]
        times = {"measured": _utc(measured), "written": _utc(row["written"])}
        found[row["piece"]] = dict(row) | times
    return found


def _utc(time: datetime) -> datetime:
    return time.replace(tzinfo=UTC)
