"""Names the steps of a computation and keeps their times."""

from __future__ import annotations

import time
from collections.abc import Callable

Progress = Callable[[str], None]


class Clock:
    """Names the steps to `progress` and keeps their times."""

    def __init__(self, progress: Progress | None) -> None:
        self.seconds: dict[str, float] = {}
        self._progress = progress or (lambda step: None)
        self._last, self._name = time.perf_counter(), None

    def step(self, name: str | None) -> None:
        """End the running step and begin the next; None ends the last."""
        now = time.perf_counter()
        if self._name is not None:
            self.seconds[self._name] = round(self.seconds.get(self._name, 0.0) + now - self._last, 4)
        self._last, self._name = now, name
        if name is not None:
            self._progress(name)

    def tell(self, words: str) -> None:
        """Name a part of the running step to `progress`, without a time of its own."""
        self._progress(words)
