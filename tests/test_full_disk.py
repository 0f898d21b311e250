"""A disk that is full while a command writes: one sentence, exit code 2, and no incomplete file."""

from __future__ import annotations

import json
import resource
import subprocess
import sys
from pathlib import Path

import pytest

from femu_piezo.errors import InputError
from femu_piezo.output.folder import write_binary
from tests.variants import variants

PLATE = Path(__file__).resolve().parents[1] / "tutorials" / "k31_plate"
COMMANDS = {
    "simulate": ("simulate", str(PLATE / "plate.toml")),
    "extract": ("extract", str(PLATE / "sweep.csv")),
    "update": ("update", str(PLATE / "plate.toml"), "--report"),
    "modes": ("modes", str(PLATE / "plate.toml"), "--count", "1", "--vtu", "--mesh"),
    "datasheet": ("datasheet", str(PLATE / "plate.toml")),
}


def run(words: tuple[str, ...], out: Path, largest: int) -> subprocess.CompletedProcess:
    """A command in a process that cannot write files of more than `largest` bytes, which fails as on a full disk.

    It writes no compiled modules, since later processes would take an incomplete one for a complete one.
    """

    def limit() -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (largest, largest))

    return subprocess.run(
        [sys.executable, "-B", "-m", "femu_piezo.cli", *words, "--out", str(out)],
        preexec_fn=limit,
        capture_output=True,
        text=True,
        timeout=300,
    )


@pytest.mark.parametrize("largest", [0, 30_000])
@pytest.mark.parametrize("name", variants(COMMANDS, slow=COMMANDS.keys() - {"simulate", "extract"}))
def test_nothing_is_half_written(name, largest, tmp_path):
    out = tmp_path / "out"
    answer = run(COMMANDS[name], out, largest)
    assert answer.returncode == 2, answer.stderr
    # matplotlib may warn that it cannot keep its list of fonts
    errors = [line for line in answer.stderr.splitlines() if not line.startswith("Could not save font_manager cache")]
    assert len(errors) == 1 and "cannot be written" in errors[0], answer.stderr
    files = sorted(out.rglob("*")) if out.exists() else []
    assert not [path for path in files if ".tmp" in path.name]
    for path in files:
        if path.suffix == ".json":
            json.loads(path.read_text(encoding="utf-8"))
        if path.suffix == ".png":
            assert path.read_bytes().endswith(b"IEND\xaeB`\x82")
        if path.suffix == ".csv":
            assert path.read_text(encoding="utf-8").endswith("\n")


def test_a_picture_is_replaced_as_a_whole(tmp_path):
    write_binary(tmp_path / "x.png", b"old")
    with pytest.raises(InputError, match="cannot be written"):
        write_binary(tmp_path / "none" / "x.png", b"new")
    assert (tmp_path / "x.png").read_bytes() == b"old" and len(list(tmp_path.iterdir())) == 1
