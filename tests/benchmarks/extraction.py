"""Prints the table of the extraction: errors over the Cramér-Rao bound, for this and other methods.

    OMP_NUM_THREADS=1 python -m tests.benchmarks.extraction [--draws 200]

from the repository root. Truth: the exact 1-D bar (tests/extraction/bar.py); bound: tests/extraction/bounds.py.
"""

from __future__ import annotations

import argparse
import os
import time
import warnings
from pathlib import Path

import numpy as np
from scipy.interpolate import AAA

from femu_piezo.extraction import extract
from femu_piezo.extraction.prony_ss import prony_ss
from femu_piezo.measurement.readers import read_spectrum
from femu_piezo.measurement.spectrum import ImpedanceSpectrum
from tests.noise import noisy

from ..extraction.bar import Bar, close_pair, sweep, truth_of
from ..extraction.bounds import cramer_rao, score

BAR = Bar()
UNIFORM = {"fundamental": (np.linspace(28e3, 48e3, 401), 1), "first overtone": (np.linspace(90e3, 130e3, 401), 2)}


def ours(spectrum):
    """The maximum-likelihood extraction: λ and stated deviations of the strongest pole and zero."""
    found = extract(spectrum).resonances
    return tuple(
        (r.eigenvalue, np.sqrt(np.diag(r.covariance)))
        for r in (max(group, key=lambda r: abs(r.residue)) for group in (found.poles, found.zeros))
    )


def prony(spectrum):
    """Prony-SS: the column of largest residue of Y and of Z."""
    runs = [prony_ss(spectrum, kind) for kind in ("pole", "zero")]
    if not all(run.diagram.columns for run in runs):
        return None
    return tuple((run.diagram.columns[int(np.argmax(abs(run.residues)))].eigenvalue, None) for run in runs)


def aaa(spectrum, noise):
    """scipy AAA in ω² to the noise level: the strongest lossy pole in the sweep, of Q = Y/(jω) and of 1/Q."""
    s = spectrum.omega**2
    charge = spectrum.admittance / (1j * spectrum.omega)
    found = []
    for values in (charge / abs(charge).mean(), abs(charge).mean() / charge):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RuntimeWarning)  # AAA warns if the tolerance was not met
            approximant = AAA(s / s[-1], values, rtol=max(noise, 1e-13), max_terms=20)
            poles, residues = approximant.poles() * s[-1], approximant.residues()
        keep = (poles.real > s[0]) & (poles.real < s[-1]) & (poles.imag > 0)
        if not np.any(keep):
            return None
        found.append((poles[keep][np.argmax(abs(residues[keep]))], None))
    return tuple(found)


def vector_fitting(spectrum, real=1, pairs=2):
    """scikit-rf vector fitting of Y and of Z: real poles and pairs, constant and proportional term.

    Of the poles inside the sweep the one of largest residue; two pairs do best of 1-3 on these sweeps.
    """
    import skrf
    from skrf.vectorFitting import VectorFitting

    grid = skrf.Frequency.from_f(spectrum.frequency, unit="hz")
    network = skrf.Network(frequency=grid, z=spectrum.impedance.reshape(-1, 1, 1), z0=50)
    found = []
    for kind in ("y", "z"):
        fitting = VectorFitting(network)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # scikit-rf warns about passivity and convergence
            fitting.vector_fit(real, pairs, "lin", kind, fit_constant=True, fit_proportional=True, enforce_dc=False)
        low, high = 2 * np.pi * spectrum.frequency[[0, -1]]
        keep = (fitting.poles.imag > low) & (fitting.poles.imag < high) & (fitting.poles.real < 0)
        if not np.any(keep):
            return None
        strongest = np.argmax(abs(fitting.residues[0][keep]))
        found.append((-(fitting.poles[keep][strongest] ** 2), None))
    return tuple(found)


def half_power(spectrum):
    """Peak of G (for the pole) and of R (for the zero) and its width at half height, points joined by straight
    lines.
    """
    found = []
    for part in (spectrum.admittance.real, spectrum.impedance.real):
        top = int(np.argmax(part))
        level = part[top] / 2
        below = np.flatnonzero(part[:top] < level)
        above = np.flatnonzero(part[top:] < level)
        if below.size == 0 or above.size == 0:
            return None
        i, j = below[-1], top + above[0]
        f = spectrum.frequency
        low = np.interp(level, part[[i, i + 1]], f[[i, i + 1]])
        high = np.interp(level, part[[j, j - 1]], f[[j, j - 1]])
        found.append(((2 * np.pi * f[top]) ** 2 * (1 + 1j * (high - low) / f[top]), None))
    return tuple(found)


def methods(noise):
    """Name → method, a function of a spectrum."""
    return {
        "maximum likelihood": ours,
        "scipy AAA": lambda s: aaa(s, noise),
        "vector fitting": vector_fitting,
        "Prony-SS": prony,
        "half power": half_power,
    }


def noise_free() -> None:
    """Print relative errors of λ without noise."""
    print("\nNoise-free, relative error of λ (goal: rational 1e-8, Prony-SS 1e-5)")
    for name, (frequency, n) in UNIFORM.items():
        (pole, _), (zero, _) = ours(sweep(BAR, frequency))
        print(
            f"  rational fit, {name:15} pole {abs(pole / BAR.pole(n) - 1):.1e}  zero {abs(zero / BAR.zero(n) - 1):.1e}"
        )
    wide = sweep(BAR, np.arange(100.0, 300_001.0, 100.0))
    for kind in ("pole", "zero"):
        columns = prony_ss(wide, kind).diagram.columns
        errors = [min(abs(c.eigenvalue / getattr(BAR, kind)(n) - 1) for c in columns) for n in (1, 2, 3)]
        print(f"  Prony-SS, 100 Hz - 300 kHz, {kind} 1-3: " + "  ".join(f"{e:.1e}" for e in errors))


def against_bound(title, truth, frequency, noise, draws, names=None) -> None:
    """Print a block of rows: each method over `draws` draws of the noise."""
    bound = cramer_rao(truth, frequency, noise)
    omega = 2 * np.pi * frequency
    exact = 1 / (1j * omega * truth.charge(omega))
    targets = (truth.poles[0], truth.zeros[0])
    print(f"\n{title}, {frequency.size} points, noise {noise:g}, {draws} draws, degree {bound.degree} in the bound")
    print(
        f"  {'method':20}{'':5}{'rms/bound':>10}{'median':>9}{'bias/σ':>9}{'68 %':>7}{'95 %':>7}{'failed':>8}{'ms':>7}"
    )
    for name, method in methods(noise).items():
        if names is not None and name not in names:
            continue
        results, started = [], time.perf_counter()
        for draw in range(draws):
            seed = [draw, int(1 / noise), frequency.size, int(frequency[0])]
            results.append(method(ImpedanceSpectrum(frequency, noisy(exact, noise, seed))))
        spent = 1e3 * (time.perf_counter() - started) / draws
        good = [r for r in results if r is not None]
        for i, kind in enumerate(("pole", "zero")):
            if not good:
                print(f"  {name:20}{kind:5}{'-':>10}{'-':>9}{'-':>9}{'-':>7}{'-':>7}{draws:>8}{spent:>7.0f}")
                continue
            errors = [r[i][0] - targets[i] for r in good]
            stated = [r[i][1] for r in good] if name == "maximum likelihood" else None
            s = score(errors, stated, (bound.poles if i == 0 else bound.zeros)[0])
            cover = "".join(f"{'-':>7}" if np.isnan(c) else f"{100 * c:>7.1f}" for c in (s.cover68, s.cover95))
            figures = f"{s.rms:>10.3g}{s.median:>9.3g}{s.bias:>9.2g}{cover}"
            print(f"  {name:20}{kind:5}{figures}{draws - len(good):>8}{spent:>7.0f}")


def close_modes(draws) -> None:
    """Print errors for a second mode 1 % above the first with a residue 40 dB below."""
    frequency = np.linspace(28e3, 48e3, 401)
    truth = close_pair(BAR)
    omega = 2 * np.pi * frequency
    exact = 1 / (1j * omega * truth.charge(omega))
    print("\nTwo modes 1 % apart, residues 40 dB apart, loss 0.016 (width 1.6 %), 28-48 kHz, 401 points")
    for noise in (1e-5, 1e-4, 1e-3):
        bound = cramer_rao(truth, frequency, noise)
        errors = {"strong pole": [], "weak pole": [], "strong zero": [], "weak zero": []}
        seen = 0
        for draw in range(draws):
            found = extract(ImpedanceSpectrum(frequency, noisy(exact, noise, [draw, 7]))).resonances
            if len(found.poles) != 2 or len(found.zeros) != 2:
                continue
            seen += 1
            for kind, group, values in (("pole", found.poles, truth.poles), ("zero", found.zeros, truth.zeros)):
                first = min(group, key=lambda r: abs(r.eigenvalue - values[0]))
                second = group[1 - group.index(first)]
                errors[f"strong {kind}"].append(first.eigenvalue - values[0])
                errors[f"weak {kind}"].append(second.eigenvalue - values[1])
        limits = dict(zip(errors, (*bound.poles, *bound.zeros), strict=True))
        ratios = "  ".join(
            f"{name} {np.sqrt(np.mean(np.abs(e) ** 2)) / limits[name]:.2f}" for name, e in errors.items() if e
        )
        weak = bound.poles[1] / abs(truth.poles[1])
        print(f"  noise {noise:g}: both found {seen}/{draws}, bound of the weak λ {weak:.1e}; rms/bound: {ratios}")


def measured(folder: Path) -> None:
    """Print poles, zeros and quality factors of the measured sweeps."""
    if not folder.is_dir():
        print(f"\nmeasured sweeps are not at {folder}; set FEMU_PIEZO_MEASURED")
        return
    print("\nMeasured sweeps (deviations from leaving out eighths and twelfths of the sweep)")
    for name in ("k31_bar_pzt_12x3x1mm.txt", "disk_radial_35x2mm.csv", "hp4294a_sample.txt"):
        found = extract(read_spectrum(folder / name, correct_phase=name.startswith("hp")))
        print(f"  {name}: residual rms {np.sqrt(found.reduced_chi_square):.2f} σ, status {found.status}")
        for r in (*found.resonances.poles, *found.resonances.zeros):
            print(
                f"    {r.kind} {r.frequency_Hz:10.1f} ± {r.std_Hz:6.1f} Hz  loss {r.loss:.5f} ± {r.std_loss:.5f}"
                f"  Q {r.quality_factor:6.1f}"
            )
        for pair in found.pairs:
            print(f"    k_eff {pair.k_eff:.4f} ± {pair.std_k_eff:.4f}")
        for remark in found.remarks:
            print(f"    {remark}")


def main() -> None:
    """Print every table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--draws", type=int, default=200)
    draws = parser.parse_args().draws
    started = time.perf_counter()
    noise_free()
    for name, (frequency, n) in UNIFORM.items():
        for noise in (1e-4, 1e-3, 3e-3):
            against_bound(name, truth_of(BAR, n), frequency, noise, draws)
    paper = np.arange(100.0, 100_001.0, 100.0)
    against_bound(
        "fundamental, the paper's kind of sweep from 100 Hz", truth_of(BAR, 1), paper, 1e-3, draws,
        ["maximum likelihood", "Prony-SS"],
    )  # fmt: skip
    refined = np.unique(
        np.concatenate([np.linspace(28e3, 48e3, 121), np.linspace(34.8e3, 35.9e3, 40), np.linspace(39e3, 40.2e3, 40)])
    )
    grids = {
        "uniform": [np.linspace(28e3, 48e3, n) for n in (61, 201, 1601)],
        "logarithmic": [np.geomspace(28e3, 48e3, 201)],
        "refined around pole and zero": [refined],
    }
    for name, list_ in grids.items():
        for frequency in list_:
            against_bound(f"fundamental, {name}", truth_of(BAR, 1), frequency, 1e-3, draws, ["maximum likelihood"])
    close_modes(draws)
    here = Path(__file__).resolve().parents[3] / "shared" / "measured"
    measured(Path(os.environ.get("FEMU_PIEZO_MEASURED", here)))
    print(f"\n{time.perf_counter() - started:.0f} s, {Path(__file__).name}")


if __name__ == "__main__":
    main()
