"""Writing of results into the database: each once, whole, in the lot that was named last."""

from __future__ import annotations

import socket
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sqlalchemy import Connection, Table, insert, select, update
from sqlalchemy.dialects import postgresql, sqlite

from femu_piezo.batch.jobs import Job
from femu_piezo.batch.worker import FINAL
from femu_piezo.errors import InputError
from femu_piezo.specimen.file import Specimen
from femu_piezo.store import schema
from femu_piezo.store.database import Database
from femu_piezo.store.entry import KEY, Entry, entry_of_job, entry_of_result

if TYPE_CHECKING:
    from femu_piezo.study.diagnose import Diagnosis
    from femu_piezo.study.results import UpdateResult

#: Results of a lot are written after so many seconds, or once so many wait.
_EVERY_S, _MOST = 2.0, 200


def write(database: Database, entries: Sequence[Entry], lot: str | None = None) -> int:
    """Write results in one transaction; the number of new ones.

    A result of the same sweeps, descriptions, step and program as one in the database is not written again, but is the
    last one of its piece from now on.

    Parameters
    ----------
    lot : name of the lot that all of them belong to; where None, results in the database stay in their lots

    Raises
    ------
    InputError : the database does not take them; then none is written
    """
    return database.write(partial(_write, entries=entries, lot=lot))


def keeper(
    store: str, out: Path, lot: str | None = None
) -> Callable[[Sequence[Specimen], UpdateResult | Diagnosis], None]:
    """The function that keeps results of `update`, `diagnose` or `measure`: keep(specimens, result).

    Call `keeper` before the work, so that a wrong address is reported at once, the function after saving the results.

    Parameters
    ----------
    store : address of the database, see `Database`
    out : folder of the results, which holds the database where the address is "sqlite"
    lot : that the specimens belong to

    Raises
    ------
    InputError : the database does not answer or cannot serve, now or when the function is called
    """
    database = Database(store, out)

    def keep(specimens: Sequence[Specimen], result: UpdateResult | Diagnosis) -> None:
        try:
            write(database, [entry_of_result(specimens, result)], lot)
        except InputError as error:
            raise InputError(f"{error}; the results are in {out}") from None
        finally:
            database.close()

    return keep


@contextmanager
def lot_keeper(store: str, out: Path, lot: str) -> Iterator[Callable[[Job, dict[str, Any]], None]]:
    """The function that keeps each finished job of a lot with its record.

    A store that fails meanwhile does not stop the lot, whose results are files in `out`.

    Raises
    ------
    InputError : the store does not answer or cannot serve, or, at the end, did not take everything
    """
    kept = _LotKeeper(Database(store, out), lot)
    try:
        yield kept.take
    finally:
        kept.close()
    if kept.error is not None:
        raise InputError(
            f"{kept.error}; all results are in {out}, {kept.missing} of them not in the store: run the same command "
            "again once the store can be reached"
        )


class _LotKeeper:
    """Writes several results at a time; after an error it only counts those that are missing."""

    def __init__(self, database: Database, lot: str) -> None:
        self._database, self._lot = database, lot
        self._waiting: list[Entry] = []
        self._written = time.monotonic()
        self.error: InputError | None = None
        self.missing = 0

    def take(self, job: Job, record: dict[str, Any]) -> None:
        """Keep the record of a job, unless its status is "lost", which is no result."""
        if record["status"] not in FINAL:
            return
        if self.error is not None:
            self.missing += 1
            return
        self._waiting.append(entry_of_job(job, record))
        if len(self._waiting) >= _MOST or time.monotonic() - self._written > _EVERY_S:
            self._flush()

    def close(self) -> None:
        """Write the results that wait, and close the database."""
        if self._waiting:
            self._flush()
        self._database.close()

    def _flush(self) -> None:
        try:
            write(self._database, self._waiting, self._lot)
        except InputError as error:
            self.error, self.missing = error, len(self._waiting)
        self._waiting, self._written = [], time.monotonic()


def _write(connection: Connection, entries: Sequence[Entry], lot: str | None) -> int:
    lots = {} if lot is None else _ids(connection, schema.lots, "name", [{"name": lot}])
    pairs = [pair for entry in entries for pair in entry.inputs]
    specimens = _ids(connection, schema.specimens, "hash", [vars(described) for described, _ in pairs])
    sweeps = _ids(
        connection,
        schema.sweeps,
        "hash",
        [{"hash": one.hash, "file": one.file, "measured": one.time} for _, one in pairs if one is not None],
    )
    known, new = _known(connection, entries), 0
    for entry in sorted(entries, key=lambda one: one.key):  # one order of locks for all, or two writers may deadlock
        result = None if entry.key in known else _new_result(connection, entry, lots.get(lot))
        if result is None:
            _made_last(connection, entry, lots.get(lot))
            continue
        new += 1
        inputs = [
            {"position": position, "specimen_id": specimens[one.hash], "sweep_id": sweep and sweeps[sweep.hash]}
            for position, (one, sweep) in enumerate(entry.inputs)
        ]
        verdicts = [{"verdict": entry.columns["verdict"]}] if entry.columns.get("verdict") else []
        for table, rows in (
            (schema.inputs, inputs),
            (schema.estimates, entry.estimates),
            (schema.budgets, entry.budgets),
            (schema.diagnoses, verdicts),
            (schema.causes, entry.causes),
        ):
            if rows:
                connection.execute(insert(table), [{"result_id": result, **row} for row in rows])
    return new


def _known(connection: Connection, entries: Sequence[Entry]) -> set[tuple[str, ...]]:
    """Keys of the results of these pieces in the database."""
    columns = [schema.results.c[name] for name in KEY]
    wanted = schema.results.c.piece.in_({entry.piece for entry in entries})
    return set(map(tuple, connection.execute(select(*columns).where(wanted))))


def _new_result(connection: Connection, entry: Entry, lot_id: int | None) -> int | None:
    """The id of the new row; None where another station has written the result meanwhile."""
    row = dict(zip(KEY, entry.key, strict=True)) | {
        "lot_id": lot_id,
        "name": entry.name,
        "status": entry.status,
        "reason": entry.reason,
        "written": _now(),
        "station": socket.gethostname(),
        "columns": entry.columns,
        "record": entry.record,
    }
    table = schema.results
    return connection.execute(_insert_once(connection, table).values(row).returning(table.c.id)).scalar()


def _made_last(connection: Connection, entry: Entry, lot_id: int | None) -> None:
    """Make a result of the database the last one of its piece again, in the lot, where one is named."""
    table = schema.results
    same = [table.c[name] == value for name, value in zip(KEY, entry.key, strict=True)]
    lot = {} if lot_id is None else {"lot_id": lot_id}
    connection.execute(update(table).where(*same).values(written=_now(), **lot))


def _now() -> datetime:
    """The time, UTC without a zone."""
    return datetime.now(UTC).replace(tzinfo=None)


def _ids(connection: Connection, table: Table, key: str, rows: Sequence[dict[str, Any]]) -> dict[str, int]:
    """Key → id of its row; missing rows are inserted."""
    rows = [row for _, row in sorted({row[key]: row for row in rows}.items())]
    if not rows:
        return {}
    column = table.c[key]
    known = select(column, table.c.id).where(column.in_([row[key] for row in rows]))
    found = dict(map(tuple, connection.execute(known)))
    missing = [row for row in rows if row[key] not in found]
    if missing:
        connection.execute(_insert_once(connection, table), missing)
        found = dict(map(tuple, connection.execute(known)))
    return found


def _insert_once(connection: Connection, table: Table):
    """An INSERT that skips rows that exist already."""
    dialect = postgresql if connection.dialect.name == "postgresql" else sqlite
    return dialect.insert(table).on_conflict_do_nothing()
