"""A computed curve of impedance, continued between its points and off the real axis."""

from __future__ import annotations

import numpy as np
from scipy.interpolate import AAA

from femu_piezo.resonances import Kind, Resonance
from femu_piezo.threads import blas_limit

#: Points of a computed curve that its rational function goes through at most, step of its derivative in ω/ω_end, and
#: share of the strongest residue below which a pole is one of rounding.
_POINTS, _STEP, _VISIBLE = 400, 1e-6, 1e-5


class RationalCurve:
    """A computed curve, frequencies (k,) Hz and impedances (k,) ohm, continued between its points by a rational
    function (AAA; see `femu_piezo.study.simulate.curve_resonances`)."""

    def __init__(self, frequency: np.ndarray, impedance: np.ndarray) -> None:
        self.points = (frequency, impedance)
        some = np.unique(np.linspace(0, frequency.size - 1, min(frequency.size, _POINTS)).astype(int))
        omega = 2 * np.pi * frequency[some]
        self._end = omega[-1]
        with blas_limit():
            charge = 1 / (1j * omega * impedance[some])
            # cleaning up imports scipy.stats; poles that hardly show are left out below
            self._charge = AAA(omega / self._end, charge, max_terms=_POINTS // 2, clean_up=False)
            self.poles = self._listed("pole", self._charge.poles(), self._charge.residues())
            roots = self._charge.roots()
            slopes = (self._charge(roots + _STEP) - self._charge(roots - _STEP)) / (2 * _STEP)
            self.zeros = self._listed("zero", roots, 1 / slopes)

    def _listed(self, kind: Kind, omega: np.ndarray, residues: np.ndarray) -> list[Resonance]:
        """Resonances of a rational function of ω, those that hardly show left out."""
        weight = np.abs(residues / omega)
        inside = (omega.real > 0) & (np.abs(omega.imag) < 0.5 * omega.real) & (omega.real < 1.5)
        strong = inside & (weight > _VISIBLE * weight[inside].max(initial=0.0))
        return [
            Resonance(kind, complex(one * self._end) ** 2, None, complex(r))
            for one, r in zip(omega[strong], residues[strong], strict=True)
        ]

    def admittance(self, omega: np.ndarray) -> np.ndarray:
        """Y (n,), siemens."""
        return 1j * omega * self._along(omega / self._end)

    def _along(self, x: np.ndarray) -> np.ndarray:
        """(n,) the rational function at x (n,), as `AAA` has it, without its care for other shapes and infinities."""
        known, values = self._charge.support_points, self._charge.support_values
        away = x[:, None] - known
        at, which = np.nonzero(away == 0)
        away[at] = 1.0
        shares = self._charge.weights / away
        found = shares @ values / np.sum(shares, axis=1)
        found[at] = values[which]
        return found

    def residue_of_admittance(self, pole: Resonance) -> complex:
        """Residue of Y at p = jω of one of `poles`, S rad/s: Y = jω f(ω), f ≈ r/(ω − ω_p), s = jω give −ω_p r."""
        omega = np.sqrt(complex(pole.eigenvalue))
        return complex(-omega * pole.residue * self._end)
