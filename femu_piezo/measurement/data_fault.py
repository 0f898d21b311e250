"""`DataFault`: one fault of a sweep with its place and remedy."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class DataFault:
    """One fault of a sweep.

    Attributes
    ----------
    kind : "too_few", "khz_for_hz", "hz_for_khz", "phase_turned", "reactance_sign", "resistance_sign",
        "columns_exchanged", "admittance_exchanged", "not_passive", "rough", "jump", "spike", "mains", "quantised" or
        "interpolated"
    message : one sentence with the numbers and the remedy
    indices : (k,) int, the points concerned, counted from 0; empty where it is the whole sweep. For a jump a
        stretch whose readings are off those of most points
    fatal : whether the sweep cannot be used as it is
    """

    kind: str
    message: str
    indices: np.ndarray
    fatal: bool = True
