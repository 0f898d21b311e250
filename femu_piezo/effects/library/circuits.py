"""What leads, contacts and the fixture add around the terminals; either sign, since a compensation can take too much.

    series_resistance   Z' = Z + R            stray_capacitance   Y' = Y + jωC
    series_inductance   Z' = Z + jωL          leakage             Y' = Y + G

What a fixture leaves after its compensation (`residue` of the specimen file) is the tolerance of all but the leakage,
which is nearest to the body; then come the leads, and the cable.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from femu_piezo.effects.effect import CircuitHook, Effect, EffectContext, EffectParameter


def _in_series(slope: Callable[[np.ndarray], np.ndarray]) -> CircuitHook:
    """Z' = Z + p · slope(ω)."""

    def circuit(omega: np.ndarray, z: np.ndarray, p: np.ndarray):
        own = slope(omega)
        return z + own * p[0], np.ones_like(z), own[:, None]

    return circuit


def _in_parallel(slope: Callable[[np.ndarray], np.ndarray]) -> CircuitHook:
    """Y' = Y + p · slope(ω)."""

    def circuit(omega: np.ndarray, z: np.ndarray, p: np.ndarray):
        own = slope(omega)
        ratio = 1 / (1 + own * p[0] * z)  # Z'/Z, and ∂Z'/∂Z = ratio²
        return z * ratio, ratio**2, (-own * (z * ratio) ** 2)[:, None]

    return circuit


def _constant(omega: np.ndarray) -> np.ndarray:
    return np.ones(omega.shape, dtype=complex)


def _derivative(omega: np.ndarray) -> np.ndarray:
    return 1j * omega


def candidates(context: EffectContext) -> tuple[Effect, ...]:
    """Usual sizes follow the specimen: a share of its impedance, of its capacitance, of its admittance."""
    typical_capacitance = 1 / (2 * np.pi * context.fundamental_Hz * context.impedance)
    typical_inductance = context.impedance / (2 * np.pi * context.fundamental_Hz)
    conductance = 1 / context.impedance
    tolerances = context.tolerances
    return (
        Effect(
            name="series_resistance",
            sentence="the leads or contacts have a series resistance that was not compensated",
            parameters=(
                EffectParameter(
                    "resistance",
                    "ohm",
                    -1e5,
                    1e5,
                    1e-3 * context.impedance,
                    0.02 * context.impedance,
                    tolerance=tolerances.get("resistance", 0.0),
                ),
            ),
            confusable_with=("tan_s11", "tan_eps33T"),
            advice=("measure with a four-wire fixture after a short-circuit compensation",),
            circuit=_in_series(_constant),
            outward=2.0,
        ),
        Effect(
            name="series_inductance",
            sentence="the leads have a series inductance that was not compensated",
            parameters=(
                EffectParameter(
                    "inductance",
                    "H",
                    -1e-2,
                    1e-2,
                    1e-3 * typical_inductance,
                    0.02 * typical_inductance,
                    tolerance=tolerances.get("inductance", 0.0),
                ),
            ),
            confusable_with=("series_resistance", "dielectric_dispersion"),
            advice=("measure with a four-wire fixture after a short-circuit compensation",),
            circuit=_in_series(_derivative),
            outward=3.0,
        ),
        Effect(
            name="stray_capacitance",
            sentence="cable or fixture add a capacitance parallel to the specimen",
            parameters=(
                EffectParameter(
                    "capacitance",
                    "F",
                    -0.5 * typical_capacitance,
                    3 * typical_capacitance,
                    0.01 * typical_capacitance,
                    0.1 * typical_capacitance,
                    tolerance=tolerances.get("capacitance", 0.0),
                ),
            ),
            confusable_with=("eps33T",),
            advice=(
                "measure the open fixture without the specimen and compensate it",
                "measure a second specimen of the same material and other size: ε33T scales with it, a stray "
                "capacitance does not",
            ),
            circuit=_in_parallel(_derivative),
            outward=4.0,
        ),
        Effect(
            name="leakage",
            sentence="a conductance leaks parallel to the specimen (surface, moisture, fixture)",
            parameters=(
                EffectParameter(
                    "conductance", "S", -0.1 * conductance, conductance, 1e-3 * conductance, 0.02 * conductance
                ),
            ),
            confusable_with=("tan_eps33T", "dielectric_dispersion"),
            advice=(
                "measure at 100 Hz to 1 kHz, where a conductance outweighs the capacitance",
                "clean and dry the rim",
            ),
            circuit=_in_parallel(_constant),
            outward=1.0,
        ),
    )
