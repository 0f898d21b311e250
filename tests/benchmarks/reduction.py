"""Prints the cost of the reduction for random plates, bars, disks and rings, one line each, and a count at the end.

    OMP_NUM_THREADS=1 python -m tests.benchmarks.reduction [--count 200] [--seed 1] [--verify 10]

from the repository root. --verify: for every so many specimens the estimated error is compared with full solutions at
three random training constants.
"""

from __future__ import annotations

import argparse
import time
from collections import Counter

import numpy as np

from femu_piezo.errors import ConvergenceError, InputError
from femu_piezo.forward.model import ElectroelasticModel
from femu_piezo.forward.reduction import ReducedModel, reduce_model
from femu_piezo.forward.response import full_impedance
from femu_piezo.geometry.catalogue import disk, ring
from femu_piezo.geometry.shape import Shape
from femu_piezo.geometry.shapes import Plate
from femu_piezo.inference.free_constants import FreeConstants
from femu_piezo.material.constants import ElasticForm, PiezoConstants
from femu_piezo.material.library import library_material, library_names
from femu_piezo.study.shapes import first_mode_Hz

#: Mesh error at the end of the band, loss tangent of the verifying solutions, largest number of unknowns of a specimen.
MESH, LOSS, MOST = 1e-4, 0.005, 8_000


def draw_body(rng: np.random.Generator) -> tuple[str, Shape]:
    """A body of ordinary proportions."""
    kind = str(rng.choice(["plate", "bar", "disk", "ring"], p=[0.35, 0.25, 0.25, 0.15]))
    if kind == "plate":
        length, thickness = rng.uniform(8e-3, 50e-3), rng.uniform(0.3e-3, 3e-3)
        return kind, Plate(length, length * rng.uniform(0.08, 1.0), thickness)
    if kind == "bar":
        length = rng.uniform(5e-3, 30e-3)
        return kind, Plate(length, length * rng.uniform(0.06, 0.6), length * rng.uniform(0.06, 0.6), "length")
    diameter = rng.uniform(5e-3, 40e-3)
    thickness = diameter * rng.uniform(0.03, 0.25)
    if kind == "disk":
        return kind, disk(diameter, thickness)
    return kind, ring(diameter, diameter * rng.uniform(0.25, 0.8), thickness)


def draw_material(rng: np.random.Generator) -> tuple[PiezoConstants, float]:
    """A library material, its constants up to 5 % off, half of the time with losses; and its density, kg/m³."""
    while True:
        material = library_material(str(rng.choice(library_names())))
        values = material.constants.vector().real * (1 + 0.05 * rng.uniform(-1, 1, 10))
        if rng.random() < 0.5:
            values = values * (1 - 1j * rng.uniform(0.0, 0.02, 10) * (rng.random(10) < 0.7))
        constants = PiezoConstants.from_vector(values)
        if np.all(values != 0) and not constants.lossless().physical_faults():
            return constants, material.density


def draw_training(rng: np.random.Generator, kind: str, constants: PiezoConstants) -> tuple[str, list[PiezoConstants]]:
    """The training constants of a simulation, an update or a diagnosis, drawn at random, and its name."""
    elastic, charge = ("s33", "d33") if kind == "bar" else ("s11", "d31")
    names = (elastic, "s12", charge, "eps33T") if kind in ("disk", "ring") else (elastic, charge, "eps33T")
    free = FreeConstants.of(constants, names)
    use = str(rng.choice(["simulate", "update", "diagnose"], p=[0.1, 0.4, 0.5]))
    if use == "simulate":
        return use, [constants]
    return use, free.training_sets(free.start, 0.25) if use == "update" else diagnosed(constants, free)


def diagnosed(constants: PiezoConstants, free: FreeConstants) -> list[PiezoConstants]:
    """Training constants of a diagnosis: the start with its losses, corners of the free constants, and every held
    constant moved by 10 %.
    """
    lossless = constants.lossless()
    sets = [constants, *free.training_sets(free.start, 0.05, 4)[1:]]
    for name, value in lossless.as_dict().items():
        if name not in free.names:
            moved = (lossless.with_values(**{name: value * share}) for share in (1.1, 0.9))
            sets += [item for item in moved if not item.physical_faults()][:1]
    return sets


def verified(model: ElectroelasticModel, reduced: ReducedModel, rng: np.random.Generator) -> float:
    """Largest relative error of Z at poles, zeros and between, at three random training points."""
    worst = 0.0
    for coefficients in rng.permutation(reduced.training)[:3]:
        e_form = ElasticForm.from_vector(coefficients * (1 + 1j * LOSS))
        modal = reduced.modal(e_form)
        found = np.concatenate([modal.eigenvalues, modal.zeros[0]]).real
        found = np.sqrt(found[found > (2 * np.pi * 100) ** 2]) / (2 * np.pi)
        chosen = rng.permutation(found[found < reduced.band_Hz])[:5]
        frequency = np.concatenate([chosen, [0.3 * reduced.band_Hz, reduced.band_Hz]])
        error = reduced.impedance(e_form, frequency) / full_impedance(model, e_form, frequency) - 1
        worst = max(worst, float(np.max(np.abs(error))))
    return worst


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=200)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--verify", type=int, default=10)
    options = parser.parse_args()
    rng, outcomes = np.random.default_rng(options.seed), Counter()
    print("body   use       unknowns reduced  sets rounds factors  asked  estimated   true     s")
    while sum(outcomes.values()) < options.count:
        kind, body = draw_body(rng)
        constants, density = draw_material(rng)
        use, training = draw_training(rng, kind, constants)
        first = first_mode_Hz(body, constants, density)
        band, accuracy = first * rng.uniform(1.2, 8.0), 10 ** rng.uniform(-6, -4)
        speed = 1 / np.sqrt(density * max(constants.s44.real, constants.s66.real))
        try:
            model = ElectroelasticModel(body.domain_for(MESH, band, speed), density)
        except InputError:
            continue
        if model.size > MOST:
            continue
        start = time.perf_counter()
        try:
            reduced = reduce_model(model, training, band, accuracy=accuracy)
        except (ConvergenceError, np.linalg.LinAlgError) as error:
            outcomes["failed"] += 1
            print(f"{kind:6} {use:9} {model.size:8} to {band:.4g} Hz: {error!r}", flush=True)
            continue
        took = time.perf_counter() - start
        met = "met" if reduced.estimated_error <= accuracy else "missed"
        outcomes[f"{met}, {'one factor' if reduced.factors == 1 else 'further factors'}"] += 1
        check = sum(outcomes.values()) % options.verify == 0
        true = f"{verified(model, reduced, rng):.1e}" if check else ""
        print(
            f"{kind:6} {use:9} {model.size:8} {reduced.size:7} {len(reduced.training):5} {reduced.rounds:6} "
            f"{reduced.factors:7} {accuracy:.1e} {reduced.estimated_error:.1e}   {true:8} {took:.1f}",
            flush=True,
        )
    for outcome, count in outcomes.most_common():
        print(f"{outcome}: {count} of {options.count}")


if __name__ == "__main__":
    main()
