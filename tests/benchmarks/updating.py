"""What `update` reaches: convergence from 30 % away, coverage of intervals, bias of the simplification, and time.

    python tests/benchmarks/updating.py

Data come from full solutions at every frequency on another mesh than the model's, of fully anisotropic PZT-5H with a
loss tangent of its own for every constant. Takes some minutes.
"""

from __future__ import annotations

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")

import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from femu_piezo.effects.extended_model import ExtendedModel, extend_model
from femu_piezo.errors import ConvergenceError, FemuPiezoError
from femu_piezo.forward.fundamental import reduced_source
from femu_piezo.forward.model import ElectroelasticModel
from femu_piezo.forward.response import full_impedance
from femu_piezo.geometry.shapes import Plate
from femu_piezo.inference.fit import Fit, fit
from femu_piezo.inference.free_constants import FreeConstants
from femu_piezo.inference.response import Evaluation
from femu_piezo.inference.starts.pole_zero import update_pair
from femu_piezo.inference.unknowns import MaterialParameters, Unknowns, material_prior
from femu_piezo.material.simplified import simplify
from femu_piezo.measurement.readers import write_spectrum
from femu_piezo.measurement.spectrum import ImpedanceSpectrum
from femu_piezo.measurement.sweeps import SweepData
from femu_piezo.specimen.file import read_specimen
from femu_piezo.study.update import update
from tests.materials import LOSSY as TRUTH
from tests.noise import noisy_sweep
from tests.specimens import material, plate

DENSITY = 7500.0
PLATE = Plate(12e-3, 3e-3, 1e-3)
TRIO = ("s11", "d31", "eps33T")
CONSOLE = Console(width=110)


def data(band: tuple[float, float], points: int, divisions: tuple[int, int, int]) -> ImpedanceSpectrum:
    """A noise-free sweep by full solutions."""
    model = ElectroelasticModel(PLATE.domain(divisions), DENSITY)
    frequency = np.linspace(*band, points)
    return ImpedanceSpectrum(frequency, full_impedance(model, TRUTH.to_e_form(), frequency))


def _model(band: float, accuracy: float) -> ElectroelasticModel:
    shear = 1 / np.sqrt(DENSITY * max(TRUTH.s44.real, TRUTH.s66.real))
    return ElectroelasticModel(PLATE.domain_for(accuracy, band, shear), DENSITY)


def _fitted(
    model: ExtendedModel, free: FreeConstants, theta: np.ndarray, sweep: ImpedanceSpectrum, level: float = 1e-3
) -> Fit:
    """The most probable constants from the start θ, with everything but the noise exactly known."""
    unknowns = Unknowns(MaterialParameters.around(free, free.start), material_prior(free, {}, {}))
    data = SweepData(sweep.frequency, sweep.impedance, np.full(len(sweep), level), True)
    return fit(Evaluation(model, sweep.omega), data, unknowns, [unknowns.material.x_of(theta)])


def starts(sweep: ImpedanceSpectrum, count: int = 50) -> None:
    """Print how many curve fits converge from free real parts drawn within ±30 %, and whether to the same answer."""
    model = _model(sweep.frequency[-1], 1e-5)
    free = FreeConstants.of(TRUTH, TRIO)
    reduced = extend_model(model, free.training_sets(free.start, 0.3), (), sweep.frequency[-1])
    rng = np.random.default_rng(5)
    found, failed = [], []
    for _ in range(count):
        theta = free.start.real * (1 + rng.uniform(-0.3, 0.3, 3)) * (1 - 0.01j)
        try:
            solution = _fitted(reduced, free, theta, sweep)
            found.append(solution.parameters.material.theta(solution.x))
        except ConvergenceError as error:
            failed.append(str(error))
    found = np.array(found)
    same = np.all(
        np.abs(found / np.median(found.real, axis=0) - found[0] / np.median(found.real, axis=0)) < 1e-6, axis=1
    )
    CONSOLE.print(
        f"starts ±30 %, curve fit alone: {len(found)} of {count} converged, {same.sum()} to the same answer; "
        f"the others: {sorted(set(failed)) or 'none'}"
    )


def starts_of_update(sweep: ImpedanceSpectrum, count: int = 50) -> None:
    """Print the same for `update`, with the drawn values in the file; it takes its start from the sweep by 1-D
    formulas.
    """
    rng = np.random.default_rng(5)
    found, failed, seconds = [], [], []
    with tempfile.TemporaryDirectory() as folder:
        write_spectrum(noisy_sweep(sweep, 1e-3, 0), Path(folder) / "sweep.csv")
        for number in range(count):
            factors = dict(zip(TRIO, 1 + rng.uniform(-0.3, 0.3, 3), strict=True))
            text = plate(f"start {number}", (PLATE.length, PLATE.width, PLATE.thickness), DENSITY)
            text += material(TRUTH, TRIO, factors, TRIO)
            path = Path(folder) / f"{number}.toml"
            path.write_text(f'{text}[measurement]\nfile = "sweep.csv"\n', encoding="utf-8")
            begin = time.perf_counter()
            try:
                found.append(list(update(read_specimen(path)).parameters.values()))
            except FemuPiezoError as error:
                failed.append(str(error))
            seconds.append(time.perf_counter() - begin)
    values = np.array([[one.value for one in row] for row in found])
    std = np.array([one.std for one in found[0]])
    CONSOLE.print(
        f"starts ±30 %, update: {len(found)} of {count} converged, largest difference of a real part "
        f"{np.max(np.ptp(values, axis=0) / std):.1e} of its σ; median {np.median(seconds):.2f} s; "
        f"failures: {failed or 'none'}"
    )


def coverage(sweep: ImpedanceSpectrum, draws: int = 100, level: float = 1e-3) -> None:
    """Print the coverage of intervals over noise draws."""
    model = _model(sweep.frequency[-1], 1e-6)
    free = FreeConstants.of(TRUTH, TRIO)
    reduced = extend_model(model, free.training_sets(free.start, 0.1), (), sweep.frequency[-1], accuracy=1e-6)
    parameters = MaterialParameters.around(free, free.start)
    exact = parameters.x_of(free.start)
    pulls = []
    for seed in range(draws):
        solution = _fitted(reduced, free, free.start, noisy_sweep(sweep, level, seed), level)
        pulls.append((solution.x - exact) / solution.std)
    pulls = np.array(pulls)
    table = Table(title=f"intervals, {draws} draws of {100 * level:g} % noise", title_justify="left")
    for heading in ("unknown", "mean / σ", "within 1 σ", "within 1.96 σ"):
        table.add_column(heading, justify="right")
    for column, name in enumerate(parameters.names):
        p = pulls[:, column]
        inside = [f"{100 * np.mean(np.abs(p) < limit):.0f} %" for limit in (1, 1.96)]
        table.add_row(name, f"{p.mean():+.2f}", *inside)
    table.add_row("all", f"{pulls.mean():+.2f}", *[f"{100 * np.mean(np.abs(pulls) < s):.0f} %" for s in (1, 1.96)])
    CONSOLE.print(table)


def simplification(narrow: ImpedanceSpectrum, wide: ImpedanceSpectrum) -> None:
    """Print the bias of the paper's isotropic simplification for anisotropic data."""
    table = Table(title="bias of the isotropic simplification, truth anisotropic PZT-5H", title_justify="left")
    for heading in ("sweep", *TRIO, *(f"tan {name}" for name in TRIO)):
        table.add_column(heading, justify="right")
    base = simplify(TRUTH, "thickness").full()
    for words, sweep in (("fundamental", narrow), ("with overtones", wide)):
        free = FreeConstants.of(base, TRIO, simplified=True)
        model = _model(sweep.frequency[-1], 1e-5)
        reduced = extend_model(model, free.training_sets(free.start, 0.2), (), sweep.frequency[-1])
        solution = _fitted(reduced, free, free.start, sweep)
        found = dict(zip(TRIO, solution.parameters.material.theta(solution.x), strict=True))
        real = [100 * (value.real / getattr(TRUTH, name).real - 1) for name, value in found.items()]
        tan = [100 * (-value.imag / value.real / TRUTH.tangent(name) - 1) for name, value in found.items()]
        table.add_row(words, *(f"{value:+.2f} %" for value in (*real, *tan)))
    CONSOLE.print(table)


def speed(sweep: ImpedanceSpectrum) -> None:
    """Print the time of a curve fit of six real unknowns at 1601 points on an existing basis."""
    free = FreeConstants.of(TRUTH, TRIO)
    top = sweep.frequency[-1]
    reduced = extend_model(_model(top, 1e-4), free.training_sets(free.start, 0.2), (), top)
    frequency = np.linspace(sweep.frequency[0], top, 1601)
    sampled = ImpedanceSpectrum(frequency, reduced.modal(TRUTH.to_e_form()).impedance(2 * np.pi * frequency))
    theta = free.start.real * np.array([1.03, 0.95, 1.05]) * (1 - 0.01j)
    times = []
    for seed in range(5):
        drawn = noisy_sweep(sampled, 1e-3, seed)
        begin = time.perf_counter()
        pole = reduced_source(reduced)(TRUTH, 118e3)
        two = FreeConstants.of(free.constants(theta), ("s11", "d31"))
        update_pair(reduced_source(reduced), two, pole.eigenvalues)
        _fitted(reduced, free, theta, drawn)
        times.append(time.perf_counter() - begin)
    CONSOLE.print(
        f"curve fit, six unknowns, 1601 points, {reduced.size} reduced unknowns: median of 5 {np.median(times):.3f} s"
    )


if __name__ == "__main__":
    fundamental = data((105e3, 140e3), 201, (12, 4, 2))
    overtones = data((50e3, 450e3), 401, (18, 5, 2))
    speed(fundamental)
    starts(fundamental)
    starts_of_update(fundamental)
    coverage(fundamental)
    simplification(fundamental, overtones)
