"""Exports of impedance analysers: HP/Agilent 4294A text files and Keysight E4990A CSV files.

4294A: a head of settings in quotes, then one block of rows for each trace ("TRACE: A", "TRACE: B"); what the traces
hold stands in "MEASURE PARAMETER". E4990A: comment lines with "!", then for each channel a table between
"BEGIN CH1_DATA" and "END" (Keysight E4990A help, "Saving trace data to a file").
E5061B: frequency and the two numbers of the display format (Keysight E5061B help, the same page).
"""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np

from femu_piezo.errors import InputError
from femu_piezo.measurement.columns import is_lcr, parse_column
from femu_piezo.measurement.tables import Table, read_table

#: What a 4294A shows beside |Z| that is no phase: |Z|-Ls, -Cs, -Lp, -Cp, -Rs, -Q, -D.
_NO_PHASE = r"(?!\s*([LC][SP]|RS|Q|D)\b)"
_PARAMETERS = (
    (rf"IMPEDANCE.*MAG.*PHASE|\|Z\|\s*-{_NO_PHASE}", "|Z| (Ohm)", "thetaz"),
    (rf"ADMITTANCE.*MAG.*PHASE|\|Y\|\s*-{_NO_PHASE}", "|Y| (S)", "thetay"),
    (r"IMPEDANCE.*REAL.*IMAG|RESIST.*REACT|\bR\s*-\s*X\b", "R (Ohm)", "X (Ohm)"),
    (r"ADMITTANCE.*REAL.*IMAG|CONDUCT.*SUSCEPT|\bG\s*-\s*B\b", "G (S)", "B (S)"),
)


def is_4294a(lines: list[str]) -> bool:
    """Whether the text is an export of a 4294A."""
    head = lines[:60]
    return any("MEASURE PARAMETER" in line for line in head) and any("TRACE:" in line for line in lines[:200])


def is_keysight(lines: list[str]) -> bool:
    """Whether the text is a CSV export of an E4990A or of an analyser that writes the same blocks."""
    return any(re.match(r"\s*BEGIN CH\d+_DATA", line) for line in lines[:60])


def is_formatted_trace(lines: list[str]) -> bool:
    """Whether the text is a trace saved by an E5061B or E5071C, whose header does not say what was measured."""
    return any(line.lower().count("formatted data") >= 2 for line in lines[:20])


def read_formatted_trace(lines: list[str], source: str, names: Sequence[str] | None) -> Table:
    """A trace saved by an E5061B: frequency and the two numbers of its display format, which the user must name.

    Raises InputError where `names` is None, or the second number is zero throughout.
    """
    if names is None:
        raise InputError(
            f"{source}: a trace of an E5061B has the columns Frequency, Formatted Data, Formatted Data and does not "
            'say what they are; write columns = ["Frequency (Hz)", "R (Ohm)", "X (Ohm)"] in [measurement] for a trace '
            "of R + jX, or save S11 as Touchstone"
        )
    table = read_table(lines, source, names=names)
    if not np.any(table.values[:, -1]):
        raise InputError(
            f"{source}: the second column of Formatted Data is zero: the trace was saved in a rectangular format, "
            "which holds only one part of the impedance; save it in the format of R + jX, G + jB or |Z| and phase"
        )
    return table


def read_4294a(lines: list[str], source: str) -> Table:
    """The sweep of a 4294A export as one table.

    Raises InputError where a trace is missing, cut off or on other frequencies, or the parameter is not understood.
    """
    starts = [i for i, line in enumerate(lines) if re.match(r'\s*"?TRACE:', line)]
    head = {}
    for line in lines[: starts[0]]:
        key, _, value = line.strip().strip('"').partition(":")
        head[key.strip().upper()] = value.strip()
    if "FREQ" not in head.get("SWEEP TYPE", "FREQ").upper():
        raise InputError(f"{source}: the sweep is over {head['SWEEP TYPE']!r}; a sweep over frequency is needed")
    first_name, second_name = _parameter(head.get("MEASURE PARAMETER", ""), source)
    blocks = [
        _block(lines[start:stop], start + 1, head.get("NUMBER OF POINTS", ""), source)
        for start, stop in zip(starts, [*starts[1:], len(lines)], strict=True)
    ]
    if len(blocks) != 2:
        raise InputError(
            f"{source}: the number of traces in the export is {len(blocks)}, and two are needed; "
            "export traces A and B of one sweep, and check that the file is not cut off"
        )
    a, b = blocks
    if a.values.shape != b.values.shape or not np.array_equal(a.values[:, 0], b.values[:, 0]):
        raise InputError(
            f"{source}: traces A ({len(a.values)} points) and B ({len(b.values)} points) are not on the same "
            "frequencies; export the sweep again"
        )
    values = np.column_stack([a.values[:, 0], a.values[:, 1], b.values[:, 1]])
    return Table(["Frequency (Hz)", first_name, second_name], values, a.lines)


def _parameter(parameter: str, source: str) -> tuple[str, str]:
    """Names of the quantities of traces A and B."""
    for pattern, first, second in _PARAMETERS:
        if re.search(pattern, parameter.upper()):
            angle = " (rad)" if "RAD" in parameter.upper() else " (deg)"
            return first, second + (angle if second.startswith("theta") else "")
    raise InputError(
        f"{source}: the measure parameter {parameter!r} is not understood; measure |Z|-theta, R-X, G-B or |Y|-theta"
    )


def _block(lines: list[str], first_line: int, points: str, source: str) -> Table:
    """One trace: frequency and value (the first column of the data trace)."""
    header = next((i for i, line in enumerate(lines) if line.lstrip().startswith('"Frequency"')), None)
    if header is None:
        raise InputError(f"{source}, line {first_line}: this trace has no line of column names; export the file again")
    names = [cell.strip().strip('"') for cell in lines[header].split("\t")]
    if "Data Trace Real" not in names:
        raise InputError(
            f'{source}, line {first_line + header}: there is no column "Data Trace Real"; export the data trace'
        )
    # the names of a trace say nothing of its meaning: they are replaced by ones that the table reader knows
    known = "\t".join(f"R{i} (Ohm)" if i else "Frequency (Hz)" for i in range(len(names)))
    table = read_table([known, *lines[header + 1 :]], source, first_line + header)
    if points.isdigit() and int(points) != len(table.values):
        raise InputError(
            f"{source}: a trace has {len(table.values)} points where the head says {points}; "
            "the file is cut off or edited, export it again"
        )
    return Table(names, table.values[:, [0, names.index("Data Trace Real")]], table.lines)


def read_keysight(lines: list[str], source: str) -> tuple[Table, tuple[str, ...]]:
    """The first channel with R and X, |Z| or the like, else with C, L, D or Q; and a note where there are several.

    Raises InputError where a channel has no END, or none holds an impedance.
    """
    starts = [i for i, line in enumerate(lines) if re.match(r"\s*BEGIN CH\d+_DATA", line)]
    tables: list[Table] = []
    for start, stop in zip(starts, [*starts[1:], len(lines)], strict=True):
        end = next((i for i in range(start, stop) if lines[i].strip().rstrip(",;\t") == "END"), None)
        channel = lines[start].strip().rstrip(",;\t").removeprefix("BEGIN ")
        if end is None:
            raise InputError(f"{source}: the block {channel} has no END; the file is cut off, export it again")
        table = read_table([*lines[start + 1 : end], ""], source, start + 2)
        tables.append(table)
    whole = [t for t in tables if sum(parse_column(name) is not None for name in t.names) >= 3] or tables
    direct = [t for t in whole if not any(is_lcr(name) for name in t.names)] or whole
    notes = ()
    if len(tables) > 1:
        notes = (f"{len(tables)} channels in the file; the first with an impedance was taken",)
    return direct[0], notes
