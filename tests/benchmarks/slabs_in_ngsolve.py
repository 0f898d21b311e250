"""Prints λ of slabs with round corners, holes and partial electrodes from NGSolve, against ours.

    OMP_NUM_THREADS=1 python -m tests.benchmarks.slabs_in_ngsolve PYTHON_WITH_NGSOLVE [--only rounded …] [--order 4]

from the repository root. Wrapped electrodes are not supported. tests/verification/test_slab_meshes.py compares our
meshes with the numbers printed here.
"""

from __future__ import annotations

import argparse

import numpy as np

from femu_piezo.geometry.regions import Circle, Rectangle, Region
from femu_piezo.geometry.slab import Slab
from femu_piezo.geometry.slab_cad import partial_footprints
from tests.benchmarks.ask_ngsolve import answer, coupled
from tests.verification.test_slab_meshes import DENSITY, FORM, MM, SHEAR, SMALL, driven


def outline(region: Region) -> list:
    """A region in the form that in_ngsolve.py draws, mm."""
    if isinstance(region, Circle):
        return ["circle", region.diameter / MM, *(x / MM for x in region.center)]
    if isinstance(region, Rectangle):
        return ["rectangle", region.length / MM, region.width / MM, region.corner_radius / MM]
    return ["trapezoid", region.length / MM, region.width / MM, region.width_end / MM]


def problem(shape: Slab, band: float, order: int, edge: float, levels: int) -> dict:
    """The task for in_ngsolve.py."""
    rims = bool(partial_footprints(shape))
    copies = 2 ** len({0, 1} & set(shape.mirrors))
    return {
        "problem": "slab",
        "outline": outline(shape.outline),
        "holes": [outline(hole) for hole in shape.holes],
        "hot": outline(shape.hot.outline),
        "hot_holes": [outline(hole) for hole in shape.hot.holes],
        "hot_x": [x / MM for x in shape.hot.x_range] if shape.hot.x_range else None,
        "hot_area": shape.electrode_area / MM**2 / copies,
        "thickness": shape.thickness / MM,
        "mirrors": shape.mirrors,
        "rims": rims,
        "levels": levels if rims else 0,
        "order": order,
        "edge": edge,
        "constants": coupled(FORM),
        "density": DENSITY,
        "near": 0.45 * band,
        "count": 10,
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("python")
    parser.add_argument("--only", nargs="*", choices=SMALL)
    parser.add_argument("--order", type=int, default=4)
    parser.add_argument("--edge", type=float, default=0.8, help="of the tetrahedra, mm")
    parser.add_argument("--levels", type=int, default=2, help="geometric refinements at electrode rims")
    parser.add_argument("--accuracy", type=float, nargs="*", default=[1e-3, 1e-4], help="ours")
    given = parser.parse_args()
    for name in given.only or [one for one, (shape, _) in SMALL.items() if shape.electrodes.wrap is None]:
        shape, band = SMALL[name]
        found = answer(given.python, problem(shape, band, given.order, given.edge, given.levels))
        print(f"{name}: {found['unknowns']} unknowns", flush=True)
        theirs = np.array(found["short"] + found["open"])
        print("  NGSolve, Hz:", *(f"{value:.3f}" for value in hertz(theirs)), flush=True)
        for accuracy in given.accuracy:
            domain = shape.domain_for(accuracy, band, SHEAR)
            values = driven(domain, band)
            off = [f"{hertz(value):.3f} {np.min(np.abs(value / theirs - 1)):.1e}," for value in values]
            cells = f"order {domain.order}, {domain.mesh.nelements} cells"
            print(f"  ours at {accuracy:g}, Hz and error of λ:", *off, cells, flush=True)


def hertz(values: np.ndarray) -> np.ndarray:
    """Frequencies of eigenvalues λ (rad²/s²), Hz."""
    return np.sqrt(np.abs(values)) / (2 * np.pi)


if __name__ == "__main__":
    main()
