"""Make sweep.csv: the simulated measurement of the paper's target plate (Cong et al. 2022, Table 1).

The sweep comes from another discretisation than that of the update: linear hexahedra of 1/8 mm and a direct solve
at every frequency. Takes about half an hour: python tutorials/k31_plate/make_sweep.py
"""

from pathlib import Path

import numpy as np

from femu_piezo.forward.model import ElectroelasticModel
from femu_piezo.forward.response import full_impedance
from femu_piezo.geometry.shapes import Plate
from femu_piezo.material.constants import EPS0
from femu_piezo.material.simplified import SimplifiedK31
from femu_piezo.measurement.readers import write_spectrum
from femu_piezo.measurement.spectrum import ImpedanceSpectrum

TARGET = SimplifiedK31(
    s11=15.84e-12 * (1 - 0.016j),
    d31=-293.25e-12 * (1 - 0.013j),
    eps33T=2422.5 * EPS0 * (1 - 0.015j),
    s12=-4.5e-12,
)

if __name__ == "__main__":
    plate = Plate(40e-3, 5e-3, 1e-3)
    model = ElectroelasticModel(plate.domain((160, 20, 4)), 7900.0, order=1)
    frequency = np.arange(100.0, 50e3 + 1, 100.0)
    impedance = full_impedance(model, TARGET.full().to_e_form(), frequency)
    write_spectrum(ImpedanceSpectrum(frequency, impedance), Path(__file__).parent / "sweep.csv")
