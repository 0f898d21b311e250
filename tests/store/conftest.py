"""Databases for the tests: SQLite files, and a PostgreSQL server on the loopback address."""

from __future__ import annotations

import itertools
import os
import shutil
import socket
import subprocess
import tempfile
from pathlib import Path

import pytest

_numbers = itertools.count()


def _program(name: str) -> str | None:
    """Path of a program of PostgreSQL's server, which Debian keeps outside of PATH."""
    debian = sorted(Path("/usr/lib/postgresql").glob(f"*/bin/{name}"))
    return shutil.which(name) or (str(debian[-1]) if debian else None)


@pytest.fixture(scope="session")
def postgresql():
    """URL of a running server; it runs as nobody if the tests run as root, which it refuses."""
    if _program("initdb") is None:
        pytest.skip("PostgreSQL's server is not installed; apt-get install postgresql")
    user = "nobody" if os.geteuid() == 0 else None
    folder = Path(tempfile.mkdtemp(prefix="femu_piezo_"))
    if user is not None:
        shutil.chown(folder, user)
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]

    def run(name: str, *arguments: str) -> None:
        order = [_program(name), "-D", str(folder / "data"), *arguments]
        done = subprocess.run(order, user=user, cwd=folder, stdin=subprocess.DEVNULL, capture_output=True, text=True)
        assert done.returncode == 0, done.stderr

    try:
        run("initdb", "-U", "line", "--auth=trust", "--no-sync", "--locale=C", "--encoding=UTF8")
        options = f"-h 127.0.0.1 -p {port} -k {folder} -c fsync=off"
        run("pg_ctl", "-w", "-s", "-l", str(folder / "log"), "-o", options, "start")
        yield f"postgresql://line@127.0.0.1:{port}"
        run("pg_ctl", "-w", "-s", "-m", "immediate", "stop")
    finally:
        shutil.rmtree(folder)


@pytest.fixture
def new_postgresql(request):
    """A function that makes an empty database of the server and gives its URL."""

    def make() -> str:
        import psycopg

        server, name = request.getfixturevalue("postgresql"), f"test{next(_numbers)}"
        with psycopg.connect(f"{server}/postgres", autocommit=True) as connection:
            connection.execute(f"CREATE DATABASE {name}")
        return f"{server}/{name}"

    return make


@pytest.fixture(params=["sqlite", "postgresql"])
def address(request, tmp_path, new_postgresql) -> str:
    """An address at which there is no store yet."""
    return str(tmp_path / "line.sqlite") if request.param == "sqlite" else new_postgresql()
