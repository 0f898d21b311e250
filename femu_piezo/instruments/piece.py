"""The piece that a simulated analyser measures: the model of a specimen, hidden effects and errors of a bench included.

    Z(ω/w)/w,  w = 1 + drift · t              resonances drift with the time t since the analyser was switched on
    Y_i + (Ym_{i−1} − Ym_i) e^(−γ T)          the motional current still rings from the previous point (settling)
    softening ∝ (V/V_0)²                      of [effects.drive_level], V_0 the voltage of [limits]
    Z_i g (1 + ν_i)                           gain g of the instrument, noise ν by the accuracy chart

Accuracy in the form of data sheets, E = E_p + Z_s/|Z| + Y_o |Z|: E_p is 0.08 %, the basic accuracy in the data sheet of
the E4990A, Z_s and Y_o are of the usual order. The error of the gain is a third of E_p, the noise of the slowest
measurement a quarter of E (standard deviations).
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from femu_piezo.errors import InputError
from femu_piezo.specimen.file import Specimen
from femu_piezo.study.effects import effects_as_simulated, model_with_effects, simulated_with_effects
from femu_piezo.study.problem import prepare
from femu_piezo.study.simulate import sweep_frequencies

#: Accuracy chart: E_p, Z_s (ohm), Y_o (siemens); its shares that are error of the gain and noise.
_CHART, _GAIN, _NOISE = (8e-4, 10e-3, 50e-9), 1 / 3, 1 / 4
#: Seconds of a point by speed 1 … 5.
_SECONDS = (0.003, 0.006, 0.02, 0.06, 0.2)
#: Error of mesh and basis, points of the reference sweep, and the loss tangent where the file has none.
_ACCURACY, _REFERENCE, _LOSS = 1e-4, 401, 0.01
#: Highest frequency of the model over the end of the band of [simulation].
_BEYOND = 1.05


@dataclass
class Piece:
    """A specimen between the clips of an analyser.

    Parameters
    ----------
    drift : relative rise of the resonances per second, 1/s
    seed : of gain and noise

    Attributes
    ----------
    clock : seconds of measurement so far

    Raises
    ------
    InputError : the specimen has no losses at all
    """

    specimen: Specimen
    drift: float = 0.0
    seed: int = 0
    clock: float = 0.0
    _rng: np.random.Generator = field(init=False, repr=False)

    def __post_init__(self) -> None:
        self._rng = np.random.default_rng(self.seed)
        size, turn = _CHART[0] * _GAIN * self._rng.standard_normal(2)
        self._gain = (1 + size) * np.exp(1j * turn)
        self._problem = prepare(self.specimen)
        if not np.any(self._problem.fitted.vector().imag):
            raise InputError(
                f"{self.specimen.path or self.specimen.name}: [material] has no losses, so that resonances have no "
                "width and no sweep can show them; give loss tangents such as tan_s11 = 0.01"
            )
        band = sweep_frequencies(self._problem)[[0, -1]]
        self._known = effects_as_simulated(self._problem, band)
        top = _BEYOND * float(band[1])
        model = self._problem.model(self._problem.equivalent_frequency(top, _ACCURACY), _ACCURACY)
        self._model = model_with_effects(self._problem, model, (float(band[0]), top), self._known, _ACCURACY / 10)
        self._reference = np.linspace(*band, _REFERENCE)
        self._capacitance = self._capacitance_at_end()
        tangent = self._problem.fitted.tangent("s11" if self._problem.plate.poling == "thickness" else "s33")
        self._loss = abs(tangent) or _LOSS

    def _capacitance_at_end(self) -> float:
        """The capacitance at the end of the band, F."""
        z = self._impedance(self._reference[-1:], self.specimen.limits.voltage)
        return float((1 / z[0]).imag / (2 * np.pi * self._reference[-1]))

    def _impedance(self, frequency: np.ndarray, voltage: float) -> np.ndarray:
        """Z (n,), ohm, without drift, ringing and noise.

        The reference sweep is computed with it, as [effects.drive_level] refers to the largest current of the band.
        """
        share = (voltage / self.specimen.limits.voltage) ** 2
        known = [
            (effect, values * np.r_[share, np.ones(values.size - 1)] if effect.name == "drive_level" else values)
            for effect, values in self._known
        ]
        every, place = np.unique(np.concatenate([frequency, self._reference]), return_inverse=True)
        return simulated_with_effects(self._problem, self._model, every, known)[place[: frequency.size]]

    def measured(self, frequency: np.ndarray, voltage: float, speed: int, averages: int) -> np.ndarray:
        """Z (n,), ohm, as the analyser reads it at frequencies (n,), Hz, one after another in this order."""
        dwell = _SECONDS[speed - 1] * averages
        w = 1 + self.drift * (self.clock + dwell * np.arange(1, frequency.size + 1))
        self.clock += dwell * frequency.size
        z = self._impedance(frequency / w, voltage) / w
        y = 1 / z
        moving = y - 2j * np.pi * frequency * self._capacitance
        ringing = np.exp(-np.pi * frequency * self._loss * _SECONDS[speed - 1])
        y[1:] += (moving[:-1] - moving[1:]) * ringing[1:]
        z = 1 / y
        magnitude = np.abs(z)
        sigma = _NOISE * (_CHART[0] + _CHART[1] / magnitude + _CHART[2] * magnitude)
        sigma *= np.sqrt(_SECONDS[-1] / dwell)
        normal = self._rng.standard_normal((2, z.size))
        return z * self._gain * (1 + sigma * (normal[0] + 1j * normal[1]) / np.sqrt(2))
