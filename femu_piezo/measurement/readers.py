"""Reading measured sweeps of any known format into an `ImpedanceSpectrum`, and writing them as plain CSV."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from femu_piezo.errors import InputError
from femu_piezo.files import path_of, read_bytes, write_atomically
from femu_piezo.measurement.checks import FEWEST_POINTS, check_spectrum, order_points
from femu_piezo.measurement.columns import Layout, angle_scale, choose_columns, names_noise, parse_column, to_impedance
from femu_piezo.measurement.compensation import Compensation
from femu_piezo.measurement.data_fault import DataFault
from femu_piezo.measurement.faults import MASKABLE, without_faults
from femu_piezo.measurement.instruments import (
    is_4294a,
    is_formatted_trace,
    is_keysight,
    read_4294a,
    read_formatted_trace,
    read_keysight,
)
from femu_piezo.measurement.spectrum import ImpedanceSpectrum
from femu_piezo.measurement.tables import Table, decode, read_table_with_words
from femu_piezo.measurement.touchstone import Connection, is_touchstone, read_touchstone
from femu_piezo.units import shown, two_hertz

#: Bands of frequency (low, high), Hz.
Bands = Sequence[tuple[float, float]]

_LARGEST_FILE = 300_000_000
_HEADER = "frequency_Hz,resistance_ohm,reactance_ohm"


def read_spectrum(
    path: Path | str,
    *,
    correct_phase: bool = False,
    mask_faults: bool = False,
    mask: Bands = (),
    noise: float | None = None,
    connection: Connection | None = None,
    columns: Sequence[str] | None = None,
    compensation: Compensation | None = None,
) -> ImpedanceSpectrum:
    """The impedance spectrum of a measured sweep.

    Formats: CSV `frequency_Hz,resistance_ohm,reactance_ohm[,noise_ohm]`; other delimited text whose header says what
    the columns are (Bode 100, WaveForms, list sweeps of LCR meters); HP 4294A text, Keysight E4990A and E5061B CSV
    exports; Touchstone 1 and 2 of one or two ports, with scikit-rf.

    Parameters
    ----------
    path : the file
    correct_phase : turn a phase that is wrong by 180° (Re Z < 0) back
    mask_faults : leave out the points of spikes, mains lines and negative resistance, and stretches in another range
    mask : bands (low, high), Hz, whose points are left out before any check
    noise : relative standard deviation of the complex impedance, where it is known; replaces that of the file
    connection : of the piece, for Touchstone alone: "reflection", "series" or "shunt"; found out where None
    columns : names of the columns of a table in place of its header, as one has them; "" for a column that is not used
    compensation : raw sweeps of the fixture (`read_raw`), whose influence is removed

    Returns
    -------
    ImpedanceSpectrum, with `notes` on what was corrected or is doubtful

    Raises
    ------
    InputError : the file or its data cannot be used; the sentence says what to do
    """
    spectrum, hertz_stated = _read(path_of(path), connection, columns)
    if compensation is not None:
        spectrum = compensation.applied(spectrum)
    return _checked(_with_noise(_without(spectrum, mask), noise), correct_phase, mask_faults, hertz_stated)


def read_raw(
    path: Path | str, *, connection: Connection | None = None, columns: Sequence[str] | None = None
) -> ImpedanceSpectrum:
    """The sweep of a raw file, such as that of an open fixture, unchecked; parameters as of `read_spectrum`."""
    return _read(Path(path), connection, columns)[0]


def _read(path: Path, connection: Connection | None, columns: Sequence[str] | None) -> tuple[ImpedanceSpectrum, bool]:
    """The spectrum of a file, unchecked; whether the file states the unit of the frequency."""
    source = str(path)
    text = decode(read_bytes(path, _LARGEST_FILE), source)
    if is_touchstone(path):
        if columns is not None:
            raise InputError(f"{source}: columns names those of a table, and this is a Touchstone file; leave it out")
        return read_touchstone(text, source, connection), True
    if connection is not None:
        raise InputError(
            f'{source}: connection = "{connection}" is for Touchstone files (*.s2p), and this is none; leave it out'
        )
    lines = text.split("\n")
    names = () if columns is None else columns
    if isinstance(names, str) or not (isinstance(names, Iterable) and all(isinstance(name, str) for name in names)):
        raise InputError(f"{source}: columns = {shown(columns)} is no list of names; give one for each column")
    if columns is not None and (is_4294a(lines) or is_keysight(lines)):
        raise InputError(f"{source}: this export of an analyser names its columns itself; leave columns out")
    notes: tuple[str, ...] = ()
    if is_4294a(lines):
        table = read_4294a(lines, source)
    elif is_keysight(lines):
        table, notes = read_keysight(lines, source)
    elif is_formatted_trace(lines):
        table = read_formatted_trace(lines, source, columns)
    else:
        table, notes = read_table_with_words(lines, source, columns)
    return _spectrum(table, source, notes)


def accept_spectrum(
    spectrum: ImpedanceSpectrum,
    *,
    correct_phase: bool = False,
    mask_faults: bool = False,
    mask: Bands = (),
    noise: float | None = None,
) -> ImpedanceSpectrum:
    """A sweep in memory, checked and corrected as `read_spectrum` does it with the sweep of a file.

    `correct_phase` has no effect on a sweep that is already `checked`. Parameters and errors as of `read_spectrum`.
    """
    spectrum = _with_noise(_without(spectrum, mask), noise)
    if not spectrum.checked:
        wrong = ~np.isfinite(spectrum.impedance) | (spectrum.impedance == 0)
        if np.any(wrong):
            raise InputError(
                f"{spectrum.source}: the impedance at {spectrum.frequency[np.argmax(wrong)]:g} Hz is "
                f"{spectrum.impedance[np.argmax(wrong)]:g} ohm, and zero, infinite or not a number at "
                f"{int(wrong.sum())} points; remove these points"
            )
        return _checked(spectrum, correct_phase, mask_faults, hertz_stated=True)
    return _masked(spectrum, check_spectrum(spectrum))[0] if mask_faults else spectrum


def _without(spectrum: ImpedanceSpectrum, mask: Bands) -> ImpedanceSpectrum:
    """The spectrum without the points in the bands of `mask`, with a note on them."""
    if not mask:
        return spectrum
    if not isinstance(mask, Iterable):
        raise InputError(
            f"{spectrum.source}: mask = {shown(mask)} is no list of bands; give bands as (low, high) in Hz"
        )
    keep = np.ones(len(spectrum), dtype=bool)
    for one in mask:
        low, high = two_hertz(one, f"{spectrum.source}: mask")
        if not low < high:
            raise InputError(
                f"{spectrum.source}: mask holds [{low:g}, {high:g}] Hz, not a band; give the lower frequency first"
            )
        keep &= (spectrum.frequency < low) | (spectrum.frequency > high)
    if keep.sum() < FEWEST_POINTS:
        raise InputError(
            f"{spectrum.source}: mask leaves {int(keep.sum())} of {len(spectrum)} points, and at least "
            f"{FEWEST_POINTS} are needed; give narrower bands"
        )
    left_out = int(np.sum(~keep))
    return replace(spectrum.select(keep), notes=(*spectrum.notes, f"left out (mask), {left_out} points"))


def _with_noise(spectrum: ImpedanceSpectrum, noise: float | None) -> ImpedanceSpectrum:
    """The spectrum with the relative standard deviation `noise`, unless it is None."""
    if noise is None:
        return spectrum
    if not (np.isfinite(noise) and 0 < noise < 1):
        raise InputError(
            f"{spectrum.source}: noise = {noise} is not a relative standard deviation; give one such as 0.001"
        )
    return replace(spectrum, noise=noise * np.abs(spectrum.impedance), noise_estimated=False)


def _spectrum(table: Table, source: str, notes: tuple[str, ...]) -> tuple[ImpedanceSpectrum, bool]:
    """The table as a spectrum in order of frequency; whether its header states the unit of the frequency."""
    columns = [parse_column(name) for name in table.names]
    layout = choose_columns(table.names, columns, source)
    _refuse_not_finite(table, layout, source)
    frequency = table.values[:, layout.frequency] * columns[layout.frequency].scale
    pair = []
    for index, kind in ((layout.first, layout.pair[0]), (layout.second, layout.pair[1])):
        values, column = table.values[:, index], columns[index]
        scale = angle_scale(values, column, source) if kind.startswith("phase") else column.scale
        pair.append(values * scale)
    impedance = to_impedance(layout.pair, *pair, frequency, source)
    noise = None
    if layout.noise is not None:
        noise = table.values[:, layout.noise] * columns[layout.noise].scale
        if np.any(noise <= 0):
            raise InputError(
                f"{source}: {int(np.sum(noise <= 0))} values of noise are not positive; correct or remove the column"
            )
    notes += tuple(
        f"the column {name.strip()} is not read, as noise is read in ohm; give it in ohm, or as measurement.noise"
        for name, column in zip(table.names, columns, strict=True)
        if column is None and names_noise(name)
    )
    ordered = order_points(frequency, impedance, noise, table.lines, source)
    spectrum = ImpedanceSpectrum(*ordered[:3], source=source, notes=notes + ordered[3])
    return spectrum, columns[layout.frequency].has_unit


def _refuse_not_finite(table: Table, layout: Layout, source: str) -> None:
    """Refuse NaN and infinity in the columns that are used."""
    used = [layout.frequency, layout.first, layout.second] + ([] if layout.noise is None else [layout.noise])
    wrong = ~np.isfinite(table.values[:, used]).all(axis=1)
    if wrong.any():
        row = int(np.argmax(wrong))
        column = next(index for index in used if not np.isfinite(table.values[row, index]))
        raise InputError(
            f"{source}, line {table.lines[row]}: {table.names[column]!r} is {table.values[row, column]}, and "
            f"{int(wrong.sum())} of {wrong.size} rows are not finite; measure these points again or remove their lines"
        )


def _checked(
    spectrum: ImpedanceSpectrum, correct_phase: bool, mask_faults: bool, hertz_stated: bool
) -> ImpedanceSpectrum:
    """The spectrum after the check of its physics, its phase turned where asked; faults that remain are notes."""
    faults = check_spectrum(spectrum, hertz_stated=hertz_stated)
    if correct_phase:
        if not any(fault.kind == "phase_turned" for fault in faults):
            raise InputError(
                f"{spectrum.source}: the phase is not turned by 180°, as Re Z is negative at only "
                f"{int(np.sum(spectrum.impedance.real < 0))} of {len(spectrum)} points; remove correct_phase"
            )
        spectrum = replace(spectrum, impedance=-spectrum.impedance)
        note = "the phase was turned by 180°: Re Z was negative over most of the sweep"
        faults = check_spectrum(spectrum, hertz_stated=hertz_stated)
        spectrum = replace(spectrum, notes=(*spectrum.notes, note))
    for fault in faults:
        if fault.fatal:
            raise InputError(f"{spectrum.source}: {fault.message}")
    if mask_faults:
        spectrum, faults = _masked(spectrum, faults)
    return replace(spectrum, notes=spectrum.notes + tuple(fault.message for fault in faults), checked=True)


def _masked(spectrum: ImpedanceSpectrum, faults: list[DataFault]) -> tuple[ImpedanceSpectrum, list[DataFault]]:
    """The spectrum without the points of faults that can be left out, with a note on each; and the other faults."""
    keep = without_faults(spectrum, faults)
    if keep.sum() < max(FEWEST_POINTS, len(spectrum) // 4):
        raise InputError(
            f"{spectrum.source}: mask_faults would leave {int(keep.sum())} of {len(spectrum)} points; measure again"
        )
    notes = tuple(
        f"left out (mask_faults), {fault.indices.size} points: {fault.message.partition('; ')[0]}"
        for fault in faults
        if fault.kind in MASKABLE
    )
    told = {fault.message for fault in faults if fault.kind in MASKABLE}  # noted by an earlier check without masking
    notes = tuple(note for note in spectrum.notes if note not in told) + notes
    return replace(spectrum.select(keep), notes=notes), [fault for fault in faults if fault.kind not in MASKABLE]


def write_spectrum(spectrum: ImpedanceSpectrum, path: Path | str) -> None:
    """Write CSV `frequency_Hz,resistance_ohm,reactance_ohm[,noise_ohm]` with all digits; no half-written file remains.

    Raises InputError where the file cannot be written.
    """
    if not isinstance(spectrum, ImpedanceSpectrum):
        raise InputError(
            f"write_spectrum takes an ImpedanceSpectrum, then a path, not a {type(spectrum).__name__} first"
        )
    columns = [spectrum.frequency, spectrum.impedance.real, spectrum.impedance.imag]
    header = _HEADER
    if spectrum.noise is not None:
        columns.append(spectrum.noise)
        header += ",noise_ohm"
    rows = zip(*(column.tolist() for column in columns), strict=True)
    write_atomically(path, "\n".join([header, *(",".join(map(repr, row)) for row in rows)]) + "\n")
