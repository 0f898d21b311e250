"""Make up.csv and down.csv: a plate that cools down while it is measured, once upwards and then, at once, downwards.

The method is not finite elements but the spectral elements of tests/hidden_effects, with a full solve with other
compliances at every frequency and 0.1 % of noise. Takes a minute: python tutorials/several_sweeps/make_sweep.py
"""

import sys
from pathlib import Path

import numpy as np

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parents[1] / "tests"))

from hidden_effects.build import Build  # noqa: E402

SIZE, DENSITY = np.array([12e-3, 6.7e-3, 1.6e-3]), 7500.0
EPS0 = 8.8541878128e-12
#: Value and loss tangent: s11 s12 s13 s33 s44 d31 d33 d15 eps11T eps33T; PZT-5H except for s11, d31 and eps33T.
TRUTH = np.array(
    [
        17.0e-12 * (1 - 0.0160j),
        -4.78e-12,
        -8.45e-12,
        20.7e-12,
        43.5e-12,
        -265e-12 * (1 - 0.0120j),
        593e-12,
        741e-12,
        3130 * EPS0,
        3500 * EPS0 * (1 - 0.0180j),
    ]
)
#: Relative rise of the resonance frequencies from the beginning of a sweep to its end; both sweeps take the same time.
DRIFT, NOISE = 1.2e-3, 1e-3
FREQUENCY = np.linspace(20e3, 240e3, 401)


def cooling(passed):
    """The compliances as a function of frequency; `passed` gives the share of the sweep's time that has passed."""

    def law(theta: np.ndarray, frequency: float) -> np.ndarray:
        found = theta.copy()
        found[:5] /= (1 + DRIFT * passed(frequency)) ** 2
        return found

    return law


if __name__ == "__main__":
    span = np.ptp(FREQUENCY)
    ways = {
        "up": lambda f: (f - FREQUENCY[0]) / span,
        "down": lambda f: 1 + (FREQUENCY[-1] - f) / span,
    }
    for seed, (name, passed) in enumerate(ways.items()):
        z = Build(SIZE, DENSITY, TRUTH, 115e3, laws=[cooling(passed)]).impedance(FREQUENCY)
        real, imag = np.random.default_rng(1 + seed).standard_normal((2, FREQUENCY.size))
        z = z * (1 + NOISE * (real + 1j * imag) / np.sqrt(2))
        rows = [f"{f:.0f},{v.real:.7g},{v.imag:.7g}\n" for f, v in zip(FREQUENCY, z, strict=True)]
        text = "frequency_Hz,resistance_ohm,reactance_ohm\n" + "".join(rows)
        (HERE / f"{name}.csv").write_text(text, encoding="utf-8")
