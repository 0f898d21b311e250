# %% [markdown]
# # Finding a hidden effect
#
# The specimen is a plate of PZT-5H, 20 × 6 × 1 mm, with a sweep with 0.1 % of noise. The sweep contains an effect that
# the finite element model of a plate does not contain. The data were not made by finite elements (`make_sweep.py`:
# Rayleigh-Ritz with Legendre polynomials, an independent discretisation). The band from 195 to 225 kHz, which contains
# the third length mode, is held out: no fit below uses it.

# %%
import os
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

import femu_piezo as fp

HERE = Path(__file__).parent if "__file__" in globals() else Path()
OUT = Path(os.environ.get("FEMU_PIEZO_OUT", "out")) / "hidden_effect"
EPS0 = 8.8541878128e-12

#: The true constants, which are known because the measurement is simulated: value in UNIT, loss tangent.
TRUTH = {"s11": (17.0, 0.0140), "d31": (-265.0, 0.0120), "eps33T": (3500.0, 0.0180)}
UNIT = {"s11": 1e-12, "d31": 1e-12, "eps33T": EPS0}

# %% [markdown]
# ## The result of an update
#
# The curves look the same. `update` notes that the misfit exceeds the noise, and widens the intervals, but it does not
# find the reason, and the loss tangents are wrong.

# %%
specimen = fp.read_specimen(HERE / "plate.toml")
plain = fp.update(specimen)
print("\n".join(plain.notes))
print(f"rms |Δ log Z| {100 * plain.outcomes[0].rms_after:.2f} % (noise 0.10 %)")
for name, (_, tangent) in TRUTH.items():
    found = plain.parameters[name]
    print(f"  tan {name:7s} {found.tan:.5f} ± {found.tan_std:.5f}   true {tangent:.4f}")
assert plain.parameters["d31"].tan > 1.2 * TRUTH["d31"][1]

# %% [markdown]
# ## The result of the diagnosis
#
# `diagnose` fits every candidate effect of the library together with the constants, on one reduced model for all
# candidates. It names the set of causes with the highest posterior probability; the evidence penalises additional
# parameters.

# %%
result = fp.diagnose(specimen)
print(f"\n{result}")
(cause,) = result.causes
assert result.verdict == "effect" and str(cause) == "series_resistance"
# The data contain 1.5 Ω; the standard deviation is that of the diagnosis.
resistance = cause.parameters["resistance"]
assert abs(resistance.value - 1.5) < 3 * resistance.std < 0.15

# %% [markdown]
# ## Pole by pole
#
# The resistance hardly changes the frequencies. It reduces Q at the poles, where |Z| is small and 1.5 Ω matters. The
# fit without the resistance compensates for this by the loss tangents: too much loss at every pole, more at some
# than at others, and no tangents are right for all.

# %%
base, final = result.pole_zero
print(f"\n{'':6s}{'measured':>12s}{'ΔQ before':>20s}{'ΔQ after':>20s}")
for before, after in zip(base.poles, final.poles, strict=True):
    words = [f"{share:+.2f} % ({sigma:+.1f} σ)" for share, sigma in (before.quality, after.quality)]
    print(f"pole  {before.measured.frequency_Hz / 1e3:8.3f} kHz{words[0]:>20s}{words[1]:>20s}")
assert max(abs(one.quality[1]) for one in base.poles) > 10
assert max(abs(one.quality[1]) for one in final.poles) < 4

# %% [markdown]
# ## The gain
#
# The held-out band is an independent test, since no fit used it. With the resistance in the model, the constants also
# agree with their true values.

# %%
gain = result.gain
print(
    f"\nerror in the held-out band: {100 * gain['held_out_before']:.3f} % before, {100 * gain['held_out_after']:.3f} % "
    f"after, noise {100 * gain['noise_floor']:.3f} %"
)
assert gain["held_out_after"] < 1.3 * gain["noise_floor"] < 0.35 * gain["held_out_before"]
bias = {}
print(f"{'':10s}{'before':>10s}{'after':>20s}{'true':>8s}")
constants = [result.parameters_before, result.parameters]
for name, (_, tangent) in TRUTH.items():
    old, new = (one[name] for one in constants)
    bias[f"tan {name}"] = [(one.tan - tangent) / new.tan_std for one in (old, new)]
    print(f"tan {name:6s}{old.tan:10.5f}{new.tan:12.5f} ± {new.tan_std:.5f}{tangent:8.4f}")
for name, (value, _) in TRUTH.items():
    old, new = (one[name] for one in constants)
    bias[name] = [(one.value / UNIT[name] - value) / (new.std / UNIT[name]) for one in (old, new)]
# Before, the errors are tens of the standard deviations after. After, all six numbers are within 3.5 of them (the
# probability that one of six normal numbers is not is 1/350).
assert max(abs(before) for before, _ in bias.values()) > 30
assert max(abs(after) for _, after in bias.values()) < 3.5

# %% [markdown]
# ## The extended specimen
#
# `save` writes the same files as `femu-piezo diagnose plate.toml --out out --report`. Among them, `extended.toml` is
# the specimen file with the effect and with the corrected constants in `[fitted]`. All commands take it like any other
# specimen file. `femu-piezo diagnose out/hidden_effect/extended.toml --out out` says *none*; here the update is
# repeated, and its misfit is now the noise.

# %%
result.save(OUT, report=True)
text = (OUT / "extended.toml").read_text(encoding="utf-8")
print("\n" + text[text.index("[effects") :].strip())
again = fp.update(OUT / "extended.toml")
print(f"updated again: rms |Δ log Z| {100 * again.outcomes[0].rms_after:.3f} % (noise 0.100 %)")
assert again.outcomes[0].rms_after < 1.1e-3 < 3e-3 < plain.outcomes[0].rms_after
for name, (_, tangent) in TRUTH.items():
    assert abs(again.parameters[name].tan - tangent) < 4 * again.parameters[name].tan_std

# %% [markdown]
# ## What this sweep cannot show
#
# A capacitance in parallel with the plate has almost exactly the effect of a larger ε33T. The diagnosis says so and
# names the measurement that separates the two.

# %%
hidden = {effect.name: constant for effect, constant in result.verdict.hidden}
print(f"\nnot visible: {', '.join(f'{name} (looks like {constant})' for name, constant in hidden.items())}")
for words in result.verdict.measurements:
    if "stray" in words:
        print(f"  {words}")
assert hidden["stray_capacitance"] == "eps33T"

# %%
figure = Figure(figsize=(8.0, 3.8), layout="constrained")
axes = figure.subplots()
places = np.arange(len(bias))
axes.axhspan(-3, 3, color="#dfe8df", zorder=0, label="± 3 standard deviations")
axes.plot(places, [before for before, _ in bias.values()], "o", color="#8c8c8c", label="without the effect")
axes.plot(places, [after for _, after in bias.values()], "o", color="#c0392b", label="with the series resistance")
axes.set(xticks=places, xticklabels=list(bias), ylabel="distance from the truth (σ)", yscale="symlog", ylim=(-200, 200))
axes.set_title("errors of the constants by 1.5 Ω in the leads", fontsize=11)
axes.legend(frameon=False, fontsize=9)
figure.savefig(OUT / "bias.png", dpi=150)
print(f"\npictures and report.html are in {OUT}")
