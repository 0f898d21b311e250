# %% [markdown]
# # Writing your own effect: solder on the ends of a bar
#
# A k31 bar, 30 × 5 × 1 mm, has wires soldered to its two ends. The library has no effect for a mass on an end. This
# tutorial writes one, checks it against theory, and lets the diagnosis find it in a sweep (`make_sweep.py`:
# Rayleigh-Ritz, not finite elements; 22.5 mg on each end, 2 % of the bar; 0.2 % of noise).
#
# The model is the sum A(ω, θ) = Σ_q c_q(ω, θ) A_q − ω² M. An effect is described by data: further matrices A_q with
# their coefficients, or a change of the constants or of the dimensions, or a circuit at the terminals. The file
# `effects/end_mass.py` contains the weak form ∫ v·u dS over the end face, the coefficient m/A with its derivative, the
# parameter with unit and bounds, and a sentence in words.

# %%
import os
import sys
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from scipy.optimize import brentq

import femu_piezo as fp
from femu_piezo.diagnosis.rules import Rules
from femu_piezo.forward.eigen import solve_eigen
from femu_piezo.forward.model import ElectroelasticModel
from femu_piezo.geometry.shapes import Plate
from femu_piezo.material.library import library_material

HERE = Path(__file__).parent if "__file__" in globals() else Path()
OUT = Path(os.environ.get("FEMU_PIEZO_OUT", "out")) / "own_effect"
sys.path.insert(0, str(HERE / "effects"))

import end_mass  # noqa: E402

# %% [markdown]
# ## Check of the matrix
#
# One eighth of the bar is computed, with a quarter of the end face. The integral of one over that quarter is its area.
# A thin bar with a mass m on each end has its poles where cot X = 2 (m/M) X, f = X/(π L √(ρ s11)).

# %%
pzt = library_material("pzt-5h")
bar = Plate(length=30e-3, width=2e-3, thickness=1e-3)  # thinner than the specimen: closer to the formula
model = ElectroelasticModel(bar.domain(divisions=(14, 1, 1)), pzt.density)
surface = end_mass.end_face(model)
size = surface.shape[0] // 4
area = surface[:size, :size].sum()
print(f"end face: {4e6 * area:.6f} mm² by the matrix, {2e-3 * 1e-3 * 1e6:.6f} mm² by its sides")
assert abs(4 * area / (2e-3 * 1e-3) - 1) < 1e-12

loaded = ElectroelasticModel(bar.domain(divisions=(14, 1, 1)), pzt.density, extra_terms={"end mass": surface})
mass, section = bar.volume * pzt.density, 2e-3 * 1e-3
constants = pzt.constants.to_e_form()


def thin_bar(share, mode):
    """Frequency of a length mode with m/M = share, thin bar."""
    centre = (mode - 0.5) * np.pi
    x = brentq(lambda x: np.cos(x) - 2 * share * x * np.sin(x), centre - 1.2, centre + 1e-9)
    return x / (np.pi * bar.length * np.sqrt(pzt.density * pzt.constants.s11.real))


def pole(share, mode):
    """The same by finite elements; the iteration is needed because the inertia −ω² m/A depends on the frequency."""
    frequency = thin_bar(share, mode)
    for _ in range(8):
        load = {"end mass": -((2 * np.pi * frequency) ** 2) * share * mass / section}
        found = solve_eigen(loaded, constants, "short", count=3, near_Hz=0.97 * frequency, extra=load)
        frequency = float(np.sqrt(found.eigenvalues[found.dominant_index(frequency)].real) / (2 * np.pi))
    return frequency


shares = (0.01, 0.02, 0.05)
print(f"\nshift of the pole{'first mode':>14s}{'thin bar':>14s}{'second mode':>14s}{'thin bar':>14s}")
shifts = []
for share in shares:
    shifts.append([by(share, n) / by(0.0, n) - 1 for n in (1, 2) for by in (pole, thin_bar)])
    print(f"m/M = {share:4.2f}       " + "".join(f"{100 * value:12.3f} %" for value in shifts[-1]))
first, thin_first, second, thin_second = np.array(shifts).T
# The difference to the thin bar is due to lateral inertia: (w/L)² = 0.4 % at the first mode, more at the second.
assert np.allclose(first, thin_first, rtol=4e-3) and np.allclose(second, thin_second, rtol=0.01)

# %% [markdown]
# ## What to expect
#
# To first order the frequencies of both modes fall by the same share 2 m/M, exactly as with a larger s11. The shares
# differ only where 2 (m/M) X is no longer small. So length modes cannot separate a light dot of solder from s11; that
# takes a heavy dot, or a mode across the width.

# %% [markdown]
# ## Diagnosis with a library that lacks the cause
#
# `diagnose` can name only effects of the library. If the true cause is missing, other candidates may imitate it, and
# only the remaining misfit shows this. (Three causes together may even explain the whole misfit: if a diagnosis names
# three causes at once, or one with an absurd size such as a negative inductance, inspect the specimen.)

# %%
specimen = fp.read_specimen(HERE / "bar.toml")
before = fp.diagnose(specimen, rules=Rules(most_causes=1))
print(f"\nwithout the new effect: {before.verdict}; causes: {', '.join(map(str, before.causes)) or 'none'}")
left = np.sqrt(before.verdict.after.size)
print(f"  remaining misfit: {left:.2f} times the noise")
assert left > 1.2 and before.verdict.after.structured  # the misfit exceeds the noise

# %% [markdown]
# ## Diagnosis with the new effect
#
# The library is a list of functions; each takes the description of a specimen (an `EffectContext`) and returns the
# effects that the specimen may have. You can add a function, or an `Effect`, to the list. (In a checkout, put the file
# into the folder `femu_piezo/effects/library`. Specimen files cannot add effects: they never run code.)

# %%
after = fp.diagnose(specimen, effects=[*fp.effects.library, end_mass.candidates])
print(f"\nwith the new effect:\n{after}")

(cause,) = after.causes
assert after.verdict == "effect" and str(cause) == "end_mass"
# The data contain 22.5 mg; the standard deviation is that of the diagnosis.
mass = cause.parameters["mass"]
assert abs(mass.value - 22.5e-6) < 3 * mass.std < 2e-6

# %% [markdown]
# The saved file `extended.toml` has a table `[effects.end_mass]`; a function that reads this file needs the effect.

# %%
after.save(OUT)
again = fp.update(OUT / "extended.toml", effects=[end_mass.candidates])
print(f"updated with the mass: rms |Δ log Z| {100 * again.outcomes[0].rms_after:.3f} % (noise 0.2 %)")
assert again.outcomes[0].rms_after < 2.2e-3

# %% [markdown]
# ## The error of s11 without the effect
#
# Without the mass in the model, s11 is 8 % too large, with a standard deviation of 0.2 %: a precise but wrong result.

# %%
gain = after.gain
old, new = after.parameters_before["s11"], after.parameters["s11"]
print(f"\ns11: {old.value * 1e12:.3f} without, {new.value * 1e12:.3f} ± {new.std * 1e12:.3f} with the mass; true 16.8")
print(f"error in data that no fit used: {100 * gain['held_out_before']:.2f} % before, ", end="")
print(f"{100 * gain['held_out_after']:.2f} % after")
assert old.value / 16.8e-12 > 1.05 and abs(new.value - 16.8e-12) < 3 * new.std
assert gain["held_out_after"] < 1.3 * gain["noise_floor"]

# %%
figure = Figure(figsize=(8.0, 4.5), layout="constrained")
axes = figure.subplots()
kilohertz = after.spectrum.frequency * 1e-3
sigma = after.relative_noise / np.sqrt(2)
for curve, color, words in zip(
    (after.curves[0], after.curves[1]), ("#8c8c8c", "#c0392b"), ("bar alone", "with solder on its ends"), strict=True
):
    axes.plot(
        kilohertz, np.log(curve / after.spectrum.impedance).real / sigma, ".", color=color, label=words, markersize=4
    )
axes.axhspan(-2, 2, color="#dfe8df", zorder=0)
axes.set(xlabel="frequency (kHz)", ylabel="residual of log |Z| (σ)")
axes.set_title(f"solder on the ends of a bar: {1e6 * mass.value:.1f} ± {1e6 * mass.std:.1f} mg on each end")
axes.legend(frameon=False)
figure.savefig(OUT / "end_mass.png", dpi=150)
print(f"pictures are in {OUT}")
