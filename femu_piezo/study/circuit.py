"""`circuit`: a measured sweep, or a specimen as described, to an equivalent circuit."""

from __future__ import annotations

import numpy as np

from femu_piezo.circuits.branch import Branch, element_deviations
from femu_piezo.circuits.circuit import Circuit, fit_circuit
from femu_piezo.errors import InputError
from femu_piezo.extraction import Extraction, extract
from femu_piezo.measurement.spectrum import ImpedanceSpectrum
from femu_piezo.resonances import Resonance
from femu_piezo.specimen.file import Simulation, Specimen
from femu_piezo.study.rational_curve import RationalCurve
from femu_piezo.study.simulate import simulate


def circuit_of_sweep(spectrum: ImpedanceSpectrum) -> Circuit:
    """The circuit of a measured sweep, a branch for each pole within it; InputError where there is none."""
    found = extract(spectrum)
    if found.model is None or not found.resonances.poles:
        raise InputError(
            f"{spectrum.source}: no resonance was found, so there is no branch to make; measure a band that holds one"
        )
    curve = 1 / found.model.admittance(spectrum.omega)
    name = spectrum.source.replace("\\", "/").rsplit("/", 1)[-1].rsplit(".", 1)[0]
    branches = [_measured_branch(found, pole) for pole in found.resonances.poles]
    return fit_circuit(name, branches, spectrum.frequency, curve)


def circuit_of_specimen(specimen: Specimen) -> Circuit:
    """The circuit of a specimen as its file describes it, a branch for each driven mode; errors as of `simulate`."""
    wish = (specimen.simulation or Simulation()).model_copy(update={"noise": 0.0})
    sweep = simulate(specimen.model_copy(update={"simulation": wish})).spectrum
    rational = RationalCurve(sweep.frequency, sweep.impedance)
    inside = [one for one in rational.poles if sweep.frequency[0] <= one.frequency_Hz <= sweep.frequency[-1]]
    if not inside:
        raise InputError(
            f"{specimen.path or specimen.name}: no driven mode lies between {sweep.frequency[0]:.6g} and "
            f"{sweep.frequency[-1]:.6g} Hz; give [simulation] a band that holds one"
        )
    branches = [Branch(one.pole_s, rational.residue_of_admittance(one), {}) for one in inside]
    return fit_circuit(specimen.name, branches, sweep.frequency, sweep.impedance)


def _measured_branch(found: Extraction, pole: Resonance) -> Branch:
    """The branch of an extracted pole with the deviations of its elements."""
    model = found.model
    index = int(np.argmin(np.abs(model.axis.eigenvalue(model.poles) - pole.eigenvalue)))
    p, residue = pole.pole_s, complex(pole.residue)
    if found.spread is None:
        return Branch(p, residue, {})
    units = np.eye(model.size, dtype=complex)
    # λ = center + half_width z and p = j sqrt(λ): dp = −dλ/(2p); the residue of Y is scale half_width r/2
    rows = [
        -model.axis.half_width / (2 * p) * units[index],
        model.scale * model.axis.half_width / 2 * units[model.poles.size + index],
    ]
    return Branch(p, residue, element_deviations(p, residue, found.spread.covariance(np.array(rows))))
