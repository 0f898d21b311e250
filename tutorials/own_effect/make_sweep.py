"""Make sweep.csv: the simulated measurement of a k31 bar with a dot of solder on each end.

The method is not finite elements but Rayleigh-Ritz with global Legendre polynomials (tests/hidden_effects/ritz.py),
with a full solve at every frequency and 0.2 % of noise. Takes a minute: python tutorials/own_effect/make_sweep.py
"""

import sys
from pathlib import Path

import numpy as np

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parents[1] / "tests"))

from hidden_effects.ritz import RitzPlate  # noqa: E402

SIZE, DENSITY = (30e-3, 5e-3, 1e-3), 7500.0
EPS0 = 8.8541878128e-12
#: s11 s12 s13 s33 s44 d31 d33 d15 eps11T eps33T of PZT-5H except for s11, d31 and eps33T, each with its loss tangent.
TRUTH = np.array(
    [
        16.8e-12 * (1 - 0.0150j),
        -4.78e-12 * (1 - 0.015j),
        -8.45e-12 * (1 - 0.015j),
        20.7e-12 * (1 - 0.015j),
        43.5e-12 * (1 - 0.015j),
        -268e-12 * (1 - 0.0130j),
        593e-12 * (1 - 0.015j),
        741e-12 * (1 - 0.015j),
        3130 * EPS0 * (1 - 0.015j),
        3450 * EPS0 * (1 - 0.0160j),
    ]
)
#: kg on each end: 2 % of the bar
MASS, NOISE = 0.02 * DENSITY * float(np.prod(SIZE)), 2e-3


class LoadedBar(RitzPlate):
    """The bar with a mass spread over each end face."""

    def __init__(self, size, density: float, orders, mass: float) -> None:
        super().__init__(size, density, orders)
        for f in range(3):
            y, z = (self._pair(f, f, axis, False, False, self._weights[axis]) for axis in (1, 2))
            ends = np.full((self._lines[f][0].values.shape[0],) * 2, 2.0)  # P_i(±1) P_j(±1) over both ends
            where = slice(self._starts[f], self._starts[f + 1])
            self.mass[where, where] += mass / (size[1] * size[2]) * np.kron(np.kron(ends, y), z)


if __name__ == "__main__":
    frequency = np.linspace(30e3, 160e3, 391)
    z = LoadedBar(SIZE, DENSITY, (20, 7, 5), MASS).impedance(TRUTH, frequency)
    finer = LoadedBar(SIZE, DENSITY, (24, 9, 7), MASS).impedance(TRUTH, frequency[::20])
    error = np.max(np.abs(z[::20] / finer - 1))
    print(f"largest relative error of Z by the orders of the polynomials: {error:.1e}")
    assert error < 0.3 * NOISE
    real, imag = np.random.default_rng(32).standard_normal((2, frequency.size))
    z = z * (1 + NOISE * (real + 1j * imag) / np.sqrt(2))
    rows = [f"{f:.2f},{v.real:.7g},{v.imag:.7g}\n" for f, v in zip(frequency, z, strict=True)]
    (HERE / "sweep.csv").write_text("frequency_Hz,resistance_ohm,reactance_ohm\n" + "".join(rows), encoding="utf-8")
