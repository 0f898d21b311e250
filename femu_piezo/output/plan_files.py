"""Frequencies for an analyser without a connection, as files."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from femu_piezo.files import write_atomically
from femu_piezo.measurement.segments import E4990A_MOST, in_sweeps, segment_csv, segment_data, segments


def write_plan(out: Path, frequency: np.ndarray) -> None:
    """Write plan.csv (a frequency (n,) a line), plan_segments.csv (a table to type in) and plan_e4990a.scpi.

    The last holds the commands that set these segments at a Keysight E4990A, a line for each sweep.
    """
    every = segments(frequency)
    write_atomically(out / "plan.csv", "\n".join(["frequency_Hz", *(f"{one:.6f}" for one in frequency)]) + "\n")
    write_atomically(out / "plan_segments.csv", segment_csv(every))
    lines = [f":SENS1:SEGM:DATA {segment_data(one)}" for one in in_sweeps(every, *E4990A_MOST)]
    write_atomically(out / "plan_e4990a.scpi", "\n".join([":SENS1:SWE:TYPE SEGM", *lines]) + "\n")
