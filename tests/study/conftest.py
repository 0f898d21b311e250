"""Specimens whose sweeps come from full solutions at every frequency, on another mesh than any update uses."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from femu_piezo.forward.model import ElectroelasticModel
from femu_piezo.forward.response import full_impedance
from femu_piezo.geometry.shapes import Plate
from femu_piezo.material.constants import PiezoConstants
from femu_piezo.measurement.readers import write_spectrum
from femu_piezo.measurement.spectrum import ImpedanceSpectrum
from femu_piezo.study.model_cache import SharedBases
from tests.materials import LOSSY
from tests.specimens import material, plate

DENSITY = 7500.0

#: Name → body, divisions of the mesh for its data, and band (Hz) around its fundamental.
BODIES = {
    "k31": (Plate(12e-3, 3e-3, 1e-3), (11, 4, 2), (105e3, 140e3)),
    "k33": (Plate(10e-3, 2e-3, 2e-3, "length"), (12, 3, 3), (100e3, 215e3)),
}


@pytest.fixture(scope="session")
def truth() -> PiezoConstants:
    """PZT-5H, fully anisotropic, every constant with its own loss tangent."""
    assert LOSSY.physical_faults() == []
    return LOSSY


def solved(name: str, constants: PiezoConstants) -> ImpedanceSpectrum:
    """Noise-free sweep of a body: 500 Hz, and 60 points around the fundamental."""
    plate, divisions, band = BODIES[name]
    frequency = np.concatenate([[500.0], np.linspace(*band, 60)])
    model = ElectroelasticModel(plate.domain(divisions), DENSITY)
    return ImpedanceSpectrum(frequency, full_impedance(model, constants.to_e_form(), frequency))


@pytest.fixture(scope="session")
def sweep_of():
    """Function (name of a body, constants) → noise-free sweep."""
    return solved


@pytest.fixture(scope="session")
def sweeps(truth) -> dict[str, ImpedanceSpectrum]:
    """Noise-free sweeps of the bodies, each solved when it is first asked for."""

    class Sweeps(dict):
        def __missing__(self, name: str) -> ImpedanceSpectrum:
            self[name] = solved(name, truth)
            return self[name]

    return Sweeps()


@pytest.fixture(scope="module")
def bases() -> SharedBases:
    """Bases of reduced models that the tests of one file share."""
    return SharedBases()


@pytest.fixture
def write_specimen_of(tmp_path, truth):
    """A function that writes specimen file and sweep of a body.

    Free constants are wrong by the given factors, all others true.
    """

    def write(
        name: str,
        sweep: ImpedanceSpectrum,
        free: tuple[str, ...],
        factors=None,
        extra: str = "",
        more: str = "",
        lossy=False,
    ) -> Path:
        body = BODIES[name][0]
        text = plate(name, (body.length, body.width, body.thickness), DENSITY, f'poling = "{body.poling}"')
        text += material(truth, free, factors, () if lossy else free)
        write_spectrum(sweep, tmp_path / f"{name}.csv")
        path = tmp_path / f"{name}.toml"
        path.write_text(f'{text}{extra}\n[measurement]\nfile = "{name}.csv"\n{more}', encoding="utf-8")
        return path

    return write
