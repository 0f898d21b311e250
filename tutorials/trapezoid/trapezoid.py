# %% [markdown]
# # A new geometry: a trapezoid with a partial electrode
#
# This tutorial leads from an empty folder to pictures of modes, with one specimen file of thirteen lines and two
# commands. The plate is wider at one end, and its hot electrode covers only the wide half.

# %%
import json
import os
from pathlib import Path

import numpy as np

import femu_piezo as fp
from femu_piezo.cli import main
from femu_piezo.forward.eigen import solve_eigen
from femu_piezo.forward.model import ElectroelasticModel
from femu_piezo.geometry.catalogue import trapezoid
from femu_piezo.geometry.slab import Electrodes
from femu_piezo.material.library import library_material

OUT = Path(os.environ.get("FEMU_PIEZO_OUT", "out")) / "trapezoid"
OUT.mkdir(parents=True, exist_ok=True)

# %% [markdown]
# ## The specimen file

# %%
SPECIMEN = """\
name = "trapezoid, half covered"

[geometry]
shape = "trapezoid"
length = "20 mm"
width = "6 mm"
width_end = "3 mm"
thickness = "0.7 mm"
electrode_start = "0 mm"        # the hot electrode begins at the wide end
electrode_length = "10 mm"

[material]
base = "pzt-5h"
"""
specimen = OUT / "trapezoid.toml"
specimen.write_text(SPECIMEN, encoding="utf-8")

# %% [markdown]
# ## Two commands
#
#     femu-piezo simulate trapezoid.toml --out results
#     femu-piezo modes trapezoid.toml --out results --band 0 260000

# %%
for command in (["simulate"], ["modes", "--band", "0", "260000"]):
    main([command[0], str(specimen), "--out", str(OUT), *command[1:]], standalone_mode=False)

record = json.loads((OUT / "modes.json").read_text(encoding="utf-8"))
half = {mode["pole"]["family"]: mode["k_eff"] for mode in record["modes"]}
first = record["modes"][0]["pole"]["frequency_Hz"]
assert record["modes"][0]["pole"]["family"] == "first length extension"

# %% [markdown]
# ## The same in Python, and with full electrodes
#
# Full electrodes do not drive the second length mode of a rectangle at all, and that of a trapezoid only weakly. A hot
# electrode on one half drives it almost as strongly as the first.

# %%
covered = OUT / "covered.toml"
lines = [line for line in SPECIMEN.splitlines() if not line.startswith("electrode")]
covered.write_text("\n".join(lines), encoding="utf-8")
full = {mode.pole_family: mode.k_eff for mode in fp.modes(covered, band=(0.0, 260e3)).modes}
print(f"\n{'k_eff':44s}{'half':>8s}{'full':>8s}")
for family in dict.fromkeys([*half, *full]):
    values = [f"{found[family]:8.3f}" if found.get(family) else "       –" for found in (half, full)]
    print(f"{family:44s}{values[0]}{values[1]}")
second = "length extension, second harmonic"
assert full["first length extension"] > half["first length extension"]
assert half[second] > 3 * (full.get(second) or 0.0)

# %% [markdown]
# The commands use hexahedra that are graded towards the edge of the electrode, where the field is singular. A check
# with quadratic tetrahedra, which are finer there:

# %%
pzt = library_material("pzt-5h")
body = trapezoid(20e-3, 6e-3, 3e-3, 0.7e-3, electrodes=Electrodes(span=(0.0, 10e-3)), elements="tetrahedron")
model = ElectroelasticModel(body.domain(edge=0.8e-3), pzt.density)
short = solve_eigen(model, pzt.constants.to_e_form(), "short", count=6, near_Hz=first)
check = float(np.sqrt(short.eigenvalues[short.dominant_index(first)].real) / (2 * np.pi))
print(f"\nfirst pole: {first:.1f} Hz, {record['unknowns']} unknowns; tetrahedra {check:.1f} Hz, {model.size} unknowns")
# The error of the tetrahedra at the edge of a partial electrode is a few 1e-4 in λ, and half of that in frequency.
assert abs(check / first - 1) < 5e-4
print(f"pictures mode_01.png …, modes.png, impedance.png are in {OUT}")
