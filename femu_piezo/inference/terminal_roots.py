"""Poles and zeros at the terminals of a specimen with all its effects, and their exact slopes.

Near a pole ω₀ of Y, where Z vanishes, log Z = log(ω − ω₀) + …, so that

    ∂ω₀/∂x = −(1/2πi) ∮ ∂log Z/∂x dω

around it, and the negative of that around a zero. On a circle this is a mean over n points, whose error is of the order
(radius/distance to the next root)ⁿ. So the Jacobian of Z serves dimensions, density, constants and circuits alike.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from femu_piezo.inference.response import Evaluation
from femu_piezo.inference.unknowns import Unknowns
from femu_piezo.resonances import Kind, Resonance

#: Most Newton steps, the relative length below which a step is rounding, the relative step of the difference quotient,
#: and the largest relative move of a root that is believed.
_STEPS, _SETTLED, _DIFFERENCE, _FAR = 8, 1e-14, 1e-7, 0.05
#: Points on the circle around a root, and its radius over |ω|.
_POINTS, _RADIUS = 4, 1e-5


def terminal_roots(
    impedance: Callable[[np.ndarray], np.ndarray],
    kind: Kind,
    start: np.ndarray,
    measured: Sequence[Resonance] | None = None,
) -> np.ndarray:
    """Complex ω (m,) of poles or zeros near starts (m,), rad/s, by Newton; the start where it leads far away.

    A large circuit moves a root far from that of the body, its start. It is then sought where it was measured.

    Of a body without circuits the starts are the roots, where Y or Z is infinite: so the first points lie a little off
    them, and at a root that is exact to the last bit, where the step is not finite, it is 0.

    impedance : complex ω → Z at the terminals (`Evaluation.terminals`)
    measured : m measured resonances of this kind, where they are known
    """
    found = _near(impedance, kind, start)
    lost = np.flatnonzero(np.isnan(found))
    if lost.size and measured is not None:
        eigenvalues = np.array([resonance.eigenvalue for resonance in measured], dtype=complex)
        found[lost] = _near(impedance, kind, np.sqrt(eigenvalues[lost]))
    return np.where(np.isnan(found), start, found)


def _near(impedance: Callable[[np.ndarray], np.ndarray], kind: Kind, start: np.ndarray) -> np.ndarray:
    """Complex ω (m,) of poles or zeros near starts (m,), by Newton; nan where it leads far away."""
    omega = start.astype(complex) * (1 + _DIFFERENCE)

    def function(at: np.ndarray) -> np.ndarray:
        return impedance(at) if kind == "pole" else 1 / impedance(at)

    for _ in range(_STEPS):
        with np.errstate(divide="ignore", invalid="ignore"):
            value, beside = function(np.concatenate([omega, omega * (1 + _DIFFERENCE)])).reshape(2, -1)
            step = value * omega * _DIFFERENCE / (beside - value)
        step = np.where(np.isfinite(step), step, 0.0)
        omega = omega - step
        if np.all(np.abs(step) < _SETTLED * np.abs(omega)):
            break
    return np.where(np.abs(omega / start - 1) < _FAR, omega, np.nan)


def root_slopes(
    evaluation: Evaluation, parameters: Unknowns, x: np.ndarray, kind: Kind, roots: np.ndarray
) -> np.ndarray:
    """∂ω₀/∂x (m, n_x), rad/s, of simple poles or zeros ω₀ (m,) at x (n_x,)."""
    if not roots.size:
        return np.zeros((0, x.size), dtype=complex)
    circle = _RADIUS * np.abs(roots)[:, None] * np.exp(2j * np.pi * np.arange(_POINTS) / _POINTS)
    around = replace(evaluation, omega=(roots[:, None] + circle).ravel())
    z, slopes = around.with_jacobian(parameters, x)
    move = (slopes / z[:, None]).reshape(*circle.shape, -1) * circle[:, :, None]
    return (-1 if kind == "pole" else 1) * move.mean(axis=1)
