"""Poses a problem to NGSolve in another Python: sends a task as JSON to in_ngsolve.py and returns its answer."""

from __future__ import annotations

import json
import subprocess
from pathlib import Path

import numpy as np

from femu_piezo.material.constants import ElasticForm


def answer(python: str, task: dict, seconds: float | None = None) -> dict:
    """The answer of in_ngsolve.py to a task; OSError or SubprocessError where there is none within so many seconds.

    python : a Python that can import ngsolve
    """
    script = Path(__file__).with_name("in_ngsolve.py")
    done = subprocess.run(
        [python, str(script)], input=json.dumps(task), capture_output=True, text=True, timeout=seconds, check=True
    )
    return json.loads(done.stdout[done.stdout.index("{") :])


def coupled(form: ElasticForm) -> list[list[float]]:
    """(9, 9) real [[c, eᵗ], [e, −ε]], the form in which tasks hold the constants."""
    rows = [[form.stiffness(), form.piezoelectric().T], [form.piezoelectric(), -form.permittivity()]]
    return np.block(rows).real.tolist()
