"""Shared fixtures (the paper's plate and materials), and numpy kept to one thread, so that two cores suffice."""

from __future__ import annotations

import ctypes
import os
import sys
from collections import OrderedDict

os.environ.setdefault("OMP_NUM_THREADS", "1")

from pathlib import Path

import pytest

from femu_piezo.geometry.shapes import Plate
from femu_piezo.material.constants import EPS0
from femu_piezo.material.library import library_material
from femu_piezo.material.simplified import SimplifiedK31
from femu_piezo.study.model_cache import Bases
from tests.missing_libraries import skip_without_libraries


@pytest.hookimpl(hookwrapper=True)
def pytest_runtest_makereport(item, call):
    """Tests that need a library which the machine lacks are skipped with a reason."""
    skip_without_libraries((yield).get_result())


@pytest.fixture(autouse=True)
def memory_given_back():
    """Freed memory goes back to the system after each test: glibc keeps what lies below the latest allocations."""
    yield
    if sys.platform == "linux":
        ctypes.CDLL(None).malloc_trim(0)


#: Models and bases of one kind that are kept from test to test.
_KEPT = 12


@pytest.fixture(scope="session", autouse=True)
def bases_kept():
    """Models and bases for exactly equal inputs, of which many tests need the same few, are made once in a process."""
    shelves, within_one = {kind: OrderedDict() for kind in ("model", "rough", "extended")}, Bases._kept

    def kept(bases: Bases, kind: str, key, make):
        def found():
            shelf = shelves[kind]
            one = shelf.pop(key, None)
            shelf[key] = make() if one is None else one
            while len(shelf) > _KEPT:
                shelf.popitem(last=False)
            return shelf[key]

        return within_one(bases, kind, key, found)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Bases, "_kept", kept)
        yield within_one


@pytest.fixture
def bases_not_kept(bases_kept, monkeypatch):
    """For a test of what a command itself keeps."""
    monkeypatch.setattr(Bases, "_kept", bases_kept)


@pytest.fixture(scope="session")
def measured_folder() -> Path:
    """Folder of the measured sweeps; tests that need it are skipped where it is absent."""
    folder = Path(os.environ.get("FEMU_PIEZO_MEASURED", Path(__file__).resolve().parents[2] / "shared" / "measured"))
    if not folder.is_dir():
        pytest.skip(f"measured sweeps are not at {folder}; set FEMU_PIEZO_MEASURED")
    return folder


@pytest.fixture(scope="session")
def paper_plate() -> Plate:
    return Plate(0.040, 0.005, 0.001)


@pytest.fixture(scope="session")
def baseline() -> SimplifiedK31:
    """Baseline of the paper's Table 1."""
    return SimplifiedK31.of(library_material("tj52-hd").constants)


@pytest.fixture(scope="session")
def target() -> SimplifiedK31:
    """Target of the paper's Table 1, with loss."""
    return SimplifiedK31(
        s11=15.84e-12 * (1 - 0.016j),
        d31=-293.25e-12 * (1 - 0.013j),
        eps33T=2422.5 * EPS0 * (1 - 0.015j),
        s12=-4.5e-12,
    )
