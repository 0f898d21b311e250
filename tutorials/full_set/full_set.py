# %% [markdown]
# # All ten constants: which sweep determines which
#
# No single specimen determines the ten constants of a 6mm ceramic. This tutorial first predicts, without measurement,
# what a k31 plate 40 × 5 × 1 mm and a k33 bar 20 × 3 × 3 mm up to 300 kHz and a k15 shear plate 4 × 2 × 1 mm up to 1.1
# MHz determine, each with 0.1 % noise and all ten complex constants free. The command for this is `femu-piezo identify
# tutorials/full_set/study.toml --out out/identify`. Then it fits k31 and k33 together and tests the prediction.

# %%
import os
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

import femu_piezo as fp
from femu_piezo.forward.model import ElectroelasticModel
from femu_piezo.forward.response import full_impedance
from femu_piezo.specimen.file import CONSTANTS, Update
from femu_piezo.study.problem import prepare

HERE = Path(__file__).parent if "__file__" in globals() else Path()
OUT = Path(os.environ.get("FEMU_PIEZO_OUT", "out")) / "full_set"
NOISE = 1e-3

# %% [markdown]
# ## Prediction
#
# The table shows the standard deviation of each constant with all others unknown; the prior is weak (±50 %).

# %%
LOTS = {
    "k31": ["k31.toml"],
    "k33": ["k33.toml"],
    "k31 + k33": ["study.toml"],
    "k15": ["k15.toml"],
    "all three": ["study.toml", "k15.toml"],
}
predicted = {
    words: fp.identify([HERE / file for file in files], NOISE, recommend=False) for words, files in LOTS.items()
}


def relative_std(words, name):
    known = predicted[words].known
    return float(known.std[known.names.index(name)])


def verdict(std):
    return "1 %" if std < 0.01 else "5 %" if std < 0.05 else "no"


print("relative standard deviation, and whether it is below 1 %, below 5 %, or neither (no)")
print(f"{'':8s}" + "".join(f"{words:>18s}" for words in LOTS))
for name in CONSTANTS:
    row = [relative_std(words, name) for words in LOTS]
    print(f"{name:8s}" + "".join(f"{100 * std:11.3f} % {verdict(std):>5s}" for std in row))


def found_by(words, limit):
    return {name for name in CONSTANTS if relative_std(words, name) < limit}


# All these standard deviations are at least 10 % away from their limits; the mesh (1e-3 in λ) changes them by less.
assert found_by("k31", 0.01) == {"s11", "s12", "s13", "d31", "d33", "eps33T"} == found_by("k31", 0.05)
assert found_by("k33", 0.05) == {"s13", "s33", "d31", "d33", "eps33T"}
assert found_by("k31 + k33", 0.01) == set(CONSTANTS) - {"s44", "d15", "eps11T"} == found_by("k31 + k33", 0.05)
assert found_by("all three", 0.01) == set(CONSTANTS)

# %% [markdown]
# These standard deviations count noise alone. An error of 20 µm in the length of 40 mm changes s11 by 0.1 %, a hundred
# times its standard deviation here: dimensions and density limit the accuracy, the sweep decides which constants can be
# determined separately.
#
# ## Test of the prediction: k31 and k33 together
#
# The sweeps are computed without reduction on other meshes, with 0.1 % noise. Seven constants are free, with start
# values wrong by 5 to 10 %. s44, d15 and ε11T, which these two sweeps do not determine, are held at their true values.

# %%
FREE = ("s11", "s12", "s13", "s33", "d31", "d33", "eps33T")
MESHES = {"k31 plate": (22, 4, 1), "k33 bar": (11, 2, 2)}
BANDS = {"k31 plate": (30e3, 46e3, 300e3), "k33 bar": (55e3, 110e3, 300e3)}
truth = None
specimens, sweeps = [], []
rng = np.random.default_rng(7)
for specimen in fp.read_specimens([HERE / "study.toml"]):
    problem = prepare(specimen)
    truth = problem.constants
    low, middle, high = BANDS[specimen.name]
    frequency = np.concatenate([[1e3], np.linspace(low, middle, 61), np.linspace(middle, high, 141)[1:]])
    model = ElectroelasticModel(problem.plate.domain(MESHES[specimen.name]), problem.density)
    impedance = full_impedance(model, truth.to_e_form(), frequency)
    error = rng.standard_normal((2, frequency.size)) * NOISE / np.sqrt(2)
    noisy = impedance * (1 + error[0] + 1j * error[1])
    sweeps.append(fp.ImpedanceSpectrum.from_impedance(frequency, noisy, relative_noise=NOISE, source=specimen.name))
    wrong = {
        name: getattr(truth, name).real * factor
        for name, factor in zip(FREE, (1.08, 0.95, 1.06, 0.93, 1.07, 0.92, 1.1), strict=True)
    }
    material = specimen.material.model_copy(update=wrong | {"free": FREE})
    # The specimens are ideal and the prediction counts noise alone, so this fit does too.
    specimens.append(specimen.model_copy(update={"material": material, "update": Update(noise_only=True)}))

result = fp.update(specimens, sweeps)
print(f"\n{'':8s}{'true':>12s}{'found':>12s}{'error':>10s}{'std':>10s}{'tan true':>10s}{'tan found':>11s}")
for name in FREE:
    exact, estimate = getattr(truth, name), result.parameters[name]
    off, std = estimate.value / exact.real - 1, estimate.std / abs(estimate.value)
    print(
        f"{name:8s}{exact.real:12.4e}{estimate.value:12.4e}{100 * off:8.3f} %{100 * std:8.3f} %"
        f"{truth.tangent(name):10.4f}{estimate.tan:11.4f}"
    )
    # Four standard deviations, and the error that two meshes of 1e-4 in λ at 300 kHz cause in a constant that follows
    # from weak modes.
    assert abs(off) < 4 * std + 1e-3
    assert std < 0.01

# %% [markdown]
# ## Pictures

# %%
figure = Figure(figsize=(8.0, 4.5), layout="constrained")
axes = figure.subplots()
for offset, words in enumerate(LOTS):
    values = [100 * relative_std(words, name) for name in CONSTANTS]
    axes.bar(np.arange(10) + 0.16 * (offset - 2), values, 0.15, label=words, bottom=1e-4)
axes.set(yscale="log", xticks=range(10), xticklabels=CONSTANTS, ylabel="standard deviation (%)", ylim=(1e-4, 100))
axes.axhline(1, color="#1e7d45", linestyle=":", linewidth=1)
axes.axhline(5, color="#b03024", linestyle=":", linewidth=1)
axes.set_title("which sweep determines which constant (0.1 % noise; below 1 %: well, above 5 %: not)")
axes.legend(frameon=False, ncols=5, loc="upper center", bbox_to_anchor=(0.5, -0.08))
result.save(OUT, report=True)
figure.savefig(OUT / "determined.png", dpi=150)
for words in ("k31", "k33", "k15"):
    predicted[words].plot().savefig(OUT / f"sensitivity_{words}.png", dpi=150)
print(f"pictures and report.html are in {OUT}")
