"""A circuit as a SPICE subcircuit of R, L and C, which ngspice and LTspice read."""

from __future__ import annotations

import re

import numpy as np

from femu_piezo.circuits.circuit import Circuit
from femu_piezo.units import hertz


def subcircuit_name(circuit: Circuit) -> str:
    """The name of a circuit as SPICE takes it: letters, digits and underscores, a letter first."""
    text = re.sub(r"[^A-Za-z0-9]+", "_", circuit.name).strip("_").upper()
    return text if text[:1].isalpha() else f"PIEZO_{text}".rstrip("_")


def spice_text(circuit: Circuit) -> str:
    """The subcircuit between its terminals a and b, all digits; every inner node has a path for direct current."""
    low, high = circuit.frequency[[0, -1]]
    misfit = f"{100 * circuit.misfit[1]:.2g} %"
    name = subcircuit_name(circuit)
    lines = [
        f"* Equivalent circuit made by femu-piezo, {hertz(low)} to {hertz(high)} Hz, within {misfit} of its curve",
        f"* use: X1 a b {name}",
        f".subckt {name} a b",
    ]
    for index, branch in enumerate(circuit.branches, 1):
        doubtful = ", doubtful" if branch.doubtful else ""
        lines.append(f"* mode {index}: {branch.frequency_Hz:.6f} Hz, Q {branch.quality_factor:.6g}{doubtful}")
        lines += _series(f"m{index}", branch.elements)
    signed = any(part.kind == "RLC" for part in circuit.static)
    lines.append(
        "* rest of the curve, without the modes"
        + (", of either sign: valid only together and only in this band" * signed)
    )
    for index, part in enumerate(circuit.static, 1):
        lines += _series(f"s{index}", part.values) if len(part.values) > 1 else _single(f"s{index}", part.values)
    return "\n".join([*lines, f".ends {name}", ""])


def _single(label: str, values: dict[str, float]) -> list[str]:
    ((key, value),) = values.items()
    return [f"{key}{label} a b {value!r}"]


def _series(label: str, values: dict[str, float]) -> list[str]:
    """Elements in series from a to b, the capacitor last, Rp across it."""
    chain = [(key, values[key]) for key in ("L", "R", "C") if key in values and values[key] != 0]
    lines, node = [], "a"
    for place, (key, value) in enumerate(chain):
        after = "b" if place == len(chain) - 1 else f"n{label}{place + 1}"
        lines.append(f"{key}{label} {node} {after} {value!r}")
        if key == "C" and np.isfinite(values.get("Rp", np.inf)):
            lines.append(f"Rp{label} {node} {after} {values['Rp']!r}")
        node = after
    return lines
