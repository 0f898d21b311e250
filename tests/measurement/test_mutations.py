"""Damaged files: the right numbers, numbers with at most the damaged points wrong, or one clear sentence."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from femu_piezo.errors import InputError
from femu_piezo.measurement.readers import read_spectrum

from .sweeps import SOFT, bar_impedance, columns_of, write_4294a, write_e4990a

FREQUENCY = np.round(np.linspace(30e3, 50e3, 40), 3)
IMPEDANCE = bar_impedance(FREQUENCY, **SOFT)


def originals() -> dict[str, bytes]:
    z_deg = columns_of(FREQUENCY, IMPEDANCE, "z_deg")
    ours = "frequency_Hz,resistance_ohm,reactance_ohm\n" + "".join(
        f"{f!r},{z.real!r},{z.imag!r}\n" for f, z in zip(FREQUENCY.tolist(), IMPEDANCE.tolist(), strict=True)
    )
    rows = "".join(f"{f / 1e3:.6f};{a:.7e};{b:.6f}\r\n" for f, a, b in zip(FREQUENCY, *z_deg, strict=True))
    comma = ("Frequency (kHz);|Z| (Ohm);theta (deg)\r\n" + rows).replace(".", ",")
    return {
        "ours": ours.encode(),
        "decimal comma": comma.encode("utf-16"),
        "4294A": write_4294a(FREQUENCY, *z_deg, "IMPEDANCE MAG PHASE (DEG)").encode(),
        "E4990A": write_e4990a(FREQUENCY, *z_deg, "|Z|(Ohm)-data, theta-z(deg)-data").encode(),
    }


ORIGINALS = originals()
TOKENS = [b"nan", b"inf", b"1e999", b"", b"--", b"0", b"-1", b"1,2", b"\0", b'"', b"9" * 400, b",", b";", b"\n", b"\r"]
IN_ONE_FOLDER = settings(suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None, max_examples=250)


def wrong_points(path: Path) -> int | None:
    """How many points read from `path` differ from the original; None where the file is refused."""
    try:
        spectrum = read_spectrum(path)
    except InputError as error:
        assert "\n" not in str(error)
        assert str(error).startswith(str(path))
        return None
    nearest = np.argmin(np.abs(spectrum.frequency[:, None] - FREQUENCY), axis=1)
    wrong = np.abs(spectrum.frequency / FREQUENCY[nearest] - 1) > 1e-6
    wrong |= np.abs(spectrum.impedance / IMPEDANCE[nearest] - 1) > 1e-4
    return int(wrong.sum())


@pytest.mark.parametrize("name", ORIGINALS)
def test_the_whole_file_is_right(tmp_path: Path, name: str) -> None:
    (tmp_path / "x").write_bytes(ORIGINALS[name])
    assert wrong_points(tmp_path / "x") == 0


@IN_ONE_FOLDER
@given(st.sampled_from(sorted(ORIGINALS)), st.floats(0, 1))
def test_cut_off_files_are_right_or_refused(tmp_path: Path, name: str, part: float) -> None:
    raw = ORIGINALS[name]
    (tmp_path / "x").write_bytes(raw[: int(part * len(raw))])
    assert wrong_points(tmp_path / "x") in (0, None)


@IN_ONE_FOLDER
@given(st.sampled_from(sorted(ORIGINALS)), st.data())
def test_damage_stays_where_it_is(tmp_path: Path, name: str, data: st.DataObject) -> None:
    raw = bytearray(ORIGINALS[name])
    changes = data.draw(st.integers(1, 3))
    for _ in range(changes):
        start = data.draw(st.integers(0, len(raw)))
        stop = min(len(raw), start + data.draw(st.integers(0, 8)))
        raw[start:stop] = data.draw(st.binary(max_size=6) | st.sampled_from(TOKENS))
    (tmp_path / "x").write_bytes(bytes(raw))
    wrong = wrong_points(tmp_path / "x")
    in_header = bytes(raw[:200]) != ORIGINALS[name][:200]
    assert wrong is None or wrong <= 2 * changes or in_header


@IN_ONE_FOLDER
@given(st.binary(max_size=400) | st.text(max_size=200).map(str.encode))
def test_random_bytes_are_refused(tmp_path: Path, raw: bytes) -> None:
    (tmp_path / "x").write_bytes(raw)
    assert wrong_points(tmp_path / "x") is None
