"""The database with several writers, kills, other versions and bad addresses, for SQLite and PostgreSQL alike."""

from __future__ import annotations

import os
import re
import sqlite3
import subprocess
import sys
import threading
import time
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
from made import BUDGET, START, entry, write_in_turn
from sqlalchemy import func, select, text

from femu_piezo.errors import InputError
from femu_piezo.store import database as module
from femu_piezo.store import schema
from femu_piezo.store.database import Database
from femu_piezo.store.entry import _measured
from femu_piezo.store.read import read_pieces
from femu_piezo.store.write import write

FOLDER = Path(__file__).parent
ESTIMATES, PARTS = 3, len(BUDGET) + 1  # s11, s11_tan and k_eff; the parts of the deviations of two of them


def program(*arguments: str) -> subprocess.Popen:
    """Another process that writes (made.py)."""
    return subprocess.Popen([sys.executable, FOLDER / "made.py", *arguments], stdout=subprocess.PIPE, text=True)


def counted(address: str) -> dict[str, int]:
    """Numbers of rows of the tables."""
    database = Database(address, Path(), make=False)
    tables = schema.metadata.tables.values()
    found = database.read(
        lambda connection: {
            one.name: connection.execute(select(func.count()).select_from(one)).scalar() for one in tables
        }
    )
    database.close()
    return found


def whole(pieces: int) -> dict[str, int]:
    """Numbers of rows for so many pieces, each stored once and completely."""
    found = dict.fromkeys(schema.metadata.tables, 0)
    found |= {"lots": 1, "specimens": 1, "sweeps": pieces, "results": pieces, "inputs": pieces}
    return found | {"estimates": ESTIMATES * pieces, "budgets": PARTS * pieces}


def revised(address: str, statement: str) -> None:
    """Change a database directly, without the code under test."""
    database = Database(address, Path())
    database.write(lambda connection: connection.execute(text(statement)))
    database.close()


def test_two_writers_at_once(address):
    """Two processes create the tables and write overlapping sets of pieces at the same time."""
    writers = [program("write", address, "0", "60", "may"), program("write", address, "30", "90", "may")]
    assert [one.wait(60) for one in writers] == [0, 0]
    assert counted(address) == whole(90)


def test_a_kill_in_the_middle_of_a_write_leaves_nothing_and_locks_nothing(address):
    write_in_turn(address, [0], "killed")
    victim = program("stop", address)
    assert victim.stdout.readline() == "half\n"
    other = threading.Thread(target=write_in_turn, args=(address, [1], "killed"))
    other.start()  # waits for the lock of the hanging process, in PostgreSQL since it writes the same sweep
    time.sleep(0.3)
    assert counted(address) == whole(1)  # reading does not wait for the lock
    victim.kill()
    victim.wait()
    other.join(30)
    assert counted(address) == whole(2)
    write_in_turn(address, [1, 2], "killed")
    assert counted(address) == whole(3)


def test_the_same_result_is_kept_once_in_its_latest_lot(address):
    database = Database(address, Path())
    assert write(database, [entry(1), entry(2)], "may") == 2
    assert write(database, [entry(1), entry(2)]) == 0
    assert {row["lot"] for row in read_pieces(database)} == {"may"}
    assert write(database, [entry(1)], "june") == 0
    assert [row["lot"] for row in read_pieces(database)] == ["june", "may"]
    assert write(database, [entry(1, program="0.2.0+test", s11=17e-12)]) == 1
    first = read_pieces(database)[
        0
    ]  # the latest result of a piece, while that of the other version stays in the tables
    assert (first["s11"], first["program"], first["measured"].replace(tzinfo=None)) == (17e-12, "0.2.0+test", START)
    database.close()
    assert counted(address)["results"] == 3


def test_the_last_result_of_a_piece_is_that_of_the_last_command(address):
    """A density is changed in the specimen file and changed back: the result of the first file counts again."""
    database = Database(address, Path())
    for program in ("with the first file", "with another file", "with the first file"):
        write(database, [entry(1, program=program, s11=16e-12 if "first" in program else 17e-12)])
        (row,) = read_pieces(database)
        assert (row["program"], row["s11"]) == (program, 16e-12 if "first" in program else 17e-12)
    database.close()
    assert counted(address)["results"] == 2


def test_names_of_any_characters_are_kept(address):
    import dataclasses

    name = "plate '; DROP TABLE results; -- ñ 𝛼 \" \\"
    database = Database(address, Path())
    write(database, [dataclasses.replace(entry(1), name=name)], name)
    assert [(row["file"], row["lot"]) for row in read_pieces(database)] == [(name, name)]
    database.close()


def frozen(request, kind: str, tmp_path: Path) -> str:
    """A database of schema version 1 with two pieces, as stored in a file."""
    script = (FOLDER / f"version_1.{kind}.sql").read_text(encoding="utf-8")
    if kind == "sqlite":
        with sqlite3.connect(tmp_path / "old.sqlite") as connection:
            connection.executescript(script)
        connection.close()
        return str(tmp_path / "old.sqlite")
    import psycopg

    address = request.getfixturevalue("new_postgresql")()
    with psycopg.connect(address, autocommit=True) as connection:
        connection.execute(script)
    return address


@pytest.mark.parametrize("kind", ["sqlite", "postgresql"])
def test_an_old_schema_is_upgraded_with_its_results(request, tmp_path, kind):
    address = frozen(request, kind, tmp_path)
    database = Database(address, Path())
    rows = read_pieces(database)
    assert [(row["file"], row["s11"], row["lot"], row["station"]) for row in rows] == [
        ("p1.csv", 16.5e-12, "old", None),
        ("p2.csv", 16.5e-12, "old", None),
    ]
    assert write(database, [entry(1, program="0.1.0+old"), entry(3, program="0.1.0+old")], "new") == 1
    assert not differences(database)
    database.close()
    assert counted(address)["results"] == 3


def test_the_migrations_make_the_tables_of_the_schema(address):
    from alembic.script import ScriptDirectory

    folder = Path(module.__file__).parent / "migrations"
    assert ScriptDirectory(str(folder)).get_current_head() == schema.VERSION
    write_in_turn(address, [1], "may")
    database = Database(address, Path())
    assert not differences(database)
    database.close()


def differences(database: Database) -> list:
    """Changes that Alembic would make to turn the tables into those of the schema."""
    from alembic.autogenerate import compare_metadata
    from alembic.migration import MigrationContext

    options = {"version_table": schema.VERSION_TABLE, "compare_type": True}
    return database.read(
        lambda connection: compare_metadata(MigrationContext.configure(connection, opts=options), schema.metadata)
    )


def refusal(address: str, make: bool = True) -> str:
    """The error message for an address."""
    with pytest.raises(InputError) as caught:
        Database(address, Path(), make=make)
    return str(caught.value)


def test_a_newer_schema_is_refused(address):
    write_in_turn(address, [1], "may")
    revised(address, f"UPDATE {schema.VERSION_TABLE} SET version_num = '99'")
    said = refusal(address)
    assert "version 99" in said and "newer femu-piezo" in said and "\n" not in said


def test_a_database_of_another_program_is_left_alone(tmp_path, new_postgresql):
    import psycopg

    with sqlite3.connect(tmp_path / "other.sqlite") as connection:
        connection.execute("CREATE TABLE results (id INTEGER)")
    assert "tables of another program (results)" in refusal(str(tmp_path / "other.sqlite"))
    address = new_postgresql()
    with psycopg.connect(address) as connection:
        connection.execute("CREATE TABLE results (id INTEGER)")
    assert "tables of another program (results)" in refusal(address)


@pytest.mark.parametrize(
    ("address", "words"),
    [
        ("postgresql://me:secret@127.0.0.1:1/line", "Connection refused"),
        ("postgresql://me:secret@127.0.0.1:none/line", "no URL of a database"),
        ("mysql://me:secret@127.0.0.1/line", "SQLite files and PostgreSQL databases"),
        ("{tmp}/none/line.sqlite", "no such folder"),
        ("{tmp}/text.sqlite", "file is not a database"),
    ],
)
def test_a_bad_address_is_one_sentence_without_the_password(tmp_path, address, words):
    (tmp_path / "text.sqlite").write_text("no database at all, but long enough to be looked at" * 50, encoding="utf-8")
    said = refusal(address.format(tmp=tmp_path))
    assert words in said and "secret" not in said and "\n" not in said


def test_reading_makes_nothing(tmp_path, new_postgresql):
    assert "no such file" in refusal(str(tmp_path / "line.sqlite"), make=False)
    assert not list(tmp_path.iterdir())
    assert "no results of femu-piezo" in refusal(new_postgresql(), make=False)


def test_a_locked_file_is_tried_again_and_then_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(module, "_LOCK_S", 0.05)
    address = str(tmp_path / "line.sqlite")
    write_in_turn(address, [0], "may")
    holder = sqlite3.connect(address, isolation_level=None, check_same_thread=False)
    holder.execute("BEGIN IMMEDIATE")
    database = Database(address, Path())
    threading.Timer(0.5, holder.execute, ("ROLLBACK",)).start()
    assert write(database, [entry(1)], "may") == 1
    holder.execute("BEGIN IMMEDIATE")
    monkeypatch.setattr(module, "_PAUSES", (0.01,))
    with pytest.raises(InputError, match=r"cannot be written to \(database is locked\)"):
        write(database, [entry(2)], "may")
    holder.execute("ROLLBACK")
    holder.close()
    database.close()
    assert counted(address) == whole(2)


def test_a_server_that_comes_back_is_used_again(new_postgresql):
    """Connections of a long lot end when the server restarts; the next write opens a new one."""
    import psycopg

    address = new_postgresql()
    database = Database(address, Path())
    write(database, [entry(1)], "may")
    with psycopg.connect(address, autocommit=True) as connection:
        connection.execute("SELECT pg_terminate_backend(pid) FROM pg_stat_activity WHERE pid <> pg_backend_pid()")
    assert write(database, [entry(2)], "may") == 1
    database.close()
    assert counted(address) == whole(2)


def test_without_the_packages_one_sentence_says_what_to_install(tmp_path):
    code = (
        "import sys; sys.modules['sqlalchemy'] = None\n"
        "sys.argv[1:] = ['lots', '--store', 'line.sqlite']\n"
        "from femu_piezo.cli import main; main()"
    )
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    done = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, env=environment)
    assert done.returncode == 2
    assert re.fullmatch(r"femu-piezo: --store needs .*pip install 'femu-piezo\[store\]'\n", done.stderr)


def test_a_sweep_that_is_missing_has_the_time_at_which_it_was_looked_for(tmp_path):
    """Not that of 1970, which would stretch every chart over time."""
    found = _measured(tmp_path / "absent.csv")
    assert abs(datetime.now(UTC).replace(tzinfo=None) - found.time) < timedelta(minutes=1) and found.hash == "absent"
