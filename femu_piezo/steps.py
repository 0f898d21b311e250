"""Steps of a command as lines on stderr, for a program that runs the command with FEMU_PIEZO_STEPS=1."""

from __future__ import annotations

import os
import sys

VARIABLE = "FEMU_PIEZO_STEPS"
"""Environment variable that asks for the lines."""

PREFIX = "step: "
"""How such a line begins."""


def wanted() -> bool:
    """Whether another program reads the steps."""
    return os.environ.get(VARIABLE) == "1"


def write(step: str) -> None:
    """Write a line with the step to stderr."""
    print(f"{PREFIX}{step}", file=sys.stderr, flush=True)
