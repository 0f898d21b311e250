# %% [markdown]
# # Several sweeps of one specimen
#
# A plate of PZT-5H, 12 × 6.7 × 1.6 mm, comes out of an oven and cools down while it is measured: its resonance
# frequencies rise by 0.12 % from the beginning of the sweep to its end. That is a thirteenth of the width of a
# resonance, and the curve looks normal. The data are not made by finite elements (`make_sweep.py`); they have 0.1 % of
# noise.
#
# One sweep does not determine the cause here. The diagnosis says which second sweep would, and both together do.

# %%
import os
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

import femu_piezo as fp

HERE = Path(__file__).parent if "__file__" in globals() else Path()
OUT = Path(os.environ.get("FEMU_PIEZO_OUT", "out")) / "several_sweeps"
#: The true values, which are known because the measurement is simulated.
TRUE_DRIFT, TRUE_S11 = 1.2e-3, (17.0e-12, 0.0160)

# %% [markdown]
# ## One sweep, upwards
#
# A drift explains the misfit, and so does a speck of mass on one face: the likelihoods of the two causes differ by a
# factor that often occurs by chance.

# %%
alone = fp.diagnose(fp.read_specimen(HERE / "plate.toml"))
(cause,) = alone.causes
print(f"{alone.verdict}: {cause}, or {', '.join(cause.indistinguishable_from)}")
print(f"drift {1e3 * cause.parameters['drift'].value:.2f} ± {1e3 * cause.parameters['drift'].std:.2f} per mille")
assert cause.effect.name == "temperature_drift" and "point_mass" in cause.indistinguishable_from

# %% [markdown]
# ## Which second sweep?
#
# For every measurement that is possible with the same set-up, the diagnosis predicts from the model by how many σ it
# would separate the two causes. The effect of a drift changes its sign when the sweep runs downwards, and the drift
# continues between the sweeps; the effect of a speck does not depend on the direction of the sweep.

# %%
pair = [one for one in alone.separations if (one.cause, one.other) == ("temperature_drift", "point_mass")]
for one in pair:
    print(f"{one.measurement:50s} {one.now:6.1f} σ now, {one.expected:6.1f} σ expected")
best = pair[0]
assert best.measurement == "sweep again in the opposite direction" and best.now < 4 and best.expected > 30

# %% [markdown]
# ## Both sweeps
#
# `both.toml` names the sweeps in two `[[sweep]]` tables with their directions. Constants, dimensions and effects of the
# body are common to both sweeps; the noise is not. `level_2` is the change of the resonance frequencies at the
# beginning of the second sweep, in the unit of the drift.

# %%
both = fp.diagnose(fp.read_specimen(HERE / "both.toml"))
(cause,) = both.causes
drift, level = cause.parameters["drift"], cause.parameters["level_2"]
print(f"{both.verdict}: {cause}")
print(f"drift {1e3 * drift.value:.2f} ± {1e3 * drift.std:.2f}, level {1e3 * level.value:.2f} ± {1e3 * level.std:.2f}")
assert cause.effect.name == "temperature_drift" and not cause.indistinguishable_from
assert abs(drift.value - TRUE_DRIFT) < 3 * drift.std < TRUE_DRIFT


# %% [markdown]
# ## Was the prediction right?
#
# The separation of the causes in σ is √(Δχ²), the difference of their misfits, with one sweep and with both. It depends
# on the pause between the sweeps, which the plan could not know: the prediction shows whether the measurement is worth
# while, not the exact separation.


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
# ## The gain
#
# With the drift in the model, the standard deviation of the tangent of s11 is more than ten times smaller than without
# it: a model that does not fit the sweep cannot determine the width of a resonance.

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
left.set(xlabel="frequency (kHz)", ylabel="|Δ log Z| (%)", title="residuals of both sweeps")
left.legend(frameon=False, fontsize=8, ncols=2)
bars = right.bar(
    [words.replace(", ", ",\n") for words in reached], list(reached.values()), color=["#8c8c8c", "#b8c4d6", "#c0392b"]
)
right.bar_label(bars, fmt="%.3g σ", fontsize=9)
right.set(yscale="log", ylim=(1, 3000), title="separation of drift and speck")
right.tick_params(axis="x", labelsize=8)
figure.savefig(OUT / "told_apart.png", dpi=150)
print(f"\npictures and report.html are in {OUT}")
