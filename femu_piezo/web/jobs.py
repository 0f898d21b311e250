"""A queue of commands, each run in its own process by one of several workers, with progress and cancellation."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Literal

from femu_piezo import steps
from femu_piezo.errors import InputError
from femu_piezo.files import write_atomically
from femu_piezo.threads import available_cores

State = Literal["waiting", "running", "done", "failed", "cancelled"]
#: Jobs that are remembered in addition to waiting ones, and most that may wait.
_REMEMBERED, _MOST_WAITING = 60, 200
_STOPPED = "the server was stopped while the job ran"
#: Environment variable in which the commands find the address of a store.
STORE_VARIABLE = "FEMU_PIEZO_STORE"
#: Seconds that an interrupted command has to tidy up.
_PATIENCE = 15.0
#: Expected seconds of a command that has not been run in this folder yet.
_FIRST_GUESS = {"extract": 4.0, "update": 12.0, "diagnose": 60.0, "modes": 20.0, "identify": 20.0, "datasheet": 12.0}


@dataclass
class Job:
    """One command.

    Attributes
    ----------
    number : in the order of the requests
    command : "update", "diagnose", …;  source : name of the file or lot;  out : name of the folder of results
    arguments : further arguments of the command line
    state : of the job;  step : of the running command;  message : the sentence of its error
    asked, began, ended : seconds since 1970
    """

    number: int
    command: str
    source: str
    out: str
    arguments: list[str] = field(default_factory=list)
    state: State = "waiting"
    step: str = ""
    message: str = ""
    asked: float = 0.0
    began: float | None = None
    ended: float | None = None

    @property
    def active(self) -> bool:
        """Whether it waits or runs."""
        return self.state in ("waiting", "running")

    @property
    def seconds(self) -> float:
        """Seconds from its beginning to its end, or to now while it runs."""
        return 0.0 if self.began is None else (self.ended or time.time()) - self.began


class Jobs:
    """The queue of the commands on a folder; they keep their results also in a store where one is given.

    Jobs that run when the server stops are interrupted; those that wait are run after the next start.
    """

    def __init__(self, folder: Path, own: Path, workers: int | None = None, store: str | None = None) -> None:
        self._settings = {} if store is None else {STORE_VARIABLE: store}  # not an argument: it may hold a password
        self._folder, self._file, self._times_file = folder, own / "jobs.json", own / "times.json"
        self._lock = threading.RLock()
        self._wake = threading.Condition(self._lock)
        self._running: dict[int, subprocess.Popen] = {}
        self._step_began: dict[int, float] = {}
        self._stopped = False
        self._jobs = _known(_json(self._file, []))
        self._times: dict[str, dict] = _json(self._times_file, {})
        for job in self._jobs:
            if job.state == "running":
                job.state, job.message, job.ended = "cancelled", _STOPPED, time.time()
        count = workers or available_cores()
        self._threads = [threading.Thread(target=self._work, daemon=True) for _ in range(count)]
        self._share = max(1, available_cores() // count)
        for thread in self._threads:
            thread.start()

    def all(self) -> list[Job]:
        """Every job that is remembered, the latest first."""
        with self._lock:
            return self._jobs[::-1]

    def latest(self, command: str, source: str) -> Job | None:
        """The last job of a command on a source."""
        return next((job for job in self.all() if (job.command, job.source) == (command, source)), None)

    def ask(self, command: str, source: str, out: str, arguments: Sequence[str] = ()) -> Job:
        """Queue a command and return its job; an active job of the same command and source is returned instead."""
        with self._lock:
            for job in self._jobs:
                if job.active and (job.command, job.source) == (command, source):
                    return job
            number = 1 + max((job.number for job in self._jobs), default=0)
            job = Job(number, command, source, out, list(arguments), asked=time.time())
            if sum(one.active for one in self._jobs) >= _MOST_WAITING:
                job.state, job.message = "failed", f"{_MOST_WAITING} jobs are waiting already; start this one later"
            self._jobs = [*self._jobs, job][-_REMEMBERED - _MOST_WAITING :]
            self._keep()
            self._wake.notify()
            return job

    def cancel(self, number: int) -> None:
        """Take a job out of the queue, or interrupt it as Ctrl-C does."""
        with self._lock:
            job = next((one for one in self._jobs if one.number == number and one.active), None)
            if job is None:
                return
            process = self._running.get(number)
            job.state, job.ended = "cancelled", time.time()
            self._keep()
        if process is not None:
            threading.Thread(target=_interrupt, args=(process,), daemon=True).start()

    def seconds_left(self, job: Job) -> float | None:
        """Seconds to the end of a job, from the last run of its command; None once that time is over."""
        known = self._times.get(job.command, {"all": _FIRST_GUESS.get(job.command, 30.0), "steps": {}})
        whole, begun = known["all"], known["steps"].get(job.step)
        remaining = whole - job.seconds
        if begun is not None and job.state == "running":
            remaining = (whole - begun) - (time.time() - self._step_began.get(job.number, time.time()))
        return remaining if remaining > 0 else None

    def stop(self) -> None:
        """Interrupt the running jobs and end the workers."""
        with self._lock:
            self._stopped = True
            running = list(self._running.values())
            for job in self._jobs:
                if job.state == "running":
                    job.state, job.message, job.ended = "cancelled", _STOPPED, time.time()
            self._keep()
            self._wake.notify_all()
        for process in running:
            _interrupt(process)

    def _work(self) -> None:
        while True:
            with self._lock:
                while not self._stopped and (job := self._next()) is None:
                    self._wake.wait()
                if self._stopped:
                    return
                job.state, job.began = "running", time.time()
                self._keep()
            try:
                self._run(job)
            except OSError as error:
                self._end(job, "failed", f"the command could not be started ({error.strerror})", {})

    def _next(self) -> Job | None:
        """The first waiting job into whose folder of results no running job writes."""
        busy = {one.out for one in self._jobs if one.state == "running" or one.number in self._running}
        return next((one for one in self._jobs if one.state == "waiting" and one.out not in busy), None)

    def _run(self, job: Job) -> None:
        command_line = [sys.executable, "-P", "-m", "femu_piezo.cli", job.command, "--out", job.out, *job.arguments]
        command_line += ["--", job.source]  # -P: scripts in the folder shadow no modules;  --: no name is an option
        environment = {**os.environ, **self._settings, steps.VARIABLE: "1", "PYTHONUTF8": "1"}
        environment["OMP_NUM_THREADS"] = str(self._share)
        process = subprocess.Popen(
            command_line,
            cwd=self._folder,
            env=environment,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
            encoding="utf-8",
            errors="replace",
            start_new_session=True,
        )
        with self._lock:
            self._running[job.number] = process
            cancelled = job.state == "cancelled"
        if cancelled:
            _interrupt(process)
        last_line, began = "", {}
        for line in process.stderr:
            if line.startswith(steps.PREFIX):
                job.step = line.removeprefix(steps.PREFIX).strip()[:200]
                self._step_began[job.number] = time.time()
                began.setdefault(job.step, job.seconds)
            elif line.strip():
                last_line = line.strip()[:2000]
        code = process.wait()
        last_line = last_line.removeprefix("femu-piezo: ")
        self._end(job, "done" if code == 0 else "failed", "" if code == 0 else last_line or f"exit code {code}", began)

    def _end(self, job: Job, state: State, message: str, began: dict[str, float]) -> None:
        with self._lock:
            self._running.pop(job.number, None)
            self._step_began.pop(job.number, None)
            if job.state != "cancelled":
                job.state, job.message, job.ended = state, message, time.time()
            if job.state == "done":
                self._times[job.command] = {"all": round(job.seconds, 2), "steps": began}
                _save(self._times_file, json.dumps(self._times))
            self._keep()
            self._wake.notify_all()

    def _keep(self) -> None:
        _save(self._file, json.dumps([asdict(job) for job in self._jobs], indent=1, ensure_ascii=False))


def _save(path: Path, text: str) -> None:
    """Write what a later start of the page reads; on a full disk the jobs go on all the same."""
    with suppress(InputError):
        write_atomically(path, text)


def _known(records: object) -> list[Job]:
    """The jobs of a file; none where its records have other keys."""
    try:
        return [Job(**record) for record in records]
    except TypeError:
        return []


def _interrupt(process: subprocess.Popen) -> None:
    """End a command and its workers, gently first."""
    for sign in (signal.SIGINT, signal.SIGKILL):
        try:
            os.killpg(process.pid, sign)
            process.wait(_PATIENCE)
            return
        except ProcessLookupError:
            return
        except subprocess.TimeoutExpired:
            continue


def _json(path: Path, otherwise):
    """The content of a JSON file that the page keeps; `otherwise` where it is missing or damaged."""
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return otherwise
