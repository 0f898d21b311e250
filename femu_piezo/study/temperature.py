"""What sweeps at several temperatures tell: every free constant as a straight line over temperature."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from femu_piezo.effects.constant_factor import ConstantFactor
from femu_piezo.inference.coefficients import active_effects, even_constants
from femu_piezo.inference.fit import Fit
from femu_piezo.inference.unknowns import Unknowns
from femu_piezo.material.constants import PiezoConstants
from femu_piezo.study.subjects import Subject

#: The effect whose parameters the coefficients are (`femu_piezo.effects.library.between_sweeps`).
COEFFICIENTS = "temperature_coefficients"


@dataclass(frozen=True)
class Coefficient:
    """How one constant changes with temperature, with standard deviations.

    Attributes
    ----------
    relative, std : of the real part, 1/K;  tangent, tangent_std : of the loss tangent, 1/K
    """

    relative: float
    std: float
    tangent: float
    tangent_std: float

    def to_json(self) -> dict[str, float]:
        """An item of "temperature.coefficients" in update.json."""
        return {
            "relative_per_K": self.relative,
            "std": self.std,
            "tan_per_K": self.tangent,
            "tan_std": self.tangent_std,
        }


@dataclass(frozen=True)
class TemperatureSeries:
    """The constants of a specimen over temperature.

    Attributes
    ----------
    reference_C : where the constants of the result hold: the mean temperature of the sweeps
    measured_C : (n,) of the sweeps
    coefficients : of every free constant
    """

    reference_C: float
    measured_C: tuple[float, ...]
    coefficients: dict[str, Coefficient]
    fit: Fit = field(repr=False)
    effect: int = field(repr=False)

    def over(self, celsius: np.ndarray) -> dict[str, tuple[np.ndarray, np.ndarray]]:
        """ "s11", "tan_s11", … → values (k,) at temperatures (k,), °C, and their standard deviations.

        θ (1 + a ΔT) and tan + b ΔT, to first order in tangents.
        """
        x, found, kelvin = self.fit.x, {}, np.asarray(celsius) - self.reference_C
        material = self.fit.parameters.material
        for at, label in enumerate(material.names):
            column, unit = _column(self.fit, self.effect, label)
            rows = np.zeros((kelvin.size, x.size))
            rows[:, at], rows[:, column] = 1.0, kelvin * unit
            if not label.startswith("tan_"):
                size = material.scale[at // 2]
                rows[:, at] = size * (1 + x[column] * unit * kelvin)
                rows[:, column] *= size * x[at]
                values = rows[:, at] * x[at]
            else:
                values = x[at] + rows[:, column] * x[column]
            found[label] = values, np.sqrt(np.einsum("ki,ij,kj->k", rows, self.fit.covariance, rows))
        return found

    def to_json(self) -> dict:
        """ "temperature" of update.json."""
        return {
            "reference_C": self.reference_C,
            "sweeps_C": list(self.measured_C),
            "coefficients": {name: one.to_json() for name, one in self.coefficients.items()},
        }


def temperature_series(found: Fit, several: Sequence[Subject]) -> TemperatureSeries | None:
    """The constants over temperature; None where the sweeps are of one temperature."""
    parameters = found.parameters
    number = next((i for i, effect in enumerate(parameters.effects) if effect.name == COEFFICIENTS), None)
    if number is None:
        return None

    def told(label: str) -> tuple[float, float]:
        column, unit = _column(found, number, label)
        return float(found.x[column] * unit), float(found.std[column] * unit)

    coefficients = {name: Coefficient(*told(name), *told(f"tan_{name}")) for name in parameters.material.free.names}
    stated = (one.measured.conditions.celsius for one in several)
    measured = tuple(celsius for celsius in stated if celsius is not None)
    return TemperatureSeries(float(np.mean(measured)), measured, coefficients, found, number)


def _column(found: Fit, effect: int, label: str) -> tuple[int, float]:
    """Where the coefficient of "s11", "tan_s11", … stands in x, and its unit there, 1/K."""
    own = found.parameters.effects[effect]
    at = [parameter.name for parameter in own.parameters].index(label)
    return found.parameters.columns(effect).start + at, float(own.scale[at])


def constants_under(conditions: Unknowns, x: np.ndarray) -> PiezoConstants:
    """The constants at x (n_x,) under the conditions of one sweep, whose unknowns `conditions` are.

    The held ones are as file and fit move them.
    """
    acting = [
        one
        for one in active_effects(conditions, x)
        if one.effect.of_conditions or isinstance(one.effect.constants, ConstantFactor)
    ]
    return even_constants(conditions, x, acting)
