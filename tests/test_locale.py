"""Language, encoding and time zone of the machine change nothing that is computed or written."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

SWEEP = Path(__file__).resolve().parents[1] / "tutorials" / "k31_plate" / "sweep.csv"
PLAIN = {"LC_ALL": "POSIX", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}


def extraction(out: Path, environment: dict[str, str]) -> bytes:
    """extraction.json of the sweep, computed by the command with these environment variables."""
    answer = subprocess.run(
        [sys.executable, "-m", "femu_piezo.cli", "extract", str(SWEEP), "--out", str(out)],
        env=os.environ | environment,
        capture_output=True,
        timeout=120,
    )
    assert answer.returncode == 0 and not answer.stderr, answer.stderr
    return (out / "extraction.json").read_bytes()


@pytest.fixture(scope="module")
def usual(tmp_path_factory) -> bytes:
    """The same without changes of the environment."""
    return extraction(tmp_path_factory.mktemp("usual"), {})


@pytest.mark.parametrize(
    "environment",
    [PLAIN, {"PYTHONIOENCODING": "ascii"}, {"LC_ALL": "de_DE.UTF-8"}, {"LC_ALL": "tr_TR.UTF-8", "TZ": "Asia/Kolkata"}],
    ids=["plain", "ascii", "german", "turkish"],
)
def test_the_result_is_the_same(environment, usual, tmp_path):
    assert extraction(tmp_path, environment) == usual
