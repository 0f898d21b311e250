"""Electrodes of a sheet resistance R_sq (ohm per square) that are contacted on a line across the plate.

The current I(x) that an electrode carries past x grows from its ends to the contact at x_c. To first order in R_sq its
losses add to the impedance

    Z' = Z + 2 R_sq (L/W) m(ω),    m = ∫ (I(x)/I(x_c))² dx/L, for two equal electrodes.

Where the charge is uniform along the plate, m is 1/3 for a contact at an end and 1/12 for one in the middle. Near a
resonance it is not uniform: with ξ = 2x/L and X = ωL/2 √(ρ s11) a k31 bar has the charge D/⟨D⟩ = a + b X cos(Xξ), with

    a = (1 − k²)/y,    b = [k² cos X + (y − 1 + k²) X sin X]/(X y),    y = Y/(jω ε33T LW/t),    k² = d31²/(s11 ε33T),

b in a form that stays finite between the modes of the bar. Therefore a sheet resistance damps the antiresonance, where
currents run within the electrodes while the leads carry hardly any; a resistance of the leads does not. y is that of
the body in the fit; k² and X are those of the specimen file, and width modes have another charge: this makes the error
of the law.
"""

from __future__ import annotations

import numpy as np

from femu_piezo.effects.effect import CircuitHook, Effect, EffectContext, EffectParameter

#: Share of the change that the law misses: constants as in the file, charge as in a thin bar.
_LAW_ERROR = 0.1


def losses(
    omega: np.ndarray, y: np.ndarray, contact: float, wave: complex, coupling: complex
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """m(ω) (k,), its slope in y and its slope in the place ξ of the contact.

    omega, y : (k,);  contact : ξ of the contact;  wave : X/ω;  coupling : k²
    """
    x = wave * omega
    sin, cos = np.sin(x), np.cos(x)
    a, b = (1 - coupling) / y, (coupling * cos + (y - 1 + coupling) * x * sin) / (x * y)
    along, square = (sin - x * cos) / x**2, 0.5 * (1 - np.sin(2 * x) / (2 * x))  # means of ξ sin Xξ and of sin² Xξ

    def reach(a, b):  # ∫ aξ + b sin Xξ from the contact to the end
        return a * (1 - contact**2) / 2 - b * (cos - np.cos(x * contact)) / x

    a_slope, b_slope = -a / y, (sin - b) / y
    found = (1 + a**2 / 3 + 2 * a * b * along + b**2 * square - 2 * reach(a, b)) / 4
    slope = a * a_slope / 3 + (a_slope * b + a * b_slope) * along + b * b_slope * square - reach(a_slope, b_slope)
    return found, slope / 2, (a * contact + b * np.sin(x * contact)) / 2


def _hook(context: EffectContext, dimensions: tuple[float, float, float]) -> CircuitHook:
    (length, width, thickness), constants = dimensions, context.constants
    wave = length / 2 * np.sqrt(context.density * constants.s11)
    coupling = constants.d31**2 / (constants.s11 * constants.eps33T)
    capacitance = constants.eps33T * length * width / thickness

    def circuit(omega: np.ndarray, z: np.ndarray, p: np.ndarray):
        size, place = p[0] * 2 * length / width, 2 * p[1] / length
        y = 1 / (1j * omega * capacitance * z)
        found, by_y, by_place = losses(omega, y, place, wave, coupling)
        by_p = np.stack([2 * length / width * found, size * by_place * 2 / length], axis=1)
        return z + size * found, 1 - size * by_y * y / z, by_p

    return circuit


def candidates(context: EffectContext) -> tuple[Effect, ...]:
    """For thickness-poled plates with three mirror planes, contacted in the middle unless a file says otherwise."""
    if context.dimensions is None or context.poling != "thickness":
        return ()
    length, width, _ = context.dimensions
    typical = context.impedance * width / length
    return (
        Effect(
            name="electrode_resistance",
            sentence="the electrodes are thin, and the current along them loses power in their sheet resistance",
            parameters=(
                EffectParameter(
                    "sheet_resistance", "ohm", 0.0, 10 * typical, 5e-3 * typical, 0.1 * typical, law_error=_LAW_ERROR
                ),
                EffectParameter("contact", "m", 0.0, length / 2, length / 20, length / 4, optional=True),
            ),
            confusable_with=("series_resistance", "tan_s11", "tan_eps33T"),
            advice=(
                "measure the resistance along each electrode with four probes",
                "sweep again with the contacts moved from the middle to one end: the loss in the electrodes grows "
                "fourfold, that in the leads stays the same",
            ),
            circuit=_hook(context, context.dimensions),
            outward=0.7,
        ),
    )
