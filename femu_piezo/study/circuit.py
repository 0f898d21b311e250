"""`circuit`: a measured sweep, or a specimen as described, to an equivalent circuit."""

from __future__ import annotations

import numpy as np

from femu_piezo.circuits.branch import Branch, element_deviations
from femu_piezo.circuits.circuit import Circuit, fit_circuit
from femu_piezo.errors import InputError
from femu_piezo.extraction import Extraction, extract
from femu_piezo.extraction.order import resonant
from femu_piezo.measurement.rational_curve import RationalCurve
from femu_piezo.measurement.spectrum import ImpedanceSpectrum
from femu_piezo.specimen.file import Simulation, Specimen
from femu_piezo.study.simulate import simulate

#: Relative distance below which a pole of the fitted function and a reported pole are the same.
_SAME = 1e-9


def circuit_of_sweep(spectrum: ImpedanceSpectrum) -> Circuit:
    """The circuit of a measured sweep, a branch for each resonance within it of the function that was fitted to it.

    Poles that the extraction reports as doubtful, or several as one, have a branch each, flagged as doubtful: the curve
    needs them. Clipped readings are left out. InputError where no resonance was found.
    """
    found = extract(spectrum)
    if found.model is None or not found.resonances.poles:
        raise InputError(
            f"{spectrum.source}: no resonance was found, so there is no branch to make; measure a band that holds one"
        )
    spectrum = spectrum.select(found.used)
    curve = 1 / found.model.admittance(spectrum.omega)
    name = spectrum.source.replace("\\", "/").rsplit("/", 1)[-1].rsplit(".", 1)[0]
    branches = [_measured_branch(found, index) for index in np.flatnonzero(resonant(found.model))]
    return fit_circuit(name, branches, spectrum.frequency, curve, spectrum.impedance)


def circuit_of_specimen(specimen: Specimen) -> Circuit:
    """The circuit of a specimen as its file describes it, a branch for each driven mode; errors as of `simulate`."""
    wish = (specimen.simulation or Simulation()).model_copy(update={"noise": 0.0})
    sweep = simulate(specimen.model_copy(update={"simulation": wish})).spectrum
    low, high = float(sweep.frequency[0]), float(sweep.frequency[-1])
    poles = RationalCurve(sweep.frequency, sweep.impedance).resonances("pole", high)
    inside = [one for one in poles if low <= one.frequency_Hz <= high]
    if not inside:
        raise InputError(
            f"{specimen.path or specimen.name}: no driven mode lies between {low:.6g} and "
            f"{high:.6g} Hz; give [simulation] a band that holds one"
        )
    branches = [Branch(one.pole_s, one.residue, {}) for one in inside]
    return fit_circuit(specimen.name, branches, sweep.frequency, sweep.impedance)


def _measured_branch(found: Extraction, index: int) -> Branch:
    """The branch of a pole of the fitted function, by its number, with the deviations of its elements."""
    model = found.model
    value = complex(model.axis.eigenvalue(model.poles[index]))
    sound = any(abs(one.eigenvalue - value) < _SAME * abs(value) for one in found.resonances.poles)
    p = complex(1j * np.sqrt(value))
    # λ = center + half_width z and p = j sqrt(λ): dp = −dλ/(2p); the residue of Y is scale half_width r/2
    residue = complex(model.scale * model.axis.half_width * model.residues[index] / 2)
    if found.spread is None:
        return Branch(p, residue, {}, not sound)
    units = np.eye(model.size, dtype=complex)
    rows = [
        -model.axis.half_width / (2 * p) * units[index],
        model.scale * model.axis.half_width / 2 * units[model.poles.size + index],
    ]
    return Branch(p, residue, element_deviations(p, residue, found.spread.covariance(np.array(rows))), not sound)
