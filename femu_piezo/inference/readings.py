"""Readings of other instruments as data of a fit: mass, capacitance at 1 kHz, d33, sound velocity along the poling.

    row = (predicted(x) − value)/std,    a row of the residual for each reading, with exact slopes in the unknowns

    mass            ρV of the body with its stretches and its density, films and a point mass on it included
    capacitance     Im Y/ω at 1 kHz of the body by its finite element model, with all effects on it, gaps included
    d33             Re d33, far below any relaxation
    sound_velocity  √(c33D/ρ) of a wave along the poling, far wider than its wavelength, c33D = c33E + e33²/ε33S

Readings concern the specimen alone: effects of a fixture on a sweep are not in them, nor are the conditions of a sweep.
Where sweeps have several temperatures, readings are taken at that of the constants, the mean of the sweeps.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from femu_piezo.effects.extended_model import ExtendedModel
from femu_piezo.inference.coefficients import Active, active_effects, d_form_constants, e_form_constants
from femu_piezo.inference.ensemble import Share, is_of_fixture
from femu_piezo.inference.fit import Fit
from femu_piezo.inference.response import Evaluation
from femu_piezo.inference.unknowns import Unknowns
from femu_piezo.material.constants import D_FORM, E_FORM
from femu_piezo.units import signed

#: Where a capacitance is read, rad/s.
_KILOHERTZ = 2 * np.pi * np.array([1e3])
_D33 = D_FORM.index("d33")
_C33, _E33, _EPS33S = (E_FORM.index(name) for name in ("c33", "e33", "eps33S"))
#: Standard deviations between a stated number, such as a reading, and its fitted value from which a note tells that
#: they contradict each other.
CONTRADICTS = 6.0
#: Units of the readings, as they are printed.
UNITS = {"mass": "kg", "capacitance": "F", "d33": "C/N", "sound_velocity": "m/s"}


@dataclass(frozen=True)
class Reading:
    """One reading of one specimen.

    Attributes
    ----------
    name : its key in `[readings]`;  value, std : SI
    specimen : its name as in `Effect.owner`; "" where there is only one
    density, volume, area : of the body and of its hot electrode as the file says, SI
    model : of the specimen, from which a capacitance is predicted; other readings do without it
    """

    name: str
    value: float
    std: float
    specimen: str
    density: float
    volume: float
    area: float
    model: ExtendedModel | None = None

    def row(self, parameters: Unknowns, x: np.ndarray) -> tuple[float, np.ndarray]:
        """(predicted − value)/std at the unknowns x (n_x,), and its slopes (n_x,)."""
        unknowns, columns = Share((self.specimen,)).of(parameters)
        predicted, slopes = self._predicted(unknowns, x[columns])
        found = np.zeros(x.size)
        found[columns] = slopes / self.std
        return (predicted - self.value) / self.std, found

    def _predicted(self, parameters: Unknowns, x: np.ndarray) -> tuple[float, np.ndarray]:
        active = [item for item in active_effects(parameters, x) if not item.effect.of_conditions]
        return {
            "mass": lambda _, x, active: self.mass(active, x.size),
            "capacitance": self._capacitance,
            "d33": self._d33,
            "sound_velocity": self._sound_velocity,
        }[self.name](parameters, x, active)

    def mass(self, active: list[Active], unknowns: int) -> tuple[float, np.ndarray]:
        """Mass with some effects, kg, and its slopes (n_x,)."""
        factor, slopes = _scaled(active, unknowns, 1)
        found, slopes = self.density * self.volume * factor, self.density * self.volume * factor * slopes
        for item in active:
            if item.effect.added_mass is not None:
                added, own = item.effect.added_mass(item.values, self.area)
                found += added
                item.put(slopes, own)
        return found, slopes

    def _capacitance(self, parameters: Unknowns, x: np.ndarray, active: list[Active]) -> tuple[float, np.ndarray]:
        if self.model is None:
            raise ValueError(f"the capacitance of {self.specimen or 'the specimen'} needs its model")
        own = [item for item in active if item.effect.acquisition is None and not is_of_fixture(item.effect)]
        z, slopes = Evaluation(self.model, _KILOHERTZ).with_effects(parameters, x, own)
        return float((1 / z[0]).imag / _KILOHERTZ[0]), (-slopes[0] / z[0] ** 2).imag / _KILOHERTZ[0]

    def _d33(self, parameters: Unknowns, x: np.ndarray, active: list[Active]) -> tuple[float, np.ndarray]:
        theta, tangents = d_form_constants(parameters, x, _plain(active), _KILOHERTZ)
        return float(theta[0, _D33].real), tangents[0, _D33].real

    def _sound_velocity(self, parameters: Unknowns, x: np.ndarray, active: list[Active]) -> tuple[float, np.ndarray]:
        values, tangents = (part[0] for part in e_form_constants(parameters, x, _plain(active), _KILOHERTZ))
        c, e, eps = values[[_C33, _E33, _EPS33S]]
        stiff = c + e**2 / eps
        moved = tangents[_C33] + 2 * e / eps * tangents[_E33] - (e / eps) ** 2 * tangents[_EPS33S]
        factor, slopes = _scaled(active, x.size, 0)
        speed = np.sqrt(stiff.real / (self.density * factor))
        return float(speed), speed / 2 * (moved.real / stiff.real - slopes)


def _plain(active: list[Active]) -> list[Active]:
    """Effects without laws over frequency, since these hold in the band of the sweep alone."""
    return [item for item in active if not item.effect.dispersive]


def _scaled(active: list[Active], unknowns: int, power: int) -> tuple[float, np.ndarray]:
    """Product of the factors on the volume to `power`, 0 or 1, and of those on the density; its log slopes (n_x,)."""
    found, slopes = 1.0, np.zeros(unknowns)
    for item in active:
        if power and item.effect.stretch is not None:
            factors, rates = item.effect.stretch(item.values)
            found *= float(np.prod(factors))
            item.put(slopes, (1 / factors) @ rates)
        if power and item.effect.reshaping is not None:  # the outline, and the electrodes with it
            factor, slope = item.effect.reshaping.volume(item.values[0])
            found *= factor
            item.put(slopes, np.array([slope / factor]))
        if item.effect.density is not None:
            factor, rates = item.effect.density(item.values)
            found *= factor
            item.put(slopes, rates / factor)
    return found, slopes


def read_beside(fit: Fit) -> dict[str, dict[str, float | str]]:
    """Reading → its record: value, std, unit and fitted value, SI, and the difference of the values over std."""
    found: dict[str, dict[str, float | str]] = {}
    for reading in fit.parameters.readings:
        sigma = reading.row(fit.parameters, fit.x)[0]
        title = f"{reading.name} ({reading.specimen})" if reading.specimen else reading.name
        found[title] = {
            "value": reading.value,
            "std": reading.std,
            "unit": UNITS[reading.name],
            "fitted": reading.value + sigma * reading.std,
            "sigma": sigma,
        }
    return found


def contradictions(fit: Fit) -> list[str]:
    """A note for each reading that no fit of the sweep comes near."""
    return [
        f"the reading of {name} is {abs(float(one['sigma'])):.0f} standard deviations off what the sweep says, "
        f"{one['fitted']:.4g} {one['unit']}: check its value and unit, or leave it out; until then no constant and no "
        "standard deviation can be relied on"
        for name, one in read_beside(fit).items()
        if abs(float(one["sigma"])) > CONTRADICTS
    ]


def reading_words(fit: Fit | None) -> Sequence[str]:
    """A line for each reading: its value, the fitted value, and their difference over the standard deviation."""
    rows = read_beside(fit) if fit is not None else {}
    return [
        f"reading: {name} {one['value']:.5g} ± {one['std']:.2g} {one['unit']}, fitted {one['fitted']:.5g} "
        f"({signed(float(one['sigma']), '.1f')} σ)"
        for name, one in rows.items()
    ]
