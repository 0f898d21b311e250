# %% [markdown]
# # What a stated uncertainty is worth
#
# A calliper, a balance, a handbook and an impedance analyser are correct only within their tolerances. The measured
# dimensions and density of twelve plates of one ceramic are all 12.00 × 3.00 × 1.000 mm and 7500 kg/m³. The true values
# differ a little from plate to plate, the held constants differ from the handbook, and the instrument has errors within
# its data sheet. s11, d31 and ε33T are the same in all twelve plates, and known here. `sweep.csv` holds the simulated
# measurements (`make_sweep.py`: spectral elements, 0.1 % of noise, all errors drawn from the default tolerances of
# docs/explanation/budget.md).

# %%
import os
import tomllib
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

import femu_piezo as fp
from femu_piezo.study.model_cache import SharedBases

HERE = Path(__file__).parent if "__file__" in globals() else Path()
OUT = Path(os.environ.get("FEMU_PIEZO_OUT", "out")) / "stated_uncertainty"
OUT.mkdir(parents=True, exist_ok=True)
EPS0 = 8.8541878128e-12
UNIT = {"s11": (1e-12, "10⁻¹² m²/N"), "d31": (1e-12, "10⁻¹² C/N"), "eps33T": (EPS0, "ε₀")}
TRUTH = {"s11": (17.0e-12, 0.0150), "d31": (-265e-12, 0.0140), "eps33T": (3500 * EPS0, 0.0190)}

frequency_Hz, *parts = np.loadtxt(HERE / "sweep.csv", delimiter=",", skiprows=1, unpack=True)
sweeps = [
    fp.ImpedanceSpectrum.from_resistance_reactance(frequency_Hz, resistance, reactance)
    for resistance, reactance in zip(parts[::2], parts[1::2], strict=True)
]
print(f"{len(sweeps)} plates, {frequency_Hz.size} points from 20 to 200 kHz")

# %% [markdown]
# ## Two ways to update
#
# `plate.toml` states no tolerances, so the defaults apply. The other file treats every number in it as exactly known,
# as most fits in the literature do, and counts the noise of the sweep alone. (`SharedBases`: pieces of one design share
# mesh and reduced model.)

# %%
text = (HERE / "plate.toml").read_text(encoding="utf-8")
(OUT / "noise_only.toml").write_text(text + "\n[update]\nnoise_only = true\n", encoding="utf-8")
bases = SharedBases()
found = {
    words: [fp.update(fp.read_specimen(path), sweep, bases=bases).parameters for sweep in sweeps]
    for words, path in (("with tolerances", HERE / "plate.toml"), ("noise only", OUT / "noise_only.toml"))
}


def deviations(parameters) -> np.ndarray:
    """(6,) distance of s11, tan s11, d31, … from the true values in stated standard deviations."""
    pairs = [(parameters[name], *truth) for name, truth in TRUTH.items()]
    return np.ravel([((one.value - value) / one.std, (one.tan - tan) / one.tan_std) for one, value, tan in pairs])


away = {words: np.abs([deviations(one) for one in several]) for words, several in found.items()}
print(f"\n{'plate':>5s} {'farthest number, noise only':>30s} {'with tolerances':>18s}")
for number, (noise, full) in enumerate(zip(away["noise only"], away["with tolerances"], strict=True), 1):
    print(f"{number:5d} {noise.max():28.1f} σ {full.max():16.1f} σ")

# %% [markdown]
# ## Are the true values within the intervals?
#
# With noise alone the curve fits nearly as well, and the standard deviations of the constants are up to a thousand
# times smaller. But an error of 0.02 mm in the length causes an error of 0.3 % in the compliance, which no residual
# shows. (Where a sweep does show a misfit, the discrepancy widens the intervals by itself. That helps for s11 of some
# plates, but not enough.) With tolerances, the errors agree with the standard deviations.

# %%
worst = away["noise only"].max(axis=1)
print(f"\nnoise only: true values are {worst.min():.0f} to {worst.max():.0f} stated standard deviations away")
assert np.median(worst) > 20 and worst.max() > 500
inside = int(np.sum(away["with tolerances"] < 1.96))
print(f"with tolerances: {away['with tolerances'].max():.1f} at most; {inside} of 72 numbers in their 95 % intervals")
# Of 72 normal numbers 68.4 are expected within 1.96 σ and 71.8 within 3 σ; fewer than 62 within 1.96 σ have a
# probability of 1/1000.
assert away["with tolerances"].max() < 3
assert inside >= 62

# %%
figure = Figure(figsize=(9.0, 7.2), layout="constrained")
places = np.arange(1, len(sweeps) + 1)
styles = {"noise only": ("#c0392b", 0.14, "s"), "with tolerances": ("#1f4e79", -0.14, "o")}
for axes, (name, (value, _)) in zip(figure.subplots(3, 1, sharex=True), TRUTH.items(), strict=True):
    unit, words = UNIT[name]
    axes.axhline(value / unit, color="#222222", linewidth=1.2, label="true value")
    for kind, (colour, shift, marker) in styles.items():
        values = np.array([one[name].value for one in found[kind]]) / unit
        reach = 1.96 * np.array([one[name].std for one in found[kind]]) / unit
        style = {"color": colour, "fmt": marker, "markersize": 4, "capsize": 3, "linewidth": 1.4}
        axes.errorbar(places + shift, values, reach, label=f"{kind}, 95 % interval", **style)
    axes.set(ylabel=f"{name} ({words})", xticks=places)
    axes.grid(True, axis="y", color="#e6e6e6", linewidth=0.6)
axes.set_xlabel("plate")
handles = axes.get_legend_handles_labels()
figure.legend(*handles, loc="outside upper center", ncols=3, frameon=False)
figure.savefig(OUT / "intervals.png", dpi=130)

# %% [markdown]
# ## Which tolerance to improve first
#
# `identify` needs no sweep. It predicts the standard deviations that an update will state, their sources, and the
# effect of halving each tolerance. The command is `femu-piezo identify plate.toml --out out`. The list begins with the
# tolerance whose halving reduces the standard deviation of a constant most.

# %%
plan = fp.identify(HERE / "plate.toml", recommend=False)
print(f"\n{plan}")
plan.save(OUT)
first = plan.expected.improvements[0]
assert first.tolerance == "std_density" and first.best()[0] == "s11"
for name, one in plan.expected.parameters.items():
    stated = np.median([parameters[name].std / abs(parameters[name].value) for parameters in found["with tolerances"]])
    print(f"{name:7s} ± {100 * one.std / abs(one.value):.3f} % expected, {100 * stated:.3f} % stated from the sweeps")
    # The plan uses the constants of the handbook, which differ by 3 % from the true ones.
    assert abs(one.std / abs(one.value) / stated - 1) < 0.05

# %% [markdown]
# ## Is the prediction right?
#
# Suppose that a better balance gives the density to 0.25 % instead of 0.5 %. All plates are weighed again and updated
# with the new density; no sweep is measured again.

# %%
with (HERE / "pieces.toml").open("rb") as file:
    densities = [piece["density"] for piece in tomllib.load(file)["piece"]]
again = []
for density, error, sweep in zip(densities, np.random.default_rng(1).standard_normal(12), sweeps, strict=True):
    reading = f'density = "{density * (1 + 0.0025 * error):.1f} kg/m^3"\nstd_density = 0.0025'
    (OUT / "better.toml").write_text(text.replace('density = "7500 kg/m^3"', reading), encoding="utf-8")
    again.append(fp.update(fp.read_specimen(OUT / "better.toml"), sweep, bases=bases).parameters)
before = found["with tolerances"]
for name, (value, _) in TRUTH.items():
    ratio = np.median([new[name].std / old[name].std for new, old in zip(again, before, strict=True)])
    predicted = first.halved[name] / first.before[name]
    errors = [100 * np.sqrt(np.mean([(one[name].value / value - 1) ** 2 for one in some])) for some in (before, again)]
    print(
        f"{name:7s} standard deviation times {ratio:.3f}, predicted {predicted:.3f}; "
        f"rms error of the twelve plates {errors[0]:.2f} % before, {errors[1]:.2f} % after"
    )
    # The prediction was made without a measurement, by a linear model at other constants.
    assert abs(ratio / predicted - 1) < 0.02
assert max(np.abs(deviations(one)).max() for one in again) < 3
print(f"\npictures are in {OUT}")
