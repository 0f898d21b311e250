"""A computed curve of impedance as a rational function of ω², continued between its points and off the real axis.

    C(ω) = Y/(jω) = Σ_k r_k/(λ_k − ω²) + the rest,    1/C = jωZ = Σ_k s_k/(λ_k − ω²) + the rest,

λ_k at the poles of Y in the first and at its zeros in the second, by the AAA algorithm (Nakatsukasa, Sète, Trefethen,
SIAM J. Sci. Comput. 40 (2018) A1494). The resonances of a bare body come back to 1e-11.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import AAA

from femu_piezo.measurement.spectrum import evenly
from femu_piezo.resonances import Kind, Resonance
from femu_piezo.threads import Once, blas_limit, made_once

#: Relative error and most terms of the rational function of a model's curve that `rational_curve` keeps, and number of
#: curves that are kept.
_CLOSE, _TERMS, _CURVES = 1e-7, 60, 4
#: Points of a curve that are taken, evenly over it, and relative error of its rational function.
_POINTS, _EXACT = 400, 1e-13
#: Share of the strongest resonance below which the terminals do not see one, and largest |Im λ| over Re λ of one.
_VISIBLE, _DAMPED = 1e-4, 0.5


@dataclass(frozen=True)
class RationalCurve:
    """A rational function through a computed curve.

    Attributes
    ----------
    frequency : (k,) Hz;  impedance : (k,) ohm, without noise
    exact : relative error of the function at the points of the curve;  terms : most terms
    """

    frequency: np.ndarray
    impedance: np.ndarray
    exact: float = _EXACT
    terms: int = _POINTS // 2

    @made_once
    def _charge(self) -> AAA:
        """C over ω²/ω_end²."""
        some = evenly(self.frequency.size, _POINTS)
        omega = 2 * np.pi * self.frequency[some]
        values = 1 / (1j * omega * self.impedance[some])
        with blas_limit(), warnings.catch_warnings():
            # AAA warns where a curve is no rational function of few terms, as that of a drifting specimen
            warnings.simplefilter("ignore", RuntimeWarning)
            # the clean-up of AAA would import scipy.stats; `visible` leaves out poles due to rounding
            return AAA(
                omega**2 / self._end, values, rtol=self.exact, max_terms=min(self.terms, some.size // 2), clean_up=False
            )

    @property
    def _end(self) -> float:
        """ω_end², rad²/s²."""
        return float((2 * np.pi * np.max(self.frequency)) ** 2)

    @made_once
    def poles(self) -> tuple[np.ndarray, np.ndarray]:
        """λ_k (m,) rad²/s² and r_k (m,), including poles due to rounding."""
        with blas_limit():
            return self._charge.poles() * self._end, -self._charge.residues() * self._end

    @made_once
    def zeros(self) -> tuple[np.ndarray, np.ndarray]:
        """λ_k (m,) rad²/s² and s_k (m,), including zeros due to rounding; s_k = −1/C' with the slope C' = dC/dω²."""
        with blas_limit():
            roots = self._charge.roots()
        away = roots[:, None] - self._charge.support_points
        weights, values = self._charge.weights, self._charge.support_values
        slopes = -((1 / away**2) @ (weights * values)) / ((1 / away) @ weights)
        return roots * self._end, -self._end / slopes

    def resonances(self, kind: Kind, band_Hz: float) -> tuple[Resonance, ...]:
        """The visible poles or zeros up to a frequency (`visible`).

        Those far below the curve or far off the real axis are no resonances: they approximate parts of C that are no
        rational function of ω², such as a leakage.
        """
        values, strengths = self.poles if kind == "pole" else self.zeros
        low = (np.pi * np.min(self.frequency)) ** 2
        of_modes = (values.real > low) & (np.abs(values.imag) < _DAMPED * values.real)
        return visible(kind, values[of_modes], strengths[of_modes], band_Hz)

    def admittance(self, omega: np.ndarray) -> np.ndarray:
        """Y (n,), siemens, at ω (n,) rad/s."""
        return 1j * omega * self._along(omega**2 / self._end)

    def _along(self, x: np.ndarray) -> np.ndarray:
        """C (n,) at x = ω²/ω_end² (n,), as `AAA` evaluates it but without its checks of shapes and infinities."""
        known, values = self._charge.support_points, self._charge.support_values
        away = x[:, None] - known
        at, which = np.nonzero(away == 0)
        away[at] = 1.0
        shares = self._charge.weights / away
        found = shares @ values / np.sum(shares, axis=1)
        found[at] = values[which]
        return found


def rational_curve(frequency: np.ndarray, impedance: np.ndarray) -> RationalCurve:
    """The rational function, to 1e-7, through the curve Z (k,) ohm of a model at f (k,) Hz; kept for the latest curves.

    A discrepancy and the standard figures of a specimen need that of the same curve.
    """
    key = np.ascontiguousarray(frequency).tobytes(), np.ascontiguousarray(impedance).tobytes()
    return _latest.get(key, lambda: RationalCurve(frequency, impedance, _CLOSE, _TERMS))


_latest = Once(latest=_CURVES)


def visible(kind: Kind, values: np.ndarray, strengths: np.ndarray, band_Hz: float) -> tuple[Resonance, ...]:
    """Resonances λ_k (k,) of strengths a_k (k,) in a sum Σ a_k/(λ_k − ω²), up to a frequency and in order.

    Modes that the terminals hardly see, with |a_k/λ_k| below a share of the largest, are left out. Residues are a_k/2
    of Y at a pole and −a_k/(2λ_k) of Z at a zero.
    """
    weight = np.abs(strengths / values)
    inside = (values.real > 0) & (np.sqrt(np.abs(values.real)) <= 2 * np.pi * band_Hz)
    strong = inside & (weight > _VISIBLE * weight[inside].max(initial=0.0))
    residues = strengths / 2 if kind == "pole" else -strengths / (2 * values)
    found = sorted(zip(values[strong], residues[strong], strict=True), key=lambda one: one[0].real)
    return tuple(Resonance(kind, complex(value), None, complex(residue)) for value, residue in found)
