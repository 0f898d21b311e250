"""Measures one size of the growth study in a process of its own: python -m tests.benchmarks.growth NX NY NZ → JSON."""

from __future__ import annotations

import json
import re
import resource
import sys
import time
from pathlib import Path

from femu_piezo.forward.linear_solver import factorize
from femu_piezo.forward.model import ElectroelasticModel
from femu_piezo.forward.reduction import reduce_model
from femu_piezo.geometry.shapes import Plate
from femu_piezo.material.library import library_material


def peak_GB() -> float:
    """Peak resident memory of this process alone (ru_maxrss would start from the parent's)."""
    status = Path("/proc/self/status")
    if status.is_file():
        return int(re.search(r"VmHWM:\s+(\d+) kB", status.read_text())[1]) / 1e6
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6


def main() -> None:
    divisions = tuple(int(word) for word in sys.argv[1:4])
    material = library_material("tj52-hd")
    start = time.perf_counter()
    model = ElectroelasticModel(Plate(40e-3, 5e-3, 1e-3).domain(divisions), material.density or 7900.0)
    stiffness = model.stiffness(material.constants.to_e_form())
    made = time.perf_counter()
    factorize(stiffness)
    factorised = time.perf_counter()
    reduced = reduce_model(model, [material.constants], 300e3, accuracy=1e-4)
    built = time.perf_counter()
    result = {
        "unknowns": model.size,
        "model_s": made - start,
        "factor_s": factorised - made,
        "basis_s": built - factorised,
        "size": reduced.size,
        "peak_GB": peak_GB(),
    }
    json.dump(result, sys.stdout)


if __name__ == "__main__":
    main()
