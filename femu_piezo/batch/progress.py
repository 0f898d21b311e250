"""Progress of a lot on a terminal: done, rate and time left; silent elsewhere."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, Task, TextColumn, TimeRemainingColumn
from rich.text import Text


class _Rate(TextColumn):
    """Finished specimens per minute over the last of them."""

    def __init__(self) -> None:
        super().__init__("")

    def render(self, task: Task) -> Text:
        return Text("" if not task.speed else f"{60 * task.speed:.0f}/min")


@contextmanager
def lot_progress() -> Iterator[Callable[[int, int, dict], None]]:
    """Yield the function to call with (done, all, record) after each job; rows without a result are printed."""
    if not sys.stderr.isatty():
        yield lambda done, all_, record: None
        return
    console = Console(stderr=True)
    columns = (BarColumn(), MofNCompleteColumn(), _Rate(), TextColumn("left"), TimeRemainingColumn())
    with Progress(*columns, TextColumn("{task.fields[faults]}"), console=console, transient=True) as bar:
        task = bar.add_task("specimens", total=None, faults="")
        faults = 0

        def finished(done: int, all_: int, record: dict) -> None:
            nonlocal faults
            if record["status"] != "ok":
                faults += 1
            bar.update(task, total=all_, completed=done, faults=f"{faults} without result" if faults else "")

        yield finished
