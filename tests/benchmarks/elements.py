"""Prints what elements of high order save: unknowns, errors of λ and time, for our choice, quadratic ones and NGSolve.

    OMP_NUM_THREADS=1 python -m tests.benchmarks.elements [--ngsolve PYTHON] [--only plate disk …] [--sweeps]

from the repository root. The errors are those of the driven poles and zeros below a frequency, against the mesh for a
fifth of its accuracy. --ngsolve: a Python that can import ngsolve (and scipy); its column has the
poles of plates and bars on the same mesh at the same order. --sweeps: unknowns, time and peak memory of three whole
sweeps, each in a process of its own.
"""

from __future__ import annotations

import argparse
import resource
import subprocess
import sys
import time
from dataclasses import replace

import numpy as np

from femu_piezo.forward.eigen import solve_eigen
from femu_piezo.forward.model import ElectroelasticModel
from femu_piezo.forward.reduction import reduce_model
from femu_piezo.geometry.catalogue import disk, plate, ring, trapezoid
from femu_piezo.geometry.regions import Circle
from femu_piezo.geometry.shape import Shape
from femu_piezo.geometry.shapes import Plate
from femu_piezo.geometry.slab import Electrodes
from femu_piezo.material.library import library_material
from tests.benchmarks.ask_ngsolve import answer, coupled

MM, ACCURACY, DENSITY = 1e-3, 1e-4, 7500.0
PZT = library_material("pzt-5h").constants.lossless()
SHEAR = 1 / np.sqrt(DENSITY * max(PZT.s44.real, PZT.s66.real))
#: Body, end of the band (Hz), edge (m) of quadratic elements whose computation takes about as long.
BODIES: dict[str, tuple[Shape, float, float]] = {
    "plate": (Plate(20 * MM, 5 * MM, 1 * MM), 250e3, 0.7 * MM),
    "bar": (Plate(20 * MM, 2 * MM, 2 * MM, "length"), 250e3, 0.5 * MM),
    "disk": (disk(20 * MM, 1 * MM), 300e3, 1.0 * MM),
    "ring": (ring(20 * MM, 8 * MM, 1 * MM), 300e3, 1.0 * MM),
    "half trapezoid": (
        trapezoid(20 * MM, 6 * MM, 3 * MM, 0.7 * MM, electrodes=Electrodes(span=(0.0, 10 * MM))),
        200e3,
        0.8 * MM,
    ),
    "disk, margin": (disk(10 * MM, 1 * MM, electrodes=Electrodes(margin=0.7 * MM)), 300e3, 0.7 * MM),
    "rounded": (plate(10 * MM, 6 * MM, 1 * MM, corner_radius=1 * MM), 250e3, 0.6 * MM),
    "holed": (plate(10 * MM, 6 * MM, 1 * MM, holes=(Circle(2 * MM),)), 250e3, 0.6 * MM),
}
#: Sweeps: body, highest frequency (Hz).
SWEEPS = {
    "plate 40 x 5 x 1 mm to 300 kHz": (Plate(40 * MM, 5 * MM, 1 * MM), 300e3),
    "disk 35 x 2 mm to 500 kHz": (disk(35 * MM, 2 * MM), 500e3),
    "disk 10 x 1 mm to 2.5 MHz": (disk(10 * MM, 1 * MM), 2.5e6),
}


def driven(domain, band: float) -> tuple[int, float, list[np.ndarray], list[np.ndarray]]:
    """Unknowns, time (s) of assembly and both eigenproblems, all λ near the band, and the driven ones below its end."""
    start, of_all, of_driven = time.perf_counter(), [], []
    model = ElectroelasticModel(domain, DENSITY)
    for circuit in ("short", "open"):
        modes = solve_eigen(model, PZT.to_e_form(), circuit, 12, near_Hz=0.45 * band)
        inside = (modes.participation > 1e-3) & (modes.eigenvalues.real < (2 * np.pi * band) ** 2)
        of_all.append(modes.eigenvalues.real)
        of_driven.append(modes.eigenvalues.real[inside])
    return model.size, time.perf_counter() - start, of_all, of_driven


def errors(every: list[np.ndarray], strong: list[np.ndarray]) -> str:
    """Largest and median relative error of the driven λ, each against the nearest one."""
    found = [np.min(np.abs(v / exact - 1)) for v, ones in zip(every, strong, strict=True) for exact in ones]
    return f"{max(found):8.1e} {np.median(found):8.1e}"


def quadratic(shape: Shape, edge: float):
    """The body in quadratic elements: hexahedra for plates, otherwise tetrahedra of gmsh."""
    if isinstance(shape, Plate):
        divisions = tuple(int(n) for n in np.maximum(1, np.ceil(shape.part(shape.mirrors) / edge)))
        return shape.domain(divisions, shape.mirrors, 2)
    return replace(shape, elements="tetrahedron").domain(edge)


def ngsolve(python: str | None, shape: Shape, domain, band: float, strong: list[np.ndarray]) -> str:
    """Unknowns, largest error of poles and time by NGSolve on the same mesh at the same order, or why there are
    none.
    """
    if python is None or not isinstance(shape, Plate):
        return ""
    extents = shape.part(shape.mirrors)
    lines = [np.unique(np.round(axis, 12)).size - 1 for axis in domain.mesh.p]
    task = {
        "problem": "poles",
        "size": list(2 * extents),
        "divisions": lines,
        "order": domain.order,
        "field_axis": shape.poling_axis,
        "constants": coupled(PZT.to_e_form()),
        "density": DENSITY,
        "near": 0.45 * band,
        "count": 12,
    }
    try:
        found = answer(python, task, 200)
    except (OSError, subprocess.SubprocessError) as error:
        return f"NGSolve did not answer ({type(error).__name__})"
    worst = max(np.min(np.abs(np.array(found["eigenvalues"]) / exact - 1)) for exact in strong[0])
    return f"{found['unknowns']:6d} {worst:8.1e} {found['seconds']:6.1f} s (poles)"


def table(python: str | None, only: list[str] | None) -> None:
    print(
        f"{'body':16s}{'elements':26s}{'unknowns':>9s} {'largest':>8s} {'median':>8s} {'time':>8s}   NGSolve",
        flush=True,
    )
    for name in only or BODIES:
        shape, band, edge = BODIES[name]
        domain = shape.domain_for(ACCURACY, band, SHEAR)
        finest = shape.domain_for(ACCURACY / 5, band, SHEAR)
        _, _, _, strong = driven(finest, band)
        size, seconds, every, _ = driven(domain, band)
        other = ngsolve(python, shape, domain, band, strong)
        kind = f"{domain.mesh.nelements} hexahedra, order {domain.order}"
        print(f"{name:16s}{kind:26s}{size:9d} {errors(every, strong)} {seconds:6.1f} s   {other}", flush=True)
        plain = quadratic(shape, edge)
        size, seconds, every, _ = driven(plain, band)
        kind = f"{plain.mesh.nelements} {'hexahedra' if isinstance(shape, Plate) else 'tetrahedra'}, order 2"
        print(f"{'':16s}{kind:26s}{size:9d} {errors(every, strong)} {seconds:6.1f} s", flush=True)


def sweep(name: str) -> None:
    """Print unknowns, time and peak memory for mesh, reduced model and 1601 frequencies of a body."""
    shape, band = SWEEPS[name]
    start = time.perf_counter()
    model = ElectroelasticModel(shape.domain_for(ACCURACY, band, SHEAR), DENSITY)
    lossy = library_material("pzt-5h").constants
    reduced = reduce_model(model, [lossy], band, accuracy=1e-4)
    reduced.modal(lossy.to_e_form()).admittance(2 * np.pi * np.linspace(100.0, band, 1601))
    seconds, peak = time.perf_counter() - start, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    print(f"{name:34s} order {model.order}, {model.size:7d} unknowns, {seconds:6.1f} s, {peak:5.0f} MB", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--ngsolve")
    parser.add_argument("--only", nargs="*", choices=BODIES)
    parser.add_argument("--sweeps", action="store_true")
    parser.add_argument("--sweep", choices=SWEEPS)
    given = parser.parse_args()
    if given.sweep:
        sweep(given.sweep)
        return
    if not given.sweeps:
        if given.ngsolve is None:
            print("NGSolve is left out: give --ngsolve a Python that can import it")
        table(given.ngsolve, given.only)
    for name in SWEEPS if given.sweeps else ():
        subprocess.run([sys.executable, "-m", "tests.benchmarks.elements", "--sweep", name], check=False)


if __name__ == "__main__":
    main()
