"""The database behind `--store`: opened, brought to this schema, and written to by several stations at once.

SQLite keeps a write-ahead log, so that readers and one writer do not wait for each other, and writers queue for the
lock. In PostgreSQL a transaction sees the rows of another one after its commit. A transaction that fails in a conflict
is tried again; one that is not committed leaves no rows.
"""

from __future__ import annotations

import re
import sqlite3
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TypeVar

from sqlalchemy import Connection, Engine, create_engine, event, inspect, text
from sqlalchemy.engine import URL, make_url
from sqlalchemy.exc import ArgumentError, OperationalError, SQLAlchemyError

from femu_piezo.errors import InputError
from femu_piezo.store.address import FILE, HERE
from femu_piezo.store.schema import VERSION, VERSION_TABLE

#: Seconds that a writer waits for another one's lock, and for the answer of a server.
_LOCK_S, _CONNECT_S = 30, 10
#: Seconds between attempts of a transaction that met a lock, a deadlock or a lost connection.
_PAUSES = (0.1, 0.5, 2.0)
#: Key of the lock under which tables of a PostgreSQL database are made or upgraded; an arbitrary number.
_UPGRADE_LOCK = 0x66656D75

Found = TypeVar("Found")


class Database:
    """An open store.

    Parameters
    ----------
    address : URL such as postgresql://user@host/name, path of an SQLite file, a folder that holds one, or "sqlite" for
        that in `folder`
    make : whether to make a store that is not there, as a writer does

    Raises
    ------
    InputError : the address is wrong, the database does not answer, or its tables are of a newer program or another one
    """

    def __init__(self, address: str, folder: Path, *, make: bool = True) -> None:
        url = _url(address, folder)
        file = Path(url.database) if url.drivername == "sqlite" else None
        self.shown = file or url.set(drivername="postgresql").render_as_string()
        if file and not (file.parent if make else file).exists():
            raise InputError(
                f"--store {self.shown}: there is no such {'folder' if make else 'file'}; give the URL of a database, "
                "an SQLite file, or the folder that holds store.sqlite"
            )
        try:
            self._engine = _engine(url)
        except ImportError:
            raise InputError(
                f"--store {self.shown}: the driver of PostgreSQL is not installed; pip install 'femu-piezo[store]'"
            ) from None
        self._ready = False
        if file is None or file.exists():  # a file that is not there yet is made with its first result
            try:
                with self.sentence("cannot be opened"):
                    self._prepare(make)
            except BaseException:
                self.close()
                raise

    @contextmanager
    def sentence(self, what: str) -> Iterator[None]:
        """Raise errors of the database as InputError with one sentence: that the store `what`, and why."""
        try:
            yield
        except (SQLAlchemyError, UnicodeError) as error:
            cause = getattr(error, "orig", None) or error
            reason = " ".join(str(cause).split()) or type(cause).__name__
            raise InputError(f"--store {self.shown}: the store {what} ({reason[:300]})") from None

    def read(self, work: Callable[[Connection], Found]) -> Found:
        """The result of `work` in one transaction, which sees one state of the database."""
        with self.sentence("cannot be read"), self._engine.begin() as connection:
            return work(connection)

    def write(self, work: Callable[[Connection], Found]) -> Found:
        """Do `work` in a transaction, all of it or nothing, again after a conflict with another station; its result."""
        with self.sentence("cannot be written to"):
            if not self._ready:
                self._prepare(make=True)
            return self._with_retries(work)

    def _with_retries(self, work: Callable[[Connection], Found]) -> Found:
        """Do `work`, again after a pause where it fails with OperationalError; the last attempt raises it."""
        for pause in _PAUSES:
            try:
                return self._transaction(work)
            except OperationalError:
                time.sleep(pause)
        return self._transaction(work)

    def _transaction(self, work: Callable[[Connection], Found]) -> Found:
        with self._engine.execution_options(writes=True).begin() as connection:
            return work(connection)

    def close(self) -> None:
        """Close the connections."""
        self._engine.dispose()

    def _prepare(self, make: bool) -> None:
        with self._engine.begin() as connection:  # no retries: an address that does not answer is reported at once
            version = _version(connection)
        if version == VERSION:
            self._ready = True
            return
        if version is None and not make:
            raise InputError(f"--store {self.shown}: this database holds no results of femu-piezo; check the address")
        if version is not None and not (version.isdecimal() and int(version) < int(VERSION)):
            raise InputError(
                f"--store {self.shown}: its tables are of version {version}, made by a newer femu-piezo; this one "
                f"reads version {VERSION}; install the newer one here as well"
            )
        self._with_retries(self._upgrade)
        self._ready = True

    def _upgrade(self, connection: Connection) -> None:
        """Make the tables, or bring them to this version, in the transaction of the connection."""
        if connection.dialect.name == "postgresql":
            connection.execute(text("SELECT pg_advisory_xact_lock(:key)"), {"key": _UPGRADE_LOCK})
        if _version(connection) is None and (found := inspect(connection).get_table_names()):
            raise InputError(
                f"--store {self.shown}: this database holds tables of another program "
                f"({', '.join(sorted(found)[:3])}); give an empty one"
            )
        from alembic import command
        from alembic.config import Config

        settings = Config(attributes={"connection": connection})
        settings.set_main_option("script_location", str(Path(__file__).parent / "migrations").replace("%", "%%"))
        command.upgrade(settings, VERSION)


def _version(connection: Connection) -> str | None:
    """The version of the tables; None where femu_piezo has made none."""
    if not inspect(connection).has_table(VERSION_TABLE):
        return None
    return connection.execute(text(f"SELECT version_num FROM {VERSION_TABLE}")).scalar()


def _url(address: str, folder: Path) -> URL:
    """The URL of an address; those of PostgreSQL with the driver that the package brings."""
    if "://" not in address:
        path = folder / FILE if address == HERE else Path(address)
        return URL.create("sqlite", database=str((path / FILE if path.is_dir() else path).absolute()))
    try:
        url = make_url(address)
    except (ArgumentError, ValueError):
        without_password = re.sub(r"://.*@", "://…@", address)
        raise InputError(
            f"--store {without_password}: this is no URL of a database; give one such as postgresql://user@host/name"
        ) from None
    kind = url.drivername.split("+")[0]
    if kind == "sqlite" and url.database:
        return url.set(drivername="sqlite")
    if kind in ("postgresql", "postgres"):
        return url.set(drivername="postgresql+psycopg")
    raise InputError(
        f"--store {url.render_as_string(hide_password=True)}: stores are SQLite files and PostgreSQL databases; give "
        "sqlite:///path or postgresql://user@host/name"
    )


def _engine(url: URL) -> Engine:
    if url.drivername != "sqlite":
        settings = {"connect_timeout": _CONNECT_S, "options": f"-c statement_timeout={_LOCK_S}s"}
        return create_engine(url, pool_pre_ping=True, connect_args=settings)
    engine = create_engine(url, connect_args={"timeout": _LOCK_S})

    @event.listens_for(engine, "connect")
    def begin_ourselves(connection, _) -> None:
        connection.isolation_level = None
        connection.execute("PRAGMA foreign_keys = ON")
        with suppress(sqlite3.OperationalError):  # a file that cannot be written to; readers do without
            connection.execute("PRAGMA journal_mode = WAL")

    @event.listens_for(engine, "begin")
    def begin(connection: Connection) -> None:
        writes = connection.get_execution_options().get("writes", False)
        connection.exec_driver_sql("BEGIN IMMEDIATE" if writes else "BEGIN")

    return engine
