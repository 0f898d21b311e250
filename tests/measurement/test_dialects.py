"""Every dialect of file that is understood gives back the numbers that were written."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from femu_piezo.errors import InputError
from femu_piezo.measurement.columns import parse_column
from femu_piezo.measurement.readers import read_spectrum, write_spectrum
from femu_piezo.measurement.spectrum import ImpedanceSpectrum

from .sweeps import SOFT, bar_impedance, columns_of, write_4294a, write_e4990a

FREQUENCY = np.linspace(30e3, 50e3, 41)
IMPEDANCE = bar_impedance(FREQUENCY, **SOFT)
HEADERS = {
    "z_deg": [
        ("|Z| (Ohm)", "theta (deg)"),
        ("|Z| [kΩ]", "θ [°]"),
        ("Zabs/MOhm", "phase(Z)/deg"),
        ("Z_ohm", "Phase_deg"),
    ],
    "z_rad": [("|Z| (Ohm)", "theta (rad)"), ("Impedance (mOhm)", "Phase angle (mrad)")],
    "rx": [("R (Ohm)", "X (Ohm)"), ("Re(Z) (kOhm)", "Im(Z) (kOhm)"), ("Z'/Ω", "-Z''/Ω"), ("resistance", "reactance")],
    "y_deg": [("|Y| (mS)", "theta (deg)"), ("Ymag [µS]", "thetaY [deg]"), ("Magnitude (S)", "Phase (deg)")],
    "gb": [("G (S)", "B (S)"), ("conductance (uS)", "susceptance (mS)"), ("Re(Y) (nS)", "Im(Y) (nS)")],
}
FREQUENCY_NAMES = ("f (Hz)", "Frequency [kHz]", "freq/MHz", "frequency_Hz", "Frequency", "f in GHz", "FREQ(KHZ)")


def read_text(folder: Path, text: str, encoding: str = "utf-8", **options) -> ImpedanceSpectrum:
    path = folder / "sweep.txt"
    path.write_bytes(text.encode(encoding))
    return read_spectrum(path, **options)


def assert_same(spectrum: ImpedanceSpectrum, rtol: float = 1e-12) -> None:
    assert len(spectrum) == FREQUENCY.size
    np.testing.assert_allclose(spectrum.frequency, FREQUENCY, rtol=rtol)
    assert np.max(np.abs(spectrum.impedance / IMPEDANCE - 1)) < 10 * rtol


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None, max_examples=250)
@given(st.data())
def test_any_dialect_reads_the_same_numbers(tmp_path: Path, data: st.DataObject) -> None:
    pair = data.draw(st.sampled_from(sorted(HEADERS)))
    names = [data.draw(st.sampled_from(FREQUENCY_NAMES)), *data.draw(st.sampled_from(HEADERS[pair]))]
    scales = [parse_column(name).scale if pair[:1] not in "zy" or i < 2 else None for i, name in enumerate(names)]
    columns = [FREQUENCY, *columns_of(FREQUENCY, IMPEDANCE, pair)]
    if scales[2] is None:
        scales[2] = 1e-3 if "mrad" in names[2] else 1.0  # columns_of gives the unit of the header already
    columns = [column / scale for column, scale in zip(columns, scales, strict=True)]
    order = data.draw(st.permutations(range(3)))
    delimiter = data.draw(st.sampled_from([",", ";", "\t", ", ", "   "]))
    comma = delimiter in (";", "\t") and data.draw(st.booleans())
    quoted = data.draw(st.booleans()) or delimiter == "   "
    comment = data.draw(st.sampled_from(["", "# ", "% ", "! "]))
    header = delimiter.join(f'"{names[i]}"' if quoted else names[i] for i in order)
    rows = [delimiter.join(repr(float(columns[i][k])) for i in order) for k in range(FREQUENCY.size)]
    if comma:
        rows = [row.replace(".", ",") for row in rows]
    if data.draw(st.booleans()):
        rows.insert(7, "# a remark, 1, 2")
        rows.insert(9, "")
    before = data.draw(st.sampled_from([[], ["instrument X, 2020", ""], ["# made by hand"]]))
    lines = [*before, comment + header, *rows, ""]
    text = data.draw(st.sampled_from(["\n", "\r\n", "\r"])).join(lines)
    assert_same(read_text(tmp_path, text, data.draw(st.sampled_from(["utf-8", "utf-8-sig", "utf-16", "utf-16-le"]))))


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None, max_examples=40)
@given(st.integers(8, 60), st.booleans(), st.integers(0, 2**31))
def test_our_csv_keeps_every_bit(tmp_path: Path, points: int, noisy: bool, seed: int) -> None:
    rng = np.random.default_rng(seed)
    frequency = np.sort(rng.uniform(1e4, 1e6, points))
    impedance = bar_impedance(frequency, **SOFT)
    noise = rng.uniform(1e-3, 1, points) if noisy else None
    path = tmp_path / "impedance.csv"
    write_spectrum(ImpedanceSpectrum(frequency, impedance, noise), path)
    assert path.read_text().splitlines()[0].startswith("frequency_Hz,resistance_ohm,reactance_ohm")
    spectrum = read_spectrum(path)
    np.testing.assert_array_equal(spectrum.frequency, frequency)
    np.testing.assert_array_equal(spectrum.impedance, impedance)
    assert (spectrum.noise is None) == (noise is None)
    if noisy:
        np.testing.assert_array_equal(spectrum.noise, noise)
    assert [entry.name for entry in tmp_path.iterdir()] == ["impedance.csv"]


@pytest.mark.parametrize(("unit", "read"), [("ohm", True), ("%", False), ("dB", False)])
def test_noise_in_another_unit_than_ohm_is_left_out_with_a_note(tmp_path: Path, unit: str, read: bool) -> None:
    columns = (FREQUENCY, bar_impedance(FREQUENCY, **SOFT).real, bar_impedance(FREQUENCY, **SOFT).imag)
    rows = [",".join([*(repr(float(column[k])) for column in columns), "0.2"]) for k in range(FREQUENCY.size)]
    spectrum = read_text(tmp_path, "\n".join([f"frequency (Hz),R (ohm),X (ohm),noise ({unit})", *rows, ""]))
    assert (spectrum.noise is not None) == read
    assert any(f"noise ({unit}) is not read" in note for note in spectrum.notes) == (not read)


@pytest.mark.parametrize(
    ("parameter", "pair"),
    [
        ("IMPEDANCE MAG PHASE (DEG)", "z_deg"),
        ("IMPEDANCE MAG PHASE (RAD)", "z_rad"),
        ("|Z|-theta", "z_deg"),
        ("ADMITTANCE MAG PHASE (DEG)", "y_deg"),
        ("R-X", "rx"),
        ("IMPEDANCE REAL IMAG", "rx"),
        ("G-B", "gb"),
    ],
)
def test_4294a(tmp_path: Path, parameter: str, pair: str) -> None:
    assert_same(read_text(tmp_path, write_4294a(FREQUENCY, *columns_of(FREQUENCY, IMPEDANCE, pair), parameter)), 1e-11)


def test_4294a_faults(tmp_path: Path) -> None:
    pair = columns_of(FREQUENCY, IMPEDANCE, "z_deg")
    text = write_4294a(FREQUENCY, *pair, "IMPEDANCE MAG PHASE (DEG)")
    lines = text.splitlines()
    for wrong, told in (
        (write_4294a(FREQUENCY, *pair, "CP-D"), "measure parameter 'CP-D' is not understood"),
        (write_4294a(FREQUENCY, *pair, "|Z|-Rs"), r"measure parameter '\|Z\|-Rs' is not understood"),
        (write_4294a(FREQUENCY, *pair, "|Z| - Q"), r"measure parameter '\|Z\| - Q' is not understood"),
        (write_4294a(FREQUENCY, *pair, "IMPEDANCE MAG PHASE (DEG)", "LIN OSC"), "over frequency"),
        ("\n".join(lines[:60]), "points where the head says 41|two are needed"),
        ("\n".join(lines[:40]) + "\n", "points where the head says 41"),
        (text.replace("Data Trace Real", "Memory Trace Real"), "Data Trace Real"),
    ):
        with pytest.raises(InputError, match=told):
            read_text(tmp_path, wrong)


@pytest.mark.parametrize(
    ("names", "pair"),
    [
        ("|Z|(Ohm)-data, theta-z(deg)-data", "z_deg"),
        ("R(Ohm)-data, X(Ohm)-data", "rx"),
        ("Z-Real(Ohm)-data, Z-Imag(Ohm)-data", "rx"),
        ("G(S)-data, B(S)-data", "gb"),
        ("Y-Real(S)-data, Y-Imag(S)-data", "gb"),
        ("|Y|(S)-data, theta-y(deg)-data", "y_deg"),
    ],
)
@pytest.mark.parametrize("memory", [False, True])
def test_e4990a(tmp_path: Path, names: str, pair: str, memory: bool) -> None:
    text = write_e4990a(FREQUENCY, *columns_of(FREQUENCY, IMPEDANCE, pair), names, memory)
    assert_same(read_text(tmp_path, text))
    with pytest.raises(InputError, match="names its columns itself; leave columns out"):
        read_text(tmp_path, text, columns=["Frequency (Hz)", "R (Ohm)", "X (Ohm)"])
    with pytest.raises(InputError, match="no END"):
        read_text(tmp_path, text.removesuffix("END\n"))
    other = write_e4990a(FREQUENCY, FREQUENCY, FREQUENCY, "Cp(F)-data, D()-data").replace("CH1", "CH2")
    both = read_text(tmp_path, other + text)
    assert_same(both)
    assert "2 channels" in both.notes[0]


@pytest.mark.parametrize(
    "head",
    [
        ["Frequency,R,X", "kHz,Ohm,Ohm"],
        ["Frequency,R,X,point", "khertz,Ohm,Ohm,-"],
        ["Frequency,R,X,point", "kHz,Ohm,Ohm,"],
        ["Frequency (kHz),R,X", "kHz,Ohm,Ohm"],
        ["frequency_kHz,resistance_ohm,reactance_ohm", "[kHz],[Ω],[Ω]"],
        ["Frequency (kHz),R,X", ",Ohm,Ohm"],
        ["Frequency (kHz),R (Ohm),X (Ohm),Temperature (°C)", "kHz,Ohm,Ohm,°C"],
        ["kHz,Ohm,Ohm", "Frequency,R,X"],
    ],
)
@pytest.mark.parametrize("delimiter", [",", ";", "\t"])
def test_a_row_of_units_below_the_names(tmp_path: Path, head: list[str], delimiter: str) -> None:
    """Units may stand below names, or above, also where the names state them as well, and in comments."""
    r, x = columns_of(FREQUENCY, IMPEDANCE, "rx")
    columns = [(FREQUENCY / 1e3).tolist(), r.tolist(), x.tolist(), list(range(FREQUENCY.size))]
    rows = [delimiter.join(map(repr, row)) for row in zip(*columns[: head[0].count(",") + 1], strict=True)]
    for comment in ("", "# "):
        lines = [comment + line.replace(",", delimiter) for line in head]
        assert_same(read_text(tmp_path, "\n".join([*lines, *rows, ""])))


def test_units_of_a_capacitance_and_in_brackets_alone(tmp_path: Path) -> None:
    """F below Cp is farad and no frequency; brackets between blanks are cells of their own."""
    y = 1 / IMPEDANCE
    columns = FREQUENCY, y.imag / (2 * np.pi * FREQUENCY), y.real / y.imag
    rows = [f"{f!r},{c!r},{d!r}" for f, c, d in zip(*(one.tolist() for one in columns), strict=True)]
    for below in ("Hz,F,-", "Hz,F,"):
        assert_same(read_text(tmp_path, "\n".join(["Frequency,Cp,D", below, *rows, ""])))
    r, x = columns_of(FREQUENCY, IMPEDANCE, "rx")
    rows = [f"{f!r} {a!r} {b!r}" for f, a, b in zip(FREQUENCY.tolist(), r.tolist(), x.tolist(), strict=True)]
    assert_same(read_text(tmp_path, "\n".join(["Frequency R X", "[Hz] [Ohm] [Ohm]", *rows, ""])))


def test_a_line_between_names_and_numbers_that_is_neither_is_told(tmp_path: Path) -> None:
    r, x = columns_of(FREQUENCY, IMPEDANCE, "rx")
    rows = [f"{f!r},{a!r},{b!r}" for f, a, b in zip(FREQUENCY.tolist(), r.tolist(), x.tolist(), strict=True)]
    for wrong in ("Hz,Ohm,dB", "1000,5x,3"):
        with pytest.raises(InputError, match=f"'{wrong}' below the names of the columns is neither"):
            read_text(tmp_path, "\n".join(["Frequency,R,X", wrong, *rows, ""]))


def test_units_that_contradict_the_names_are_told(tmp_path: Path) -> None:
    r, x = columns_of(FREQUENCY, IMPEDANCE, "rx")
    rows = [f"{f!r},{a!r},{b!r}" for f, a, b in zip(FREQUENCY.tolist(), r.tolist(), x.tolist(), strict=True)]
    for below, told in (("kHz,ohm,ohm", "'Frequency \\(Hz\\)'.* 'kHz'"), ("Hz,kohm,ohm", "'R \\(ohm\\)'.* 'kohm'")):
        with pytest.raises(InputError, match=f"the header says {told}; correct one"):
            read_text(tmp_path, "\n".join(["Frequency (Hz),R (ohm),X (ohm)", below, *rows, ""]))


def rows_with_words(delimiter: str = ",") -> list[str]:
    """Rows of a list sweep with a number in front and the verdict of a limit test at the end."""
    pair = columns_of(FREQUENCY, IMPEDANCE, "z_deg")
    return [
        delimiter.join(map(str, (number, *values, "OK" if number % 3 else "NG")))
        for number, values in enumerate(zip(FREQUENCY.tolist(), *(one.tolist() for one in pair), strict=True), 1)
    ]


@pytest.mark.parametrize("delimiter", [",", ";", "\t"])
@pytest.mark.parametrize("comma", [False, True])
@pytest.mark.parametrize("end", ["\n", ",\n"])
def test_a_column_of_words_is_left_out_with_a_note(tmp_path: Path, delimiter: str, comma: bool, end: str) -> None:
    rows = rows_with_words(delimiter)
    if comma and delimiter != ",":
        rows = [row.replace(".", ",") for row in rows]
    head = ["HIOKI,IM3570", "Date,2024/01/01", delimiter.join(("No", "FREQ[Hz]", "Z[ohm]", "PHASE[deg]", "JUDGE"))]
    end = end.replace(",", delimiter)
    spectrum = read_text(tmp_path, end.join([*head, *rows, ""]))
    assert_same(spectrum)
    assert spectrum.notes[0] == "the column 'JUDGE' holds words and is not used"


def test_words_in_columns_of_numbers_are_told(tmp_path: Path) -> None:
    """One word among numbers is named with its line, also where another column holds words alone."""
    rows, names = rows_with_words(), ["", "f (Hz)", "Z (ohm)", "theta (deg)", ""]
    head = "No,FREQ[Hz],Z[ohm],PHASE[deg],JUDGE"
    assert_same(read_text(tmp_path, "\n".join([*rows, ""]), columns=names))
    for at in (0, 5):
        cells = rows[at].split(",")
        lines = [head, *rows[:at], ",".join([*cells[:2], "OVLD", *cells[3:]]), *rows[at + 1 :], ""]
        with pytest.raises(InputError, match=f"line {at + 2}: 'OVLD' is not a number"):
            read_text(tmp_path, "\n".join(lines))
    for text, options, told in (
        (
            [head.replace("JUDGE", "X (ohm)"), *rows],
            {},
            r"line 2: the column 'X \(ohm\)' holds words in every row",
        ),
        (rows, {"columns": names[1:4]}, "names 3 columns .* and the rows have 5"),
        (rows, {}, "header must say what the 5 columns are"),
    ):
        with pytest.raises(InputError, match=told):
            read_text(tmp_path, "\n".join([*text, ""]), **options)
    numbers = [",".join(row.split(",")[:4]) for row in rows]
    numbers[7] = numbers[7].replace(numbers[7].split(",")[2], "OVLD")
    with pytest.raises(InputError, match="line 9: 'OVLD' is not a number"):
        read_text(tmp_path, "\n".join(["No,FREQ[Hz],Z[ohm],PHASE[deg]", *numbers, ""]))


@pytest.mark.parametrize(
    ("header", "told"),
    [
        ("u,v,w", "header must say"),
        ("", "header must say"),
        ("frequency_Hz,resistance_ohm", "header must say"),
        ("frequency_Hz,R (kHz),X (ohm)", "no complete pair"),
        ("frequency_Hz,Cp (F),X (ohm)", "no complete pair"),
        ("frequency_Hz,R (ohm),R (ohm)", "no complete pair"),
        ("Hz,R (ohm),X (ohm)", "as the frequency"),
        ("frequency_Hz,Magnitude,theta (deg)", "no complete pair"),
    ],
)
def test_columns_of_unclear_meaning_are_refused(tmp_path: Path, header: str, told: str) -> None:
    rows = [f"{f:.3f},{z.real!r},{z.imag!r}" for f, z in zip(FREQUENCY, IMPEDANCE.tolist(), strict=True)]
    with pytest.raises(InputError, match=told) as caught:
        read_text(tmp_path, "\n".join([header, *rows, ""]))
    assert "a sweep needs columns of frequency" in str(caught.value)


def test_a_long_file(tmp_path: Path) -> None:
    frequency = np.linspace(1e3, 5e5, 100_000)
    spectrum = ImpedanceSpectrum(frequency, bar_impedance(frequency, **SOFT))
    write_spectrum(spectrum, tmp_path / "long.csv")
    np.testing.assert_array_equal(read_spectrum(tmp_path / "long.csv").impedance, spectrum.impedance)


def test_a_damaged_first_row_is_not_skipped(tmp_path: Path) -> None:
    rows = [f"{f!r},{z.real!r},{z.imag!r}" for f, z in zip(FREQUENCY.tolist(), IMPEDANCE.tolist(), strict=True)]
    rows[0] = rows[0].replace(",", ",x", 1)
    with pytest.raises(InputError, match="is neither a row of numbers"):
        read_text(tmp_path, "\n".join(["frequency_Hz,resistance_ohm,reactance_ohm", *rows, ""]))


@pytest.mark.parametrize("form", ["{}", "{:.6f}", "{:.8e}", "{:.9g}"])
def test_a_last_line_without_end_is_whole_or_refused(tmp_path: Path, form: str) -> None:
    rows = [
        ",".join(form.format(value) for value in (f, z.real, z.imag))
        for f, z in zip(FREQUENCY.tolist(), IMPEDANCE.tolist(), strict=True)
    ]
    text = "\n".join(["frequency_Hz,resistance_ohm,reactance_ohm", *rows])
    assert_same(read_text(tmp_path, text), 1e-7)
    with pytest.raises(InputError, match=r"line 42: .*(file ends|numbers where)"):
        read_text(tmp_path, text[:-7])


BODE_100 = "Frequency (Hz);Trace 1: Impedance: Magnitude (Ω);Trace 2: Impedance: Phase (°)"
WAVEFORMS = "Frequency (Hz),Trace θ (deg),Trace |Z| (Ohm)"


def _rows(columns, delimiter: str, comma: bool = False) -> list[str]:
    rows = [delimiter.join(repr(float(value)) for value in row) for row in zip(*columns, strict=True)]
    return [row.replace(".", ",") for row in rows] if comma else rows


def test_bode_100_with_decimal_commas(tmp_path: Path) -> None:
    z, theta = columns_of(FREQUENCY, IMPEDANCE, "z_deg")
    assert_same(read_text(tmp_path, "\n".join([BODE_100, *_rows((FREQUENCY, z, theta), ";", True), ""])))
    real = BODE_100.replace("Magnitude", "Real").replace("Phase (°)", "Imaginary (Ω)")
    r, x = columns_of(FREQUENCY, IMPEDANCE, "rx")
    assert_same(read_text(tmp_path, "\n".join([real, *_rows((FREQUENCY, r, x), ";", True), ""])))


def test_waveforms(tmp_path: Path) -> None:
    z, theta = columns_of(FREQUENCY, IMPEDANCE, "z_deg")
    r, x = columns_of(FREQUENCY, IMPEDANCE, "rx")
    head = ["#Digilent WaveForms Impedance Analyzer", "#Device Name: Discovery2", "#Reference: 1 kOhm", ""]
    assert_same(read_text(tmp_path, "\n".join([*head, WAVEFORMS, *_rows((FREQUENCY, theta, z), ","), ""])))
    every = WAVEFORMS + ",Trace Rs (Ohm),Trace Xs (Ohm)"
    assert_same(read_text(tmp_path, "\n".join([*head, every, *_rows((FREQUENCY, theta, z, r, x), ","), ""])))


OMEGA = 2 * np.pi * FREQUENCY
Y = 1 / IMPEDANCE
LCR = {
    "Cp (pF),D": (Y.imag / OMEGA * 1e12, Y.real / Y.imag),
    "Cp[F],Q": (Y.imag / OMEGA, Y.imag / Y.real),
    "Cp (nF),Rp (kOhm)": (Y.imag / OMEGA * 1e9, 1e-3 / Y.real),
    "Cp (F),G (uS)": (Y.imag / OMEGA, 1e6 * Y.real),
    "Cs (nF),D": (-1e9 / (OMEGA * IMPEDANCE.imag), -IMPEDANCE.real / IMPEDANCE.imag),
    "Cs (F),Q": (-1 / (OMEGA * IMPEDANCE.imag), -IMPEDANCE.imag / IMPEDANCE.real),
    "Cs (uF),Rs (Ohm)": (-1e6 / (OMEGA * IMPEDANCE.imag), IMPEDANCE.real),
    "Ls (mH),D": (1e3 * IMPEDANCE.imag / OMEGA, IMPEDANCE.real / IMPEDANCE.imag),
    "Ls (H),Q": (IMPEDANCE.imag / OMEGA, IMPEDANCE.imag / IMPEDANCE.real),
    "Ls (uH),Rs (Ohm)": (1e6 * IMPEDANCE.imag / OMEGA, IMPEDANCE.real),
    "Lp (H),D": (-1 / (OMEGA * Y.imag), -Y.real / Y.imag),
    "Lp (H),Q": (-1 / (OMEGA * Y.imag), -Y.imag / Y.real),
    "Lp (mH),Rp (Ohm)": (-1e3 / (OMEGA * Y.imag), 1 / Y.real),
}


@pytest.mark.parametrize("names", LCR)
def test_list_sweeps_of_lcr_meters(tmp_path: Path, names: str) -> None:
    """By the definitions of an LCR meter: Cp = B/ω, Cs = −1/(ωX), Ls = X/ω, Lp = −1/(ωB), D = 1/Q = R/|X| = G/|B|."""
    table = _rows((FREQUENCY / 1e3, *LCR[names]), ",")
    assert_same(read_text(tmp_path, "\n".join([f"Freq[kHz],{names}", *table, ""])), 1e-11)


def test_a_list_sweep_with_a_german_header(tmp_path: Path) -> None:
    columns = (FREQUENCY, Y.imag / OMEGA, Y.real / Y.imag)
    assert_same(read_text(tmp_path, "\n".join(["Frequenz (Hz);Cp (F);D", *_rows(columns, ";", True), ""])), 1e-11)


def _formatted(second) -> str:
    rows = [f"{f:+.11e}, {p:+.15e}, {q:+.15e}" for f, p, q in zip(FREQUENCY, IMPEDANCE.real, second, strict=True)]
    return "\n".join(['"# Channel 1"', '"# Trace 1"', "Frequency, Formatted Data, Formatted Data", *rows, ""])


def test_e5061b_trace_needs_to_be_told_what_it_is(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"Frequency, Formatted Data, Formatted Data and does not say"):
        read_text(tmp_path, _formatted(IMPEDANCE.imag))
    names = ["Frequency (Hz)", "R (Ohm)", "X (Ohm)"]
    assert_same(read_text(tmp_path, _formatted(IMPEDANCE.imag), columns=names), 1e-10)
    with pytest.raises(InputError, match="only one part of the impedance"):
        read_text(tmp_path, _formatted(0 * FREQUENCY), columns=names)


def test_columns_name_those_of_any_table(tmp_path: Path) -> None:
    r, x = columns_of(FREQUENCY, IMPEDANCE, "rx")
    table = _rows((np.arange(41), FREQUENCY / 1e3, r, x), "\t", True)
    text = "\n".join(["no name", "u\tv\tw\ty", *table, ""])
    with pytest.raises(InputError, match=r"none of the columns \(u, v, w, y\) .*columns = \["):
        read_text(tmp_path, text)
    assert_same(read_text(tmp_path, text, columns=["", "f (kHz)", "R (Ohm)", "X (Ohm)"]))
    with pytest.raises(InputError, match=r"names 3 columns .* 4 numbers"):
        read_text(tmp_path, text, columns=["f (kHz)", "R (Ohm)", "X (Ohm)"])


def test_decimal_commas_in_quotes_between_commas(tmp_path: Path) -> None:
    """As spreadsheets with European settings export; commas that may separate thousands are refused."""
    columns = np.column_stack([FREQUENCY, *columns_of(FREQUENCY, IMPEDANCE, "rx")]).tolist()
    rows = (",".join(f'"{v!r}"'.replace(".", ",") for v in row) for row in columns)
    text = '"Frequency (Hz)","R (Ohm)","X (Ohm)"\n' + "\n".join(rows) + "\n"
    np.testing.assert_allclose(read_text(tmp_path, text).impedance, IMPEDANCE, rtol=1e-12)
    thousands = 'Frequency (Hz),R (Ohm),X (Ohm)\n"30,000",12.5,-80\n"31,000",12.4,-79\n"32,000",12.3,-78\n'
    with pytest.raises(InputError, match="may be a decimal comma or separate thousands"):
        read_text(tmp_path, thousands)
