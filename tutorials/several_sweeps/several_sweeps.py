# %% [markdown]
# # Several sweeps of one specimen
#
# A plate of PZT-5H, 12 × 6.7 × 1.6 mm, has come out of an oven a little early: it cools down while it is measured, and
# its resonances rise by 0.12 % from the beginning of the sweep to its end. That is a thirteenth of the width of a
# resonance, and no curve looks odd. The data are not made by finite elements (`make_sweep.py`), with 0.1 % of noise.
#
# Here one sweep is not enough, the diagnosis says which second one would be, and the two together tell.

# %%
import os
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

import femu_piezo as fp

HERE = Path(__file__).parent if "__file__" in globals() else Path()
OUT = Path(os.environ.get("FEMU_PIEZO_OUT", "out")) / "several_sweeps"
#: What only a simulated measurement can offer: the truth.
TRUE_DRIFT, TRUE_S11 = 1.2e-3, (17.0e-12, 0.0160)

# %% [markdown]
# ## One sweep, upwards
#
# Something is there, and a drift explains it. So does a speck of mass on one face: the likelihoods of the two differ by
# a factor that chance alone often makes.

# %%
alone = fp.diagnose(fp.read_specimen(HERE / "plate.toml"))
(cause,) = alone.causes
print(f"{alone.verdict}: {cause}, or {', '.join(cause.indistinguishable_from)}")
print(f"drift {1e3 * cause.parameters['drift'].value:.2f} ± {1e3 * cause.parameters['drift'].std:.2f} per mille")
assert cause.effect.name == "temperature_drift" and "point_mass" in cause.indistinguishable_from

# %% [markdown]
# ## Which second sweep?
#
# For every measurement that the set-up can do at once the diagnosis computes, by its own model, how far apart the two
# causes would be. A drift turns its sign when the sweep runs backwards, and goes on between the two; a speck does not
# know in which direction the frequency runs.

# %%
pair = [one for one in alone.separations if (one.cause, one.other) == ("temperature_drift", "point_mass")]
for one in pair:
    print(f"{one.measurement:50s} {one.now:6.1f} σ now, {one.expected:6.1f} σ expected")
best = pair[0]
assert best.measurement == "sweep again in the opposite direction" and best.now < 4 and best.expected > 30

# %% [markdown]
# ## Both sweeps
#
# `both.toml` has them as `[[sweep]]` tables, with their directions. Constants, dimensions and what is wrong with the
# body are common; noise belongs to a sweep. `level_2` is where the second sweep began, in the unit of the drift.

# %%
both = fp.diagnose(fp.read_specimen(HERE / "both.toml"))
(cause,) = both.causes
drift, level = cause.parameters["drift"], cause.parameters["level_2"]
print(f"{both.verdict}: {cause}")
print(f"drift {1e3 * drift.value:.2f} ± {1e3 * drift.std:.2f}, level {1e3 * level.value:.2f} ± {1e3 * level.std:.2f}")
assert cause.effect.name == "temperature_drift" and not cause.indistinguishable_from
assert abs(drift.value - TRUE_DRIFT) < 3 * drift.std < TRUE_DRIFT


# %% [markdown]
# ## As far as was said?
#
# What the second cause misses beyond the first, √(Δχ²), with one sweep and with both. The plan did not know how long
# the pause between the sweeps would be, which is part of what tells them apart: it says whether it is worth while, not
# the last digit.


# %%
def apart(diagnosis) -> float:
    """σ by which a speck explains the data worse than a drift."""
    fits = {one.effect.name: one.fit for one in diagnosis.comparison.singles if one.fit is not None}
    return float(np.sqrt(max(0.0, fits["point_mass"].chi_square - fits["temperature_drift"].chi_square)))


reached = {"one sweep": apart(alone), "both, expected": best.expected, "both, reached": apart(both)}
for words, sigma in reached.items():
    print(f"{words:16s} {sigma:7.1f} σ")
assert reached["one sweep"] < 5 and reached["both, reached"] > 30

# %% [markdown]
# ## What it is worth
#
# With the drift in the model the tangent of s11 is known twenty times as well as without: a fit that cannot follow the
# sweep has to doubt the width of every resonance.

# %%
before, after = both.parameters_before["s11"], both.parameters["s11"]
print(
    f"tan s11 {before.tan:.5f} ± {before.tan_std:.5f} before, {after.tan:.5f} ± {after.tan_std:.5f} after, true 0.01600"
)
assert abs(after.value - TRUE_S11[0]) < 3 * after.std and abs(after.tan - TRUE_S11[1]) < 3 * after.tan_std
assert after.tan_std < 0.1 * before.tan_std
both.save(OUT, report=True)

# %%
figure = Figure(figsize=(9.0, 3.6), layout="constrained")
left, right = figure.subplots(1, 2, width_ratios=(2, 1))
data = both.comparison.base.data
count, points = data.frequency.size, data.sizes[0]
for fit, words, colour in (
    (both.comparison.base, "no cause", "#8c8c8c"),
    (both.comparison.final, "drift", "#c0392b"),
):
    error = 100 * np.abs(fit.log_error)
    for own, style in ((slice(0, points), "-"), (slice(points, count), ":")):
        way = "up" if own.start == 0 else "down"
        left.semilogy(data.frequency[own] / 1e3, error[own], style, color=colour, lw=1.1, label=f"{words}, {way}")
left.set(xlabel="frequency (kHz)", ylabel="|Δ log Z| (%)", title="what is left of both sweeps")
left.legend(frameon=False, fontsize=8, ncols=2)
bars = right.bar(
    [words.replace(", ", ",\n") for words in reached], list(reached.values()), color=["#8c8c8c", "#b8c4d6", "#c0392b"]
)
right.bar_label(bars, fmt="%.3g σ", fontsize=9)
right.set(yscale="log", ylim=(1, 3000), title="a drift apart from a speck")
right.tick_params(axis="x", labelsize=8)
figure.savefig(OUT / "told_apart.png", dpi=150)
print(f"\npictures and report.html are in {OUT}")
