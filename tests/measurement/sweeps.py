"""Sweeps with known values: the exact 1-D k31 bar, independent of femu_piezo, and writers of
instrument files.
"""

from __future__ import annotations

import numpy as np

from tests import k31_bar

SOFT = {"s11": 15.84e-12 * (1 - 0.016j), "d31": -293.25e-12 * (1 - 0.013j), "eps33": 2422.5 * 8.854e-12 * (1 - 0.015j)}
HARD = {"s11": 11.5e-12 * (1 - 0.001j), "d31": -100e-12 * (1 - 0.001j), "eps33": 1000 * 8.854e-12 * (1 - 0.002j)}


def bar_impedance(frequency: np.ndarray, s11: complex, d31: complex, eps33: complex) -> np.ndarray:
    """(n,) ohm: Z of a 40 × 5 × 1 mm bar of 7900 kg/m³; fundamental at 35.6 kHz (soft), 41.5 kHz (hard)."""
    return k31_bar.impedance(2 * np.pi * frequency, (40e-3, 5e-3, 1e-3), 7900.0, s11, d31, eps33)


def columns_of(frequency: np.ndarray, impedance: np.ndarray, pair: str) -> tuple[np.ndarray, np.ndarray]:
    """The two columns "z_deg", "z_rad", "rx", "y_deg" or "gb" of a sweep."""
    values = 1 / impedance if pair in ("y_deg", "gb") else impedance
    if pair in ("rx", "gb"):
        return values.real, values.imag
    return np.abs(values), np.angle(values, deg=pair.endswith("deg"))


def write_4294a(frequency: np.ndarray, a: np.ndarray, b: np.ndarray, parameter: str, sweep: str = "LIN FREQ") -> str:
    """Text of a 4294A export."""
    head = ["4294A REV1.11", '"DATE:     52 -100"', "", f'"MEASURE PARAMETER: {parameter}"', '"ADAPTER: NONE"']
    head += [f'"SWEEP TYPE: {sweep}"', f'"NUMBER of POINTS: {frequency.size}"', ""]
    for name, values in (("A", a), ("B", b)):
        head += [f'"TRACE: {name}"', '"FORMAT: LIN"', "", '"Frequency"\t"Data Trace Real"\t"Data Trace Imag"']
        head += [f"{f:.11e}\t{v:.15e}\t0.000000e+00" for f, v in zip(frequency, values, strict=True)] + ["", ""]
    return "\n".join(head)


def write_e4990a(frequency: np.ndarray, a: np.ndarray, b: np.ndarray, names: str, memory: bool = False) -> str:
    """Text of an E4990A export, as the help of the instrument prints one."""
    head = ["!Agilent Technologies,E4990A,MY52101234,A.02.10", "!Date: Fri Apr 03 13:41:16 2015", "BEGIN CH1_DATA"]
    head += ["Title label, TEST DATA", "DCV(V), +5.230e-005, DCI(A), +2.335e-005"]
    head += ["Frequency(Hz), " + names + (", theta-z(deg)-mem" if memory else "")]
    tail = ", +8.89149657750e+001" if memory else ""
    rows = [f"{f:+.15e}, {p:+.15e}, {q:+.15e}{tail}" for f, p, q in zip(frequency, a, b, strict=True)]
    return "\n".join([*head, *rows, "END", ""])
