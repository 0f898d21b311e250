"""A specimen file with `free = []`: refused where constants are to be found, of no account elsewhere."""

from __future__ import annotations

import pytest

from tests.commands import invoked, succeeded


@pytest.fixture
def spec(sweeps, write_specimen_of):
    effect = '[effects.stray_capacitance]\ncapacitance = "1 pF"\n[simulation]\nstop = "150 kHz"\npoints = 41\n'
    return write_specimen_of("k31", sweeps["k31"], (), extra=effect, lossy=True)


@pytest.mark.parametrize(
    "words",
    [
        ("update",),
        ("update", "--method", "pole-zero"),
        ("diagnose",),
        ("datasheet",),
        ("identify",),
        ("measure", "--plan"),
        ("measure", "--plan", "--data", "{data}"),
    ],
)
def test_commands_that_find_constants_refuse_it_in_one_sentence(spec, tmp_path, words):
    given = [word.format(data=spec.with_suffix(".csv")) for word in words]
    answer = invoked(given[0], spec, *given[1:], "--out", tmp_path / "out")
    assert answer.exit_code == 2, answer.output
    assert "material.free = [] leaves no constant to find" in answer.output
    assert answer.output.strip().count("\n") == 0


@pytest.mark.parametrize("words", [("simulate",), ("modes", "--count", "1"), ("circuit",)])
def test_commands_that_find_none_go_on(spec, tmp_path, words):
    succeeded(words[0], spec, *words[1:], "--out", tmp_path / "out")
