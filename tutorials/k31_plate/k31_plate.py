# %% [markdown]
# # The k31 plate of the paper: from a sweep to constants
#
# Cong, Hu, Li, *Smart Mater. Struct.* 31 (2022) 125010, section 4: a plate 40 × 5 × 1 mm, poled and electroded
# through its thickness. `sweep.csv` is its simulated measurement (made by `make_sweep.py` on another mesh: linear
# hexahedra of 1/8 mm, a full solve at every frequency). The baseline is 10 to 25 % wrong in every constant.

# %%
import os
from pathlib import Path

import numpy as np

import femu_piezo as fp

HERE = Path(__file__).parent if "__file__" in globals() else Path()
OUT = Path(os.environ.get("FEMU_PIEZO_OUT", "out")) / "k31_plate"
EPS0 = 8.8541878128e-12

# %% [markdown]
# ## A sweep in memory
#
# A sweep is made from arrays: here from three columns of a file, in a laboratory from the data of the analyser.
# (`fp.read_spectrum` reads the file formats of instruments.)

# %%
frequency_Hz, resistance, reactance = np.loadtxt(HERE / "sweep.csv", delimiter=",", skiprows=1, unpack=True)
sweep = fp.ImpedanceSpectrum.from_resistance_reactance(frequency_Hz, resistance, reactance)
print(sweep)

# %% [markdown]
# ## Poles and zeros without any model
#
# A *pole* is a pole of the admittance (series resonance), a *zero* a zero of the admittance (parallel resonance). Each
# is described by one complex number λ = ω²(1 + jη). In a notebook, `extraction` as the last line of a cell shows the
# table.

# %%
extraction = fp.extract(sweep)
print(extraction)
pole, zero = extraction.resonances.poles[0], extraction.resonances.zeros[0]

# The paper prints λ for a mesh of 1 mm (Table 2); these are the converged values. The mesh of the sweep is within 1e-4.
for resonance, converged in ((pole, 4.92280e10 + 7.8593e8j), (zero, 6.16142e10 + 1.05665e9j)):
    assert abs(resonance.eigenvalue / converged - 1) < 1e-4

# %% [markdown]
# ## The constants
#
# ε33T follows from the capacitance at 100 Hz; s11 and d31 follow from iterating until pole and zero of the model equal
# the measured ones, with exact sensitivities; then the whole curve is fitted. `plate.toml` sets `simplified = true`:
# the paper's isotropic simplification, with known s12.

# %%
specimen = fp.read_specimen(HERE / "plate.toml")
result = fp.update(specimen, sweep)
print(result)

target = {"s11": (15.84e-12, 0.016), "d31": (-293.25e-12, 0.013), "eps33T": (2422.5 * EPS0, 0.015)}
for name, (value, tan) in target.items():
    found = result.parameters[name]
    print(f"{name:7s} off by {found.value / value - 1:+.1e}, its tangent by {found.tan - tan:+.1e}")
    # The meshes of the sweep and of the update differ, each within 1e-4 of the converged λ and so of s11. ε33T at
    # 100 Hz is static except for (f/f_p)² ≈ 1e-5.
    assert abs(found.value / value - 1) < 1e-4
    assert abs(found.tan - tan) < 1e-5

# %% [markdown]
# ## How well a laboratory would know them
#
# The errors are below 1e-4, the standard deviations a few 1e-3: the update does not know that this plate is ideal. It
# assumes the default tolerances of dimensions, density and instrument (`plate.toml` may state smaller ones with
# `std_length`, `std_density`, `accuracy`), and the budget says which of them matters. Its parts add in squares.

# %%
for name, found in result.parameters.items():
    parts = sorted(found.budget.items(), key=lambda part: -part[1])
    words = ", ".join(f"{source} {100 * part / abs(found.value):.2g} %" for source, part in parts[:3])
    print(f"{name:7s} ± {100 * found.std / abs(found.value):.2g} %: {words}")
    assert np.isclose(np.sqrt(sum(part**2 for _, part in parts)), found.std, rtol=0.05)
    # Far more than the error above, and no more than the default 0.5 % of thickness and density can cause.
    assert 1e-3 < found.std / abs(found.value) < 8e-3

# %% [markdown]
# ## Pictures and report
#
# `save` writes the same files as `femu-piezo update plate.toml --out out --report`.

# %%
extraction.save(OUT)
result.save(OUT, report=True)
strongest = result.outcomes[0].sensitivity.strongest()[:3]
print(f"the sweep is most sensitive to {', '.join(strongest)}; pictures and report.html are in {OUT}")
assert set(strongest) == {"s11", "d31", "eps33T"}  # the paper's choice of sensitive constants (its figure 3)
