"""A simulated analyser as a process of its own, and a small specimen for it."""

from __future__ import annotations

import os
import re
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import pytest

PLATE = """
name = "plate 07"
[geometry]
shape = "plate"
length = "12 mm"
width = "3 mm"
thickness = "1 mm"
density = "7500 kg/m^3"
poling = "thickness"
[material]
base = "pzt-5h"
tan_s11 = 0.016
tan_d31 = 0.013
tan_eps33T = 0.02
free = ["s11", "d31", "eps33T"]
[limits]
voltage = "0.6 V"
frequency = ["1 kHz", "180 kHz"]
[simulation]
start = "60 kHz"
stop = "180 kHz"
[effects.series_resistance]
resistance = "1.5 ohm"
"""


@dataclass
class Running:
    """A running simulated analyser: its port, and the log of all commands that it received."""

    port: int
    log: Path

    @property
    def address(self) -> str:
        return f"TCPIP::127.0.0.1::{self.port}::SOCKET"

    def commands(self) -> list[str]:
        return self.log.read_text(encoding="utf-8").splitlines() if self.log.exists() else []

    def last(self, pattern: str) -> str:
        """The argument of the last command that matches."""
        return [match[1] for line in self.commands() if (match := re.fullmatch(pattern, line))][-1]

    def is_off(self) -> bool:
        """Whether, by the last command of each, bias and trigger are off and the level is the lowest."""
        return (
            self.last(r":SOUR:BIAS:STAT (\w+)") == "OFF"
            and self.last(r":INIT1:CONT (\w+)") == "OFF"
            and float(self.last(r":SOUR1:VOLT ([\d.e-]+)")) == 0.005
        )

    def largest_voltage(self) -> float:
        """Highest level that was ever set, V."""
        asked = (line.split()[1] for line in self.commands() if re.fullmatch(r":SOUR1:VOLT [\d.e-]+", line))
        return max(map(float, asked), default=0.0)

    def raw(self, data: bytes, reads: int = 0) -> bytes:
        """The answers to bytes that no VISA library would send."""
        with socket.create_connection(("127.0.0.1", self.port), timeout=5) as one:
            one.sendall(data)
            found = b""
            while found.count(b"\n") < reads:
                found += one.recv(4096)
            return found


@contextmanager
def analyser(specimen: Path, *options: str) -> Iterator[Running]:
    """`femu-piezo analyser` in a process of its own on a free port."""
    log = specimen.with_name(f"commands{len(list(specimen.parent.iterdir()))}.log")
    process = subprocess.Popen(
        [sys.executable, "-m", "femu_piezo.cli", "analyser", str(specimen), "--port", "0", "--log", str(log), *options],
        stdout=subprocess.PIPE,
        text=True,
        env={**os.environ, "OMP_NUM_THREADS": "1"},
    )
    try:
        line = process.stdout.readline()
        yield Running(int(re.search(r"::(\d+)::SOCKET", line)[1]), log)
    finally:
        process.terminate()  # SIGTERM, since processes started in the background by a shell ignore SIGINT
        process.wait()
        process.stdout.close()


@pytest.fixture(scope="session")
def plate(tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("analyser") / "plate.toml"
    path.write_text(PLATE, encoding="utf-8")
    return path


@pytest.fixture(scope="session")
def bench(plate) -> Iterator[Running]:
    with analyser(plate) as running:
        yield running
