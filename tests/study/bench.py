"""A simulated laboratory bench: it measures drawn plates, bars and disks at the frequencies that a program asks for."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from hidden_effects.draws import Draw

from femu_piezo.inference.fit import Fit, fit
from femu_piezo.measurement.spectrum import ImpedanceSpectrum
from femu_piezo.measurement.sweeps import SweepData
from femu_piezo.specimen.file import Specimen, read_specimen
from femu_piezo.study.posterior import Posterior
from tests.noise import noisy

#: Band of all draws, Hz.
BAND = (20e3, 240e3)


@dataclass
class Bench:
    """Measures a draw with noise, and possibly with a further narrow mode.

    level : relative noise;  series : numbers before that of the draw in the seed of the noise
    mode : (frequency, Hz, Q, k_eff²) of a branch parallel to the plate, Y = jωC k²/(1 − (f/f0)² + j f/(f0 Q))
    asked : the frequencies asked for
    """

    drawn: Draw
    mode: tuple[float, float, float] | None = None
    level: float = 5e-4
    series: tuple[int, ...] = ()
    asked: list[np.ndarray] = field(default_factory=list)

    def __post_init__(self) -> None:
        self._rng = np.random.default_rng([*self.series, self.drawn.seed])

    def __call__(self, frequency: np.ndarray) -> ImpedanceSpectrum:
        self.asked.append(frequency)
        return ImpedanceSpectrum(frequency, noisy(self.clean(frequency), self.level, self._rng), source="bench")

    def clean(self, frequency: np.ndarray) -> np.ndarray:
        """Z (n,) without noise, ohm."""
        z = self.drawn.build.impedance(np.append(frequency, BAND[1]))[:-1]
        return z if self.mode is None else 1 / (1 / z + self.branch(frequency))

    def branch(self, frequency: np.ndarray) -> np.ndarray:
        """Admittance (n,) of the further mode, S."""
        place, quality, square = self.mode
        capacitance = (1 / self.drawn.clean[0]).imag / (2 * np.pi * self.drawn.frequency[0])
        ratio = frequency / place
        return 2j * np.pi * frequency * capacitance * square / (1 - ratio**2 + 1j * ratio / quality)


def specimen_of(drawn: Draw, folder: Path) -> Specimen:
    """The specimen of a draw, from its file in the folder."""
    path = folder / "piece.toml"
    path.write_text(drawn.specification, encoding="utf-8")
    return read_specimen(path)


def misfit_of_wrong(posterior: Posterior, right: Fit, wrong: Fit, extra: np.ndarray) -> float:
    """χ² of the wrong cause fitted to noiseless data of the right one, at the existing points and at further ones
    `extra`, Hz.
    """
    evaluation, unknowns, _ = posterior.whole_sweep(0, right)
    evaluation = replace(evaluation, omega=np.sort(np.concatenate([evaluation.omega, 2 * np.pi * extra])))
    noise = np.full(evaluation.omega.size, float(np.median(right.data.relative_noise)))
    data = SweepData(evaluation.omega / (2 * np.pi), evaluation.impedance(unknowns, right.x), noise, noise_known=True)
    return fit(evaluation, data, wrong.parameters, [wrong.x]).chi_square
