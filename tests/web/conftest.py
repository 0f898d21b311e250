"""A server of the page in a process of its own, on a free port and with its own folder."""

from __future__ import annotations

import os
import re
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

TUTORIALS = Path(__file__).parents[2] / "tutorials"


class Server:
    """`femu-piezo serve` in a process of its own."""

    def __init__(self, folder: Path, *options: str) -> None:
        with socket.socket() as probe:
            probe.bind(("127.0.0.1", 0))
            self.port = probe.getsockname()[1]
        order = [sys.executable, "-m", "femu_piezo.cli", "serve", str(folder), "--port", str(self.port), *options]
        self.folder, settings = folder, {**os.environ, "OMP_NUM_THREADS": "1"}
        self.process = subprocess.Popen(
            order, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, env=settings
        )
        self.said = self.process.stdout.readline()
        found = re.search(r"http://\S+", self.said)
        assert found, self.said + self.process.stdout.read()
        self.address = found[0]
        self.base = f"http://127.0.0.1:{self.port}"
        self._wait()

    def _wait(self) -> None:
        for _ in range(400):
            time.sleep(0.05)
            with socket.socket() as probe:
                probe.settimeout(0.2)
                if probe.connect_ex(("127.0.0.1", self.port)) == 0:
                    return
        self.process.kill()
        raise AssertionError("the server does not answer")

    def stop(self) -> str:
        """End the server as Ctrl-C does, and return what it printed."""
        self.process.send_signal(signal.SIGINT)
        try:
            return self.said + self.process.communicate(timeout=20)[0]
        except subprocess.TimeoutExpired:
            self.process.kill()
            return self.said + self.process.communicate()[0]


@pytest.fixture
def serve(tmp_path: Path) -> Iterator[Callable[..., Server]]:
    """Starts servers, and ends them after the test."""
    pytest.importorskip("nicegui", reason="the page needs nicegui: pip install 'femu-piezo[web]'")
    running: list[Server] = []

    def start(*options: str, folder: Path = tmp_path) -> Server:
        running.append(Server(folder, *options))
        return running[-1]

    yield start
    for server in running:
        if server.process.poll() is None:
            server.stop()
