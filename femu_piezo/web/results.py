"""What the commands wrote into the folder, read back for the page."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from femu_piezo.errors import InputError
from femu_piezo.files import read_json
from femu_piezo.measurement.checks import check_spectrum
from femu_piezo.measurement.readers import read_spectrum
from femu_piezo.output.curves import PRINTED
from femu_piezo.output.tables import interval_text, source_words
from femu_piezo.specimen.file import Measurement
from femu_piezo.units import number
from femu_piezo.web.charts import Curve

_LARGEST = 300_000_000


def record(path: Path) -> dict | None:
    """The record of a JSON file; None where it cannot be read."""
    try:
        return read_json(path, _LARGEST, "a result")
    except InputError:
        return None


def sweep(path: Path) -> tuple[Curve, list[tuple[str, np.ndarray]], list[str]] | str:
    """Curve of a measured file, its faults with their frequencies, and notes; or the sentence of an error.

    An error is returned, not raised, as this runs in another process.
    """
    try:
        spectrum = read_spectrum(path)
    except InputError as error:
        return str(error).replace(str(path), path.name)
    faults = [(fault.message, spectrum.frequency[fault.indices]) for fault in check_spectrum(spectrum)]
    return (spectrum.frequency, spectrum.impedance), faults, list(spectrum.notes)


def measured(wish: Measurement, file: Path) -> Curve | str:
    """Curve of a sweep as a fit takes it, with the corrections of its [measurement] table; or the sentence of an error.

    An error is returned, not raised, as this runs in another process.
    """
    from femu_piezo.study.measured import read_sweep

    try:
        spectrum = read_sweep(wish, file)
    except InputError as error:
        return str(error).replace(str(file), file.name)
    return spectrum.frequency, spectrum.impedance


def curve(path: Path) -> Curve | None:
    """A curve that a command wrote as CSV; None where it cannot be read."""
    found = columns(path)
    return None if found is None else (found["frequency_Hz"], found["resistance_ohm"] + 1j * found["reactance_ohm"])


def columns(path: Path) -> dict[str, np.ndarray] | None:
    """Column → numbers (k,) of a CSV file; None where it cannot be read."""
    try:
        with open(path, encoding="utf-8") as stream:
            names = stream.readline().strip().split(",")
            values = np.loadtxt(stream, delimiter=",", ndmin=2)
    except (OSError, ValueError):
        return None
    return dict(zip(names, values.T, strict=True)) if values.shape[1] == len(names) else None


def constant_rows(parameters: dict) -> list[tuple[str, str, str, str, str]]:
    """Name, unit, value, loss tangent and largest part of the deviation, to the digits that the terminal prints."""
    rows = []
    for name, one in parameters.items():
        factor, unit = PRINTED[name]
        std = None if one.get("std") is None else one["std"] * factor
        rows.append(
            (name, unit, number(one["value"] * factor, std), number(one["tan"], one.get("tan_std")), _largest_part(one))
        )
    return rows


def interval_rows(parameters: dict) -> list[tuple[str, str]]:
    """Intervals of 95 % of value and loss tangent, averaged over causes; "" where the results lack them."""
    rows = []
    for name, one in parameters.items():
        value, tangent = one.get("interval"), one.get("tan_interval")
        if value is None or tangent is None:
            rows.append(("", ""))
        else:
            rows.append((interval_text(*(PRINTED[name][0] * end for end in value)), interval_text(*tangent)))
    return rows


def shares(parameters: dict) -> dict[str, dict[str, float]]:
    """Parts of the variance of each constant and tangent, in %."""
    found = {}
    for name, one in parameters.items():
        for label, key in ((name, "budget"), (f"tan {name}", "tan_budget")):
            budget = one.get(key) or {}
            whole = sum(value**2 for value in budget.values())
            if whole:
                found[label] = {source_words(part): 100 * value**2 / whole for part, value in budget.items()}
    return found


def _largest_part(constant: dict) -> str:
    """The source of the largest part of the variance of a constant, and its share."""
    budget = constant.get("budget") or {}
    whole = sum(value**2 for value in budget.values())
    if not whole:
        return ""
    part = max(budget, key=budget.get)
    return f"{source_words(part)} {100 * budget[part] ** 2 / whole:.0f} %"


def resonance_rows(found: Sequence[dict], kind: str) -> list[tuple[str, str, str]]:
    """Kind, frequency in Hz and quality factor of resonances of extraction.json."""
    rows = []
    for one in found:
        std = one.get("std_loss")
        quality = number(1 / one["loss"], None if std is None else std / one["loss"] ** 2) if one["loss"] else "-"
        rows.append((kind, number(one["frequency_Hz"], one.get("std_Hz")), quality))
    return rows
