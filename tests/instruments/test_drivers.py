"""The drivers against a simulated analyser in another process, through pyvisa."""

from __future__ import annotations

import re

import numpy as np
import pytest

from femu_piezo.errors import InputError, InstrumentError
from femu_piezo.instruments.analyser import Settings
from femu_piezo.instruments.connect import DRIVERS, connect
from femu_piezo.instruments.simulated import DIALECTS
from femu_piezo.specimen.file import Limits, read_specimen
from femu_piezo.study.simulate import simulate
from instruments.conftest import PLATE, Running, analyser

LIMITS = Limits(voltage=0.6, frequency=(1e3, 180e3))
FAST = Settings(speed=5, timeout=2.0)
FREQUENCY = np.concatenate([np.linspace(60e3, 170e3, 23), [118123.456, 119000.001, 121777.7]])


@pytest.fixture(scope="module", params=["E4990A", "4294A"])
def either(request, plate):
    """Model and running analyser, for both dialects."""
    with analyser(plate, "--model", request.param) as running:
        yield request.param, running


def expected(plate, frequency: np.ndarray) -> np.ndarray:
    """Z of the specimen with its series resistance, ohm."""
    found = simulate(read_specimen(plate))
    return np.interp(frequency, found.spectrum.frequency, np.abs(found.spectrum.impedance))


def test_a_list_of_frequencies_comes_back_measured(either, plate):
    """Both dialects, rising and falling; magnitudes are those of the specimen within gain error, noise and
    interpolation.
    """
    model, running = either
    with connect(running.address, LIMITS, FAST) as one:
        assert model in one.identity and one.compensation == "open on, short on, load off"
        up, down = one.sweep(FREQUENCY), one.sweep(FREQUENCY, 0.2, rising=False)
    assert np.all(np.isin(np.round(FREQUENCY, 3), np.round(up.frequency, 3)))
    assert np.array_equal(up.frequency, down.frequency) and len(up) <= FREQUENCY.size + 1
    assert np.abs(np.log(np.abs(up.impedance) / expected(plate, up.frequency))) == pytest.approx(0, abs=0.02)
    assert np.abs(up.impedance / down.impedance - 1) == pytest.approx(0, abs=5e-3)


def test_more_points_than_a_list_takes_are_several_sweeps(either):
    model, running = either
    frequency = 60e3 + 100e3 * np.sort(np.random.default_rng(1).uniform(size=101))
    triggers = {"E4990A": ":TRIG:SING", "4294A": "SING"}[model]
    before = running.commands().count(triggers)
    with connect(running.address, LIMITS, FAST) as one:
        found = one.sweep(frequency)
    assert np.all(np.isin(np.round(frequency, 3), np.round(found.frequency, 3)))
    driver = DIALECTS[model][0]
    assert running.commands().count(triggers) - before >= -(-101 // (2 * driver.most_segments))


def test_only_commands_of_the_table_are_sent(either):
    model, running = either
    with connect(running.address, LIMITS, Settings(averages=4, timeout=2.0)) as one:
        one.sweep(FREQUENCY[:4])
    table = DIALECTS[model][0].commands.values()
    known = [re.compile(".+".join(map(re.escape, re.split(r"\{[^}]*\}", one.text)))) for one in table]
    assert all(any(one.fullmatch(line) for one in known) for line in running.commands())


def test_every_command_names_its_source():
    for driver in DRIVERS:
        assert all(one.text and one.source and one.seen in ("text", "driver", "") for one in driver.commands.values())


def test_nothing_beyond_the_limits_is_set(bench):
    before = len(bench.commands())
    for limits, settings, words in (
        (Limits(), Settings(voltage=0.51), r"0\.51 V is above limits\.voltage = 0\.5 V"),
        (Limits(voltage=3.0), Settings(voltage=2.0), r"outside the 0\.005 … 1 V of the E4990A"),
        (Limits(), Settings(bias=1.0), r"bias of 1 V is above the 0 V that limits\.bias"),
    ):
        with pytest.raises(InputError, match=words):
            connect(bench.address, limits, settings)
    assert set(bench.commands()[before:]) == {"*IDN?"}
    for frequency in ([500.0, 2e3], [170e3, 181e3]):
        with connect(bench.address, LIMITS, FAST) as one, pytest.raises(InputError, match=r"limits\.frequency"):
            one.sweep(np.array(frequency))
    with connect(bench.address, LIMITS, FAST) as one, pytest.raises(InputError, match=r"limits\.voltage"):
        one.sweep(FREQUENCY, 0.7)
    assert bench.largest_voltage() <= 0.6 and bench.is_off()


def test_a_bias_within_the_limits_is_switched_on_and_off(bench):
    with connect(bench.address, Limits(bias=5.0), Settings(bias=3.0)) as one:
        one.sweep(FREQUENCY[:4])
        assert bench.last(r":SOUR:BIAS:STAT (\w+)") == "ON" and bench.last(r":SOUR1:BIAS:VOLT (\S+)") == "3"
    assert bench.is_off()


def test_an_unknown_instrument_and_an_address_with_none(bench, monkeypatch):
    for place in ("127.0.0.1::1", "nowhere.invalid::5025", "127.0.0.1::99999", "127.0.0.1::abc"):
        with pytest.raises(InstrumentError, match="cannot be reached"):
            connect(f"TCPIP::{place}::SOCKET", LIMITS, FAST)
    with pytest.raises(InstrumentError, match=r"cannot be reached \(a VISA address is such as TCPIP"):
        connect("nonsense", LIMITS, FAST)
    monkeypatch.setattr("femu_piezo.instruments.connect.DRIVERS", DRIVERS[1:])
    with pytest.raises(InputError, match=r"there is no driver; use one of 4294A"):
        connect(bench.address, LIMITS, FAST)


def test_broken_clients_do_not_harm_the_analyser(bench):
    bench.raw(b":SENS1:SEGM:DATA " + b"7," * 600_000)  # longer than any valid line, and without an end
    bench.raw(b":TRIG")
    wrong = b"\xff\xfe\x00garbage\n:SOUR1:VOLT\n:SOUR1:VOLT soon\n:SENS1:SEGM:DATA 7,0\n:CALC1:PAR9:SEL\n"
    told = bench.raw(b"*CLS\n" + wrong + b":SYST:ERR?\n" * 6, reads=6).decode().splitlines()
    undefined, wrong_data = '-113,"Undefined header"', '-104,"Data type error"'
    assert told == [undefined, undefined, wrong_data, wrong_data, wrong_data, '+0,"No error"']
    with connect(bench.address, LIMITS, FAST) as one:
        assert len(one.sweep(FREQUENCY[:6])) == 6


@pytest.fixture(scope="module")
def failing(plate) -> Running:
    kinds = ("error", "half", "timeout", "overload", "unplugged")
    with analyser(plate, *(word for n, kind in enumerate(kinds, 1) for word in ("--fail", f"{kind}@{n}"))) as running:
        yield running


def test_every_fault_is_a_sentence_and_the_output_is_off(failing):
    """Five sweeps with one fault each; the sixth is sound again."""
    for words in (
        r"reports -222,\"Data out of range\" after the sweep",
        r"gave no whole answer to ':CALC1:DATA:FDAT\?' within 1 s",
        r"gave no whole answer to '\*OPC\?'",
        r"marks \d+ of 12 values as not measured \(overload\).*lower --voltage",
        r"gave no whole answer|broke",  # pyvisa-py waits for the timeout where other libraries fail at once
    ):
        settings = Settings(speed=1, timeout=1.0)
        with pytest.raises(InstrumentError, match=words) as told, connect(failing.address, LIMITS, settings) as one:
            one.sweep(FREQUENCY[:6])
        assert "the same command goes on from there" in str(told.value) and "\n" not in str(told.value)
        assert told.value.exit_code == 4 and failing.is_off()
    with connect(failing.address, LIMITS, FAST) as one:
        assert len(one.sweep(FREQUENCY[:6])) == 6


def test_an_unreachable_analyser_may_still_have_its_output_on(plate):
    with analyser(plate) as running:
        one = connect(running.address, LIMITS, FAST)
        one.__enter__()
    with pytest.raises(InstrumentError, match=r"may still be on, switch it off at the instrument"):
        one.__exit__(None, None, None)


def test_ctrl_c_switches_the_output_off(bench):
    with pytest.raises(KeyboardInterrupt), connect(bench.address, LIMITS, FAST) as one:
        one.sweep(FREQUENCY[:4], 0.3)
        raise KeyboardInterrupt
    assert bench.is_off()


def test_limits_of_a_specimen_file(tmp_path):
    path = tmp_path / "plate.toml"
    path.write_text(PLATE, encoding="utf-8")
    read = read_specimen(path)
    assert read.limits == Limits(voltage=0.6, bias=0.0, frequency=(1e3, 180e3))
    read.write(tmp_path / "again.toml")
    assert read_specimen(tmp_path / "again.toml").limits == read.limits
    for wrong, words in (
        ('voltage = "0.6 V"|voltage = "-1 V"', r"limits\.voltage: \"-1 V\" is outside"),
        ('"180 kHz"]|"1 Hz"]', r"limits\.frequency = \[1000, 1\] Hz is not a band"),
        ("[limits]|[limits]\nbias = -2", r"limits\.bias: -2 is outside"),
        ("[limits]|[limits]\ncurrent = 1", r"limits\.current is not a key"),
    ):
        path.write_text(PLATE.replace(*wrong.split("|")), encoding="utf-8")
        with pytest.raises(InputError, match=words):
            read_specimen(path)
