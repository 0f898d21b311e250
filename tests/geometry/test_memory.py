"""Counts and numbers in a damaged mesh file cannot make the reader allocate gigabytes."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from femu_piezo.geometry.memory import memory_limit

MESH = """$MeshFormat
4.1 0 8
$EndMeshFormat
$PhysicalNames
1
3 1 "body"
$EndPhysicalNames
$Entities
0 0 0 1
1 0 0 0 1 1 1 1 1 0
$EndEntities
$Nodes
1 {nodes} 1 4
3 1 0 4
1
2
3
{tag}
0 0 0
1 0 0
0 1 0
0 0 1
$EndNodes
$Elements
1 1 1 1
3 1 4 {elements}
1 1 2 3 {tag}
$EndElements
"""

READ = """
import resource, sys
from pathlib import Path
from femu_piezo.errors import InputError
from femu_piezo.geometry.mesh_file import MeshFile
before = resource.getrlimit(resource.RLIMIT_AS)
try:
    MeshFile(Path(sys.argv[1])).mesh
except InputError as error:
    print(error)
assert resource.getrlimit(resource.RLIMIT_AS) == before
print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3)
"""


def read(path: Path) -> tuple[str, float]:
    """The error message for a mesh in a process of its own, and the largest resident memory of that process, MB."""
    done = subprocess.run([sys.executable, "-c", READ, str(path)], capture_output=True, text=True, check=True)
    sentence, size = done.stdout.strip().split("\n")
    return sentence, float(size)


@pytest.mark.skipif(sys.platform != "linux", reason="limits of address space are those of Linux")
@pytest.mark.parametrize("damage", [{"elements": 400_000_000}, {"tag": 700_000_000}, {"nodes": 200_000_000}], ids=str)
def test_counts_beyond_the_file_are_refused_before_memory_is_taken(damage: dict, tmp_path: Path) -> None:
    sound = {"nodes": 4, "tag": 4, "elements": 1}
    (tmp_path / "x.msh").write_text(MESH.format(**sound), encoding="ascii")
    words, usual = read(tmp_path / "x.msh")
    assert "hot" in words  # the sound file is read to its end, where the electrodes are missing
    (tmp_path / "x.msh").write_text(MESH.format(**sound | damage), encoding="ascii")
    words, size = read(tmp_path / "x.msh")
    assert "by its counts of points and elements this mesh takes more than 256 MB" in words
    assert size < usual + 300


@pytest.mark.skipif(sys.platform != "linux", reason="limits of address space are those of Linux")
def test_the_limit_holds_within_its_block_only() -> None:
    with memory_limit(50_000_000), pytest.raises(MemoryError):
        bytearray(200_000_000)
    assert len(bytearray(200_000_000)) == 200_000_000
