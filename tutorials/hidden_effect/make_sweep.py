"""Make sweep.csv: the simulated measurement of a plate whose leads have a resistance that is not compensated.

The method is not finite elements but Rayleigh-Ritz with global Legendre polynomials (tests/hidden_effects/ritz.py),
with a full solve at every frequency and 0.1 % of noise. Takes half a minute: python
tutorials/hidden_effect/make_sweep.py
"""

import sys
from pathlib import Path

import numpy as np

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parents[1] / "tests"))

from hidden_effects.ritz import RitzPlate  # noqa: E402

SIZE, DENSITY = (20e-3, 6e-3, 1e-3), 7500.0
EPS0 = 8.8541878128e-12
#: Value and loss tangent: s11 s12 s13 s33 s44 d31 d33 d15 eps11T eps33T; PZT-5H except for s11, d31 and eps33T.
TRUTH = np.array(
    [
        17.0e-12 * (1 - 0.0140j),
        -4.78e-12 * (1 - 0.015j),
        -8.45e-12 * (1 - 0.015j),
        20.7e-12 * (1 - 0.015j),
        43.5e-12 * (1 - 0.015j),
        -265e-12 * (1 - 0.0120j),
        593e-12 * (1 - 0.015j),
        741e-12 * (1 - 0.015j),
        3130 * EPS0 * (1 - 0.015j),
        3500 * EPS0 * (1 - 0.0180j),
    ]
)
RESISTANCE, NOISE = 1.5, 1e-3

if __name__ == "__main__":
    frequency = np.arange(20e3, 230e3 + 1, 500.0)
    z = RitzPlate(SIZE, DENSITY, (16, 9, 6)).impedance(TRUTH, frequency)
    finer = RitzPlate(SIZE, DENSITY, (20, 11, 7)).impedance(TRUTH, frequency[::20])
    error = np.max(np.abs(z[::20] / finer - 1))
    print(f"largest relative error of Z by the orders of the polynomials: {error:.1e}")
    assert error < 0.3 * NOISE
    real, imag = np.random.default_rng(31).standard_normal((2, frequency.size))
    z = (z + RESISTANCE) * (1 + NOISE * (real + 1j * imag) / np.sqrt(2))
    rows = [f"{f:.0f},{v.real:.7g},{v.imag:.7g}\n" for f, v in zip(frequency, z, strict=True)]
    (HERE / "sweep.csv").write_text("frequency_Hz,resistance_ohm,reactance_ohm\n" + "".join(rows), encoding="utf-8")
