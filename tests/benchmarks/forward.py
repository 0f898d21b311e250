"""Prints the table of the forward model: each figure with its target, as ratios of medians measured in the same run.

    OMP_NUM_THREADS=1 python -m tests.benchmarks.forward [--repeats 5] [--growth 30000] [--ngsolve PYTHON]

from the repository root. --growth: unknowns up to which the growth study runs (each size in a process of its own, for
its peak memory); --ngsolve: a Python that can import ngsolve, the running one by default.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import scipy.linalg
import skfem
from skfem.models.elasticity import linear_elasticity

from femu_piezo.effects.extended_model import extend_model
from femu_piezo.forward.eigen import solve_eigen
from femu_piezo.forward.fundamental import reduced_source
from femu_piezo.forward.gradient_products import assemble_gradient_products
from femu_piezo.forward.linear_solver import factorize
from femu_piezo.forward.model import ElectroelasticModel
from femu_piezo.forward.reduction import reduce_model
from femu_piezo.forward.response import full_impedance
from femu_piezo.geometry.shapes import Plate
from femu_piezo.inference.free_constants import FreeConstants
from femu_piezo.inference.response import Evaluation
from femu_piezo.inference.starts.pole_zero import update_simplified
from femu_piezo.inference.unknowns import MaterialParameters, Unknowns, material_prior
from femu_piezo.material.constants import D_FORM, E_FORM, EPS0, PiezoConstants
from femu_piezo.material.library import library_material
from femu_piezo.material.simplified import SimplifiedK31
from tests.materials import FORWARD_TANGENTS

BASE = library_material("tj52-hd").constants
LOSSY = PiezoConstants.from_vector(BASE.vector().real * (1 - 1j * FORWARD_TANGENTS))
DENSITY, BAND = 7900.0, 300e3
K31, K33 = Plate(40e-3, 5e-3, 1e-3), Plate(20e-3, 2e-3, 2e-3, "length")
PLATES = {
    "k31 1/8, 20x3x1": (K31, (20, 3, 1), (0, 1, 2)),
    "k33 1/8, 14x2x2": (K33, (14, 2, 2), (0, 1, 2)),
    "k31 full, 40x6x2": (K31, (40, 6, 2), ()),
}
FREQUENCY = np.linspace(100.0, BAND, 1601)


def median_time(function, repeats: int) -> float:
    """Median wall time of a call, s."""
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        function()
        times.append(time.perf_counter() - start)
    return float(np.median(times))


def row(subject: str, figure: str, target: str = "") -> None:
    print(f"{subject:<46} {figure:<48} {target}", flush=True)


def assembly(repeats: int) -> None:
    """Print the time of assembly over that of the plain elastic stiffness in scikit-fem."""
    domain = K31.domain((20, 3, 1))
    model = ElectroelasticModel(domain, DENSITY)
    vector = skfem.Basis(domain.mesh, skfem.ElementVector(skfem.ElementHex2()), intorder=4)
    plain = median_time(lambda: linear_elasticity(1.0, 1.0).assemble(vector), repeats)
    products = median_time(lambda: assemble_gradient_products(model.basis), repeats)
    terms = median_time(lambda: [model.term(name) for name in E_FORM], repeats)
    row("assembly: plain K_uu by scikit-fem", f"{1e3 * plain:.1f} ms")
    row("  all products (every unit matrix)", f"{1e3 * products:.1f} ms = {products / plain:.2f} x", "<= 3 x")
    row("  and ten sparse A_q from them", f"{1e3 * terms:.1f} ms = {(products + terms) / plain:.2f} x", "<= 3 x")


def sweep(name: str, repeats: int, samples: int) -> None:
    """Print the gain in time for Z(f) at 1601 frequencies: direct solutions (timed on a few) against the reduced
    model.
    """
    plate, divisions, axes = PLATES[name]
    model, e_form = ElectroelasticModel(plate.domain(divisions, axes), DENSITY), LOSSY.to_e_form()
    reduced = reduce_model(model, [LOSSY], BAND, accuracy=1e-4)
    modal = reduced.modal(e_form)
    poles = np.sqrt(np.concatenate([modal.eigenvalues, modal.zeros[0]]).real) / (2 * np.pi)
    poles = np.random.default_rng(0).permutation(poles[poles < BAND])[:samples]
    direct = full_impedance(model, e_form, poles)
    one = median_time(lambda: full_impedance(model, e_form, poles[:3]), max(3, repeats // 2)) / 3
    error = np.max(np.abs(reduced.impedance(e_form, poles) / direct - 1))
    ready = median_time(lambda: reduced.impedance(e_form, FREQUENCY), repeats)
    built = median_time(lambda: reduce_model(model, [LOSSY], BAND, accuracy=1e-4).impedance(e_form, FREQUENCY), repeats)
    total = one * FREQUENCY.size
    row(f"Z(f) {name}", f"{model.size} unknowns, direct {1e3 * one:.1f} ms x 1601 = {total:.0f} s")
    row("  reduced, error at poles and zeros", f"{reduced.size} unknowns, {error:.1e}", "1e-4")
    row("  basis at hand", f"{1e3 * ready:.2f} ms, {total / ready:.0f} x faster", ">= 300 x")
    row("  basis built in the same call", f"{1e3 * built:.0f} ms, {total / built:.0f} x faster", ">= 30 x")


def jacobian(repeats: int) -> None:
    """Print times of Z with its Jacobian on a reduced basis."""
    model = ElectroelasticModel(K31.domain((20, 3, 1)), DENSITY)
    free = FreeConstants.of(BASE, ("s11", "d31", "eps33T"))
    training = free.training_sets(free.start, 0.15)
    build = median_time(lambda: reduce_model(model, training, BAND), max(3, repeats // 2))
    reduced, e_form = reduce_model(model, training, BAND), LOSSY.to_e_form()
    evaluation = Evaluation(extend_model(model, training, [], BAND), 2 * np.pi * FREQUENCY)

    def with_jacobian(names: tuple[str, ...]) -> float:
        """Time, ms; the constants differ from call to call, as those of a fit do."""
        constants = FreeConstants.of(LOSSY, names)
        material = MaterialParameters.around(constants, constants.start)
        unknowns, x = Unknowns(material, material_prior(constants, {}, {})), material.x_of(constants.start)

        def call() -> None:
            x[0] *= 1 + 1e-9
            evaluation.with_jacobian(unknowns, x)

        return 1e3 * median_time(call, 9)

    row("basis for s11, d31, eps33T +-15 %, 1e-5", f"{1e3 * build:.0f} ms, {reduced.size} unknowns")
    row("  Z alone, 1601 frequencies", f"{1e3 * median_time(lambda: reduced.impedance(e_form, FREQUENCY), 9):.2f} ms")
    row("  Z with Jacobian in all ten constants", f"{with_jacobian(D_FORM):.2f} ms", "<= 20 ms")
    row("  Z with Jacobian in three", f"{with_jacobian(free.names):.2f} ms")


def k31_update(repeats: int) -> None:
    """Print the time of the paper's update from mesh to constants, over that of a factorisation of its operator."""
    start = SimplifiedK31.of(BASE)
    target = SimplifiedK31(15.84e-12 * (1 - 0.016j), -293.25e-12 * (1 - 0.013j), 2422.5 * EPS0 * (1 - 0.015j), -4.5e-12)
    for divisions in ((7, 1, 1), (20, 3, 1)):
        model = ElectroelasticModel(K31.domain(divisions), DENSITY)
        full = [solve_eigen(model, target.full().to_e_form(), circuit, 6, 35e3) for circuit in ("short", "open")]
        measured = np.array([modes.eigenvalues[modes.dominant_index(35e3)] for modes in full])
        band = 1.05 * float(np.sqrt(measured[1].real)) / (2 * np.pi)

        def update(divisions=divisions, measured=measured, band=band):
            model = ElectroelasticModel(K31.domain(divisions), DENSITY)
            training = FreeConstants.of(start.full(), ("s11", "d31", "eps33T"), simplified=True)
            reduced = reduce_model(model, training.training_sets(training.start, 0.25), band)
            return update_simplified(reduced_source(reduced), start, measured, target.eps33T)

        found = update().constants
        error = max(abs(found.s11 / target.s11 - 1), abs(found.d31 / target.d31 - 1))
        whole = median_time(update, repeats)
        made = median_time(lambda divisions=divisions: ElectroelasticModel(K31.domain(divisions), DENSITY), repeats)
        operator = model.stiffness(start.full().to_e_form())
        factor = median_time(lambda operator=operator: factorize(operator), repeats)
        row(
            f"k31 update {'x'.join(map(str, divisions))}, {model.size} unknowns",
            f"{1e3 * whole:.0f} ms = assembly + {(whole - made) / factor:.1f} factorisations (s11, d31 to {error:.0e})",
            "<= 10",
        )


def side_by_side(python: str, repeats: int) -> None:
    """Print times of NGSolve on the same elements, and of a dense condensed FEMU step as in the paper (eqs 16-20)."""
    plate, divisions, axes = PLATES["k31 1/8, 20x3x1"]
    model, e_form = ElectroelasticModel(plate.domain(divisions, axes), DENSITY), LOSSY.to_e_form()
    frequency = np.array([100.0, 35e3, 110.4e3, 299e3])
    coupling = e_form.piezoelectric()
    tensor = np.block([[e_form.stiffness(), coupling.T], [coupling, -e_form.permittivity()]])
    task = {
        "problem": "sweep",
        "size": plate.dimensions.tolist(),
        "divisions": divisions,
        "threads": 1,
        "constants_real": tensor.real.tolist(),
        "constants_imag": tensor.imag.tolist(),
        "density": DENSITY,
        "frequencies": frequency.tolist(),
        "admittance_factor": model.domain.admittance_factor,
        "inverse": "sparsecholesky",
    }
    script = Path(__file__).with_name("in_ngsolve.py")
    answer = subprocess.run([python, str(script)], input=json.dumps(task), capture_output=True, text=True, check=False)
    if answer.returncode:
        row("NGSolve", f"not run: {(answer.stderr.strip().splitlines() or ['no message'])[-1][:60]}")
    else:
        theirs = json.loads(answer.stdout[answer.stdout.index("{") :])
        z = np.array(theirs["impedance_real"]) + 1j * np.array(theirs["impedance_imag"])
        error = np.max(np.abs(z / full_impedance(model, e_form, frequency) - 1))
        ours = median_time(lambda: full_impedance(model, e_form, frequency), repeats) / frequency.size
        build = median_time(
            lambda: reduce_model(model, [LOSSY], BAND, accuracy=1e-4).impedance(e_form, FREQUENCY), repeats
        )
        row(f"NGSolve {theirs['version']}, one frequency", f"{1e3 * theirs['solve_s']:.1f} ms, Z agrees to {error:.0e}")
        row("  ours, direct solve of one frequency", f"{1e3 * ours:.1f} ms")
        row("  NGSolve x 1601 / reduced with basis", f"{theirs['solve_s'] * 1601 / build:.0f} x")
    _dense(repeats)


def _dense(repeats: int) -> None:
    """Print the time of the dense condensed step."""
    model, e_form = ElectroelasticModel(K31.domain((10, 2, 1)), DENSITY), LOSSY.to_e_form()
    u = int(np.count_nonzero(model.mass.diagonal()))
    stiffness, mass = model.stiffness(e_form).toarray(), model.mass[:u, :u].toarray()

    def condensed(end: int) -> np.ndarray:
        coupling = stiffness[:u, u:end]
        matrix = stiffness[:u, :u] - coupling @ np.linalg.solve(stiffness[u:end, u:end], coupling.T)
        return scipy.linalg.eig(matrix, mass, right=False)

    dense = median_time(lambda: (condensed(model.size - 1), condensed(model.size)), 1)
    ours = median_time(lambda: reduce_model(model, [LOSSY], 50e3).modal(e_form).zeros, repeats)
    values = np.sort(condensed(model.size - 1).real)[:2]
    found = np.sort(reduce_model(model, [LOSSY], 50e3).modal(e_form).eigenvalues.real)[:1]
    row(f"dense condensed FEMU, {model.size} unknowns", f"{dense:.1f} s for one pair of pole and zero")
    row(
        "  ours, basis and pair",
        f"{1e3 * ours:.0f} ms = 1/{dense / ours:.0f}, pole to {abs(found[0] / values[0] - 1):.0e}",
    )


GROWTH = ((20, 4, 1), (30, 5, 2), (40, 8, 3), (66, 12, 4), (96, 18, 5))


def growth(largest: int) -> None:
    """Print time and peak memory of model, factorisation and basis by size, each in its own process, with fitted
    exponents.
    """
    found = []
    for divisions in GROWTH:
        expected = 4 * np.prod([2 * count + 1 for count in divisions])
        if expected > 1.1 * largest:
            row(f"growth {divisions}", f"about {expected} unknowns: beyond --growth {largest}")
            continue
        answer = subprocess.run(
            [sys.executable, "-m", "tests.benchmarks.growth", *map(str, divisions)], capture_output=True, text=True
        )
        if answer.returncode:
            row(f"growth {divisions}", f"failed: {answer.stderr.strip()[-80:]}")
            continue
        result = json.loads(answer.stdout)
        found.append([result[key] for key in ("unknowns", "model_s", "factor_s", "basis_s", "peak_GB")])
        row(
            f"growth {result['unknowns']} unknowns",
            f"model {result['model_s']:.2f} s, factor {result['factor_s']:.2f} s, "
            f"basis {result['basis_s']:.2f} s ({result['size']}), peak {result['peak_GB']:.2f} GB",
        )
    table = np.log(np.array(found))
    if len(found) > 2:
        slopes = [np.polyfit(table[-3:, 0], table[-3:, column], 1)[0] for column in (1, 2, 3, 4)]
        names = ("model", "factor", "basis", "memory")
        row("  exponents, last three", ", ".join(f"{n} {s:.2f}" for n, s in zip(names, slopes, strict=True)))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--growth", type=int, default=30_000)
    parser.add_argument("--ngsolve", default=sys.executable)
    options = parser.parse_args()
    row("WHAT", "MEASURED", "TARGET")
    assembly(options.repeats)
    for name in PLATES:
        sweep(name, options.repeats, 6)
    jacobian(options.repeats)
    k31_update(options.repeats)
    side_by_side(options.ngsolve, options.repeats)
    growth(options.growth)


if __name__ == "__main__":
    main()
