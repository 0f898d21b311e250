"""Progress of a lot on a terminal: done, rate and time left; silent elsewhere."""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, Task, TaskID, TextColumn, TimeRemainingColumn
from rich.text import Text

from femu_piezo import steps


class _Rate(TextColumn):
    """Finished specimens per minute, over the latest ones."""

    def __init__(self) -> None:
        super().__init__("")

    def render(self, task: Task) -> Text:
        return Text("" if not task.speed else f"{60 * task.speed:.0f}/min")


@contextmanager
def lot_progress() -> Iterator[Callable[[str, int, int, dict], None]]:
    """Yield the function to call with (step, done, all, record) after each job; one bar for each step."""
    if steps.wanted():
        yield lambda step, done, all_, record: steps.write(f"{step}: {done} of {all_}")
        return
    if not sys.stderr.isatty():
        yield lambda step, done, all_, record: None
        return
    console = Console(stderr=True)
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), _Rate(), TextColumn("left"))
    faults = Counter()
    with Progress(
        *columns, TimeRemainingColumn(), TextColumn("{task.fields[faults]}"), console=console, transient=True
    ) as bar:
        bars: dict[str, TaskID] = {}

        def finished(step: str, done: int, all_: int, record: dict) -> None:
            if step not in bars:
                bars[step] = bar.add_task(step, faults="")
            faults[step] += record["status"] != "ok"
            words = f"{faults[step]} without result" if faults[step] else ""
            bar.update(bars[step], total=all_, completed=done, faults=words)

        yield finished
