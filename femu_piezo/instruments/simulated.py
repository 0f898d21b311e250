"""A simulated analyser: it answers on a socket of this machine as an E4990A or a 4294A does (`femu-piezo analyser`).

It knows the commands of the driver's table and no others; an unknown one goes into the error queue. It can fail as real
ones do, at the sweep that `Fault` names:

    timeout     the sweep never ends                    half        the reply breaks off
    error       an error is in the queue                overload    some values are marked as not measured
    unplugged   the connection breaks in mid-sweep
"""

from __future__ import annotations

import re
import socketserver
import threading
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import ClassVar

import numpy as np

from femu_piezo.errors import InputError
from femu_piezo.instruments.analyser import Analyser
from femu_piezo.instruments.e4990a import E4990A
from femu_piezo.instruments.hp4294a import HP4294A
from femu_piezo.instruments.piece import Piece
from femu_piezo.measurement.segments import Segment
from femu_piezo.specimen.file import Specimen

#: Kinds of faults.
FAULTS = ("timeout", "half", "error", "overload", "unplugged")
#: Longest line that is read, bytes; most errors in the queue; seconds after which a silent client is disconnected.
_LONGEST, _QUEUE, _PATIENCE = 1_000_000, 100, 3600.0
_NOT_MEASURED = "1.#QNB"


@dataclass(frozen=True)
class Fault:
    """A kind of `FAULTS`, and the number of the sweep at which it occurs; the first is 1."""

    kind: str
    sweep: int

    @classmethod
    def parse(cls, text: str) -> Fault:
        """The fault of a text "KIND@N"; InputError for anything else."""
        kind, _, number = text.partition("@")
        if kind not in FAULTS or not number.isdigit() or not 1 <= int(number) <= 10**6:
            raise InputError(
                f"--fail {text!r} is no fault; give one of {', '.join(FAULTS)} and a sweep, such as error@3"
            )
        return cls(kind, int(number))


class _Broken(Exception):
    """The connection is to break now."""


@dataclass
class Bench:
    """The state of an analyser, and what it measures.

    Attributes
    ----------
    level, bias : V;  biased, armed : whether the bias is on, and whether a trigger starts a sweep
    segments : those of the next sweep
    frequency, values : (n,) Hz and complex (n,) ohm of the last sweep
    queue : errors, the oldest first
    """

    piece: Piece
    faults: tuple[Fault, ...] = ()
    level: float = 5e-3
    bias: float = 0.0
    biased: bool = False
    armed: bool = False
    rising: bool = True
    speed: int = 5
    averages: int = 1
    averaged: bool = False
    trace: int = 0
    sweeps: int = 0
    segments: list[Segment] = field(default_factory=list)
    frequency: np.ndarray = field(default_factory=lambda: np.zeros(0))
    values: np.ndarray = field(default_factory=lambda: np.zeros(0, dtype=complex))
    queue: deque[str] = field(default_factory=lambda: deque(maxlen=_QUEUE))

    @property
    def fault(self) -> str:
        """Kind of the fault at the last sweep, "" where there is none."""
        return next((one.kind for one in self.faults if one.sweep == self.sweeps), "")

    def trigger(self) -> None:
        """Measure the segments once."""
        if not self.armed or not self.segments:
            self.queue.append('-211,"Trigger ignored"')
            return
        self.sweeps += 1
        rising = np.unique(np.concatenate([one.frequency for one in self.segments]))
        order = np.arange(rising.size) if self.rising else np.arange(rising.size)[::-1]
        measured = self.piece.measured(rising[order], self.level, self.speed, self.averages if self.averaged else 1)
        self.frequency, self.values = rising, measured[np.argsort(order)]
        if self.fault == "error":
            self.queue.append('-222,"Data out of range"')
        if self.fault == "unplugged":
            raise _Broken

    def error(self) -> str:
        """Take the oldest error out of the queue."""
        return self.queue.popleft() if self.queue else '+0,"No error"'

    def wait(self) -> str | None:
        """The reply "1", as the sweep is done; None, no reply, at the fault "timeout" until the sweep is broken off."""
        return None if self.fault == "timeout" and self.armed else "1"

    def trace_values(self) -> str:
        """R or X of the last sweep, each value followed by a zero."""
        parts = self.values.imag if self.trace else self.values.real
        words = [f"{one:.11E},0.00000000000E+00" for one in parts]
        if self.fault == "overload":
            words[len(words) // 2 :] = [f"{_NOT_MEASURED},0"] * (len(words) - len(words) // 2)
        text = ",".join(words)
        if self.fault == "half":
            raise _Half(text[: len(text) // 2])
        return text

    def frequencies(self) -> str:
        """Frequencies of the last sweep."""
        return ",".join(f"{one:.11E}" for one in self.frequency)

    def limited(self, attribute: str, low: float, high: float) -> Callable[[str], None]:
        """A handler that sets a number, clipped to a range; outside the range it also queues an error."""

        def put(argument: str) -> None:
            value = float(argument.rstrip("Vv "))
            if not low <= value <= high:
                self.queue.append('-222,"Data out of range"')
            setattr(self, attribute, type(getattr(self, attribute))(min(max(value, low), high)))

        return put

    def switched(self, attribute: str, words: dict[str, bool] | None = None) -> Callable[[str], None]:
        """A handler that sets a switch; words : argument → state."""
        known = words or {"ON": True, "1": True, "OFF": False, "0": False}

        def put(argument: str) -> None:
            setattr(self, attribute, known[argument.strip().upper()])

        return put


class _Half(Exception):
    """A reply that breaks off."""


#: Name in the table of a driver → function of the argument of the command that returns the reply.
Handlers = dict[str, Callable[[str], str | None]]


def _common(bench: Bench, driver: type[Analyser]) -> Handlers:
    """Handlers of the commands that both dialects have."""

    def stop(_: str) -> None:
        bench.armed = False

    def nothing(_: str) -> None:
        """For settings that the simulation has at all times."""

    def cleared(_: str) -> None:
        bench.queue.clear()

    def chosen(argument: str) -> None:
        bench.trace = [str(one) for one in driver.traces].index(argument.strip())

    return {
        **dict.fromkeys((*driver.setup, "mode", "bias_mode"), nothing),
        **dict.fromkeys(("open", "short"), lambda _: "1"),
        "load": lambda _: "0",
        "identify": lambda _: f"femu-piezo,{driver.model},simulated,1.0",
        "clear": cleared,
        "wait": lambda _: bench.wait(),
        "error": lambda _: bench.error(),
        "abort": nothing,
        "hold": stop,
        "trigger": lambda _: bench.trigger(),
        "select": chosen,
        "values": lambda _: bench.trace_values(),
        "frequencies": lambda _: bench.frequencies(),
        "level": bench.limited("level", *driver.voltages),
        "level_is": lambda _: f"{bench.level:.6E}",
        "bias": bench.switched("biased"),
        "bias_level": bench.limited("bias", -driver.most_bias, driver.most_bias),
        "speed": bench.limited("speed", 1, 5),
        "averages": bench.limited("averages", 1, 999),
        "averaging": bench.switched("averaged"),
        "direction": bench.switched("rising", {"UP": True, "DOWN": False}),
    }


def _as_e4990a(bench: Bench) -> Handlers:
    def table(argument: str) -> None:
        numbers = [float(word) for word in argument.split(",")]
        rows = np.reshape(numbers[9:], (-1, 3))
        if numbers[:8] != [7, 0, 0, 0, 0, 0, 0, 0] or len(rows) != numbers[8]:
            raise ValueError
        _set_segments(bench, [Segment(low, high, int(points)) for low, high, points in rows], E4990A)

    return _common(bench, E4990A) | {"initiate": bench.switched("armed"), "segments": table}


def _as_4294a(bench: Bench) -> Handlers:
    edited: list[dict[str, float]] = []

    def put(key: str) -> Callable[[str], None]:
        def own(argument: str) -> None:
            edited[-1][key] = float(argument)

        return own

    def done(_: str) -> None:
        found = [Segment(one["start"], one["stop"], int(one["points"])) for one in edited]
        _set_segments(bench, found, HP4294A)

    def trigger(_: str) -> None:
        bench.armed = True
        bench.trigger()

    return _common(bench, HP4294A) | {
        "edit": lambda _: None,
        "empty": lambda _: edited.clear(),
        "add": lambda _: edited.append({}),
        "start": put("start"),
        "stop": put("stop"),
        "points": put("points"),
        "added": lambda _: None,
        "edited": done,
        "listed": lambda _: None,
        "trigger": trigger,
    }


def _set_segments(bench: Bench, listed: list[Segment], driver: type[Analyser]) -> None:
    low, high = driver.band_Hz
    points = sum(one.points for one in listed)
    if (
        len(listed) > driver.most_segments
        or points > driver.most_points
        or any(not (low <= one.start <= one.stop <= high and one.points >= 2) for one in listed)
    ):
        bench.queue.append('-222,"Data out of range"')
        return
    bench.segments = listed


#: Model → its driver, and the function that makes its handlers.
DIALECTS: dict[str, tuple[type[Analyser], Callable[[Bench], Handlers]]] = {
    "E4990A": (E4990A, _as_e4990a),
    "4294A": (HP4294A, _as_4294a),
}


class SimulatedAnalyser:
    """Reads lines and answers them.

    Parameters
    ----------
    model : "E4990A" or "4294A"
    log : file to which every line that arrives is appended; none where None
    """

    unknown: ClassVar[str] = '-113,"Undefined header"'

    def __init__(self, bench: Bench, model: str = "E4990A", log: Path | None = None) -> None:
        driver, dialect = DIALECTS[model]
        self.bench, self._log, self._lock = bench, log, threading.Lock()
        handlers = dialect(bench)
        self._known = [
            (_pattern(driver.commands[name].text), work) for name, work in handlers.items() if name in driver.commands
        ]

    def answer(self, line: str) -> str | None:
        """The reply to a line, None for none; an unknown line or a wrong argument adds an error to the queue."""
        with self._lock:
            if self._log is not None:
                with open(self._log, "a", encoding="utf-8") as stream:
                    stream.write(line + "\n")
            for pattern, work in self._known:
                if match := pattern.fullmatch(line.strip()):
                    try:
                        return work(match.group(1) if pattern.groups else "")
                    except (ValueError, KeyError, IndexError, OverflowError):
                        self.bench.queue.append('-104,"Data type error"')
                        return None
            self.bench.queue.append(self.unknown)
            return None


def _pattern(text: str) -> re.Pattern[str]:
    """The pattern that a command of a table matches, with its argument as a group."""
    parts = re.split(r"\{[^}]*\}", text)
    return re.compile("(.+?)".join(re.escape(part) for part in parts), re.IGNORECASE)


class _Client(socketserver.StreamRequestHandler):
    """One connection."""

    timeout = _PATIENCE

    def handle(self) -> None:
        while True:
            try:
                raw = self.rfile.readline(_LONGEST)
                if not raw.endswith(b"\n"):  # closed, or longer than any command
                    return
                reply = self.server.analyser.answer(raw.decode("ascii", "replace").strip())
                if reply is not None:
                    self.wfile.write(reply.encode("ascii") + b"\n")
            except _Half as half:
                self.wfile.write(str(half).encode("ascii"))
            except (_Broken, OSError):
                return


class _Server(socketserver.ThreadingTCPServer):
    allow_reuse_address, daemon_threads = True, True

    def __init__(self, port: int, analyser: SimulatedAnalyser) -> None:
        self.analyser = analyser
        super().__init__(("127.0.0.1", port), _Client)


def serve(
    specimen: Specimen,
    port: int,
    *,
    model: str = "E4990A",
    drift: float = 0.0,
    seed: int = 0,
    faults: tuple[Fault, ...] = (),
    log: Path | None = None,
    ready: Callable[[int], None] = lambda port: None,
) -> None:
    """Answer on a port of this machine (127.0.0.1) until interrupted; 0 takes any that is free.

    Parameters
    ----------
    drift, seed : as of `Piece`
    ready : called with the port when it listens
    """
    analyser = SimulatedAnalyser(Bench(Piece(specimen, drift, seed), faults), model, log)
    try:
        server = _Server(port, analyser)
    except OSError as error:
        raise InputError(f"port {port} cannot be used ({error.strerror}); give another by --port") from None
    with server:
        ready(server.server_address[1])
        server.serve_forever(poll_interval=0.1)
