"""A resonance as a branch of four elements, exact for a complex residue.

A pole p of Y with residue ρ and its conjugate are one section of second order,

    ρ/(s − p) + ρ*/(s − p*) = (a s + b)/(s² + c s + d),  a = 2 Re ρ,  b = −2 Re(ρ p*),  c = −2 Re p,  d = |p|²,

and by one step of division (Guillemin, Synthesis of Passive Networks, 1957, chapter 4) an inductance L = 1/a and a
resistance R = (c − b/a)/a in series with a capacitance C = a/(d − b R), across which a resistance Rp = (d − b R)/b
lies.
Butterworth and Van Dyke's branch is b = 0: its Rp is infinite. The residue of a mode with constant complex moduli is
real in ω², which is b = −a Re p: half of its loss is R, half Rp. A negative Rp is a residue turned the other way; as a
part of the circuit it is right, alone it is no resistor one can buy.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

#: Relative step of central differences.
_STEP = 1e-6
ELEMENTS = ("L", "R", "C", "Rp")
UNITS = {"L": "H", "R": "ohm", "C": "F", "Rp": "ohm"}


@dataclass(frozen=True)
class Branch:
    """One mode.

    Attributes
    ----------
    pole : p, rad/s, in the upper half plane;  residue : ρ of Y at it, S rad/s
    std : standard deviation of each element by the noise, SI; empty where unknown
    doubtful : whether it is none of the sound resonances of the sweep, so a part of the curve rather than a mode
    """

    pole: complex
    residue: complex
    std: dict[str, float]
    doubtful: bool = False

    @property
    def elements(self) -> dict[str, float]:
        """L (H), R (ohm), C (F), Rp (ohm; infinite for the branch of Butterworth and Van Dyke)."""
        return dict(zip(ELEMENTS, _elements(self.pole, self.residue), strict=True))

    @property
    def frequency_Hz(self) -> float:
        """sqrt(Re λ)/2π with λ = −p², as for any resonance of this package."""
        return float(np.sqrt((-(self.pole**2)).real) / (2 * np.pi))

    @property
    def quality_factor(self) -> float:
        """Re λ/Im λ."""
        value = -(self.pole**2)
        return float(value.real / value.imag) if value.imag else float("inf")

    @property
    def residue_phase(self) -> float:
        """Argument of the residue in ω², rad: zero for constant complex moduli with equal loss angles."""
        return float(np.angle(self.residue))

    def admittance(self, omega: np.ndarray) -> np.ndarray:
        """Y (n,) in siemens of the four elements at ω (n,) in rad/s."""
        found, s = self.elements, 1j * omega
        return 1 / (s * found["L"] + found["R"] + 1 / (s * found["C"] + 1 / found["Rp"]))

    def section(self, omega: np.ndarray) -> np.ndarray:
        """Y (n,) in siemens of pole and residue and their conjugates at ω (n,) in rad/s; the same as `admittance`."""
        s = 1j * omega
        return self.residue / (s - self.pole) + self.residue.conjugate() / (s - self.pole.conjugate())


def _elements(pole: complex, residue: complex) -> tuple[float, float, float, float]:
    a, b = 2 * residue.real, -2 * (residue * pole.conjugate()).real
    c, d = -2 * pole.real, abs(pole) ** 2
    resistance = (c - b / a) / a
    rest = d - b * resistance
    return 1 / a, resistance, a / rest, rest / b if b else float("inf")


def element_deviations(pole: complex, residue: complex, covariance: np.ndarray) -> dict[str, float]:
    """Standard deviations of the elements, to first order.

    covariance : (4, 4) over (Re p, Im p, Re ρ, Im ρ)
    """
    at = np.array([pole.real, pole.imag, residue.real, residue.imag])
    scale = np.array([abs(pole), abs(pole), abs(residue), abs(residue)]) * _STEP

    def of(x: np.ndarray) -> np.ndarray:
        return np.array(_elements(complex(x[0], x[1]), complex(x[2], x[3])))

    columns = [(of(at + step) - of(at - step)) / (2 * step.sum()) for step in np.diag(scale)]
    slopes = np.array(columns).T
    variance = np.einsum("ij,jk,ik->i", slopes, covariance, slopes)
    return {name: float(np.sqrt(v)) for name, v in zip(ELEMENTS, variance, strict=True) if np.isfinite(v)}
