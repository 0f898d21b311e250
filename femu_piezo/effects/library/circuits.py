"""What leads, contacts and the fixture add at the terminals; either sign, since a compensation may take off too much.

    series_resistance   Z' = Z + R              stray_capacitance   Y' = Y + jωC (1 − j tan δ)
    series_inductance   Z' = Z + jωL/(1 + jωτ)  leakage             Y' = Y + G
    contact_gap         Z' = Z + E/(jω + 2πc)   cable               Z' = Zc (Z + Zc tanh γℓ)/(Zc + Z tanh γℓ)

E = 1/C is the inverse of the capacitance of a gap between a face and its electrode, C = ε0 A/g where the gap g is even;
below its corner frequency c = G/(2πC) a gap of conductance G leaks more than it stores.
Metal near the leads carries eddy currents, which add a resistance ω²τL to the inductance L of the leads below ω = 1/τ.
A cable of length ℓ has per metre the series impedance s = R + jωZ0/v and the shunt admittance y = jω/(Z0 v), γ² = s y
and Zc² = s/y: Z0 is its wave impedance but for the resistance R of its conductors, and v the wave speed of solid
polyethylene (velocity factor 0.66, as RG-58 has), so that ℓ is the length of such a cable. One short against the
wavelength is a stray capacitance ℓ/(v Z0), an inductance Z0 ℓ/v and a resistance R ℓ.

What remains of R, L and C after the compensation of a fixture (`residue` of the specimen file) is their tolerance. The
gap is nearest to the body, then the leakage; then come the leads, the fixture, and the cable.
"""

from __future__ import annotations

import numpy as np

from femu_piezo.effects.effect import Effect, EffectContext, EffectParameter


def _in_series(z: np.ndarray, impedance: np.ndarray | float, *slopes: np.ndarray):
    """Z' = Z + impedance, with the slopes of the impedance in the parameters."""
    return z + impedance, np.ones_like(z), np.stack(slopes, axis=1)


def _in_parallel(z: np.ndarray, admittance: np.ndarray | float, *slopes: np.ndarray):
    """Y' = Y + admittance, with the slopes of the admittance in the parameters."""
    ratio = 1 / (1 + admittance * z)  # Z'/Z, and ∂Z'/∂Z = ratio²
    found = z * ratio
    return found, ratio**2, np.stack(slopes, axis=1) * -(found**2)[:, None]


def _resistor(omega: np.ndarray, z: np.ndarray, p: np.ndarray):
    """Z' = Z + R, p = (R,)."""
    return _in_series(z, p[0], np.ones_like(z))


def _conductance(omega: np.ndarray, z: np.ndarray, p: np.ndarray):
    """Y' = Y + G, p = (G,)."""
    return _in_parallel(z, p[0], np.ones_like(z))


def _capacitor(omega: np.ndarray, z: np.ndarray, p: np.ndarray):
    """Y' = Y + jωC (1 − j tan δ), p = (C, tan δ)."""
    by_capacitance = 1j * omega * (1 - 1j * p[1])
    return _in_parallel(z, by_capacitance * p[0], by_capacitance, omega * p[0])


def _lead(omega: np.ndarray, z: np.ndarray, p: np.ndarray):
    """Z' = Z + jωL/(1 + jωτ), p = (L, τ)."""
    by_inductance = 1j * omega / (1 + 1j * omega * p[1])
    return _in_series(z, by_inductance * p[0], by_inductance, -p[0] * by_inductance**2)


def _gap(omega: np.ndarray, z: np.ndarray, p: np.ndarray):
    """Z' = Z + E/(jω + 2πc), p = (E, c)."""
    share = 1 / (1j * omega + 2 * np.pi * p[1])
    return _in_series(z, p[0] * share, share, -2 * np.pi * p[0] * share**2)


#: Usual capacitance of a specimen over that of a gap: 0.34 where 1 mm of ceramic with ε33T = 3400 ε0 has a tenth of a
#: micrometre of air in series.
_GAP = 0.5
#: Usual capacitance of clips and half a metre of unshielded leads, F, however small the specimen is.
_CLIPS = 20e-12
#: Wave speed in a cable, m/s, and its usual wave impedance, ohm.
_WAVE_SPEED, _WAVE_IMPEDANCE = 0.66 * 299792458.0, 50.0


def _cable(omega: np.ndarray, z: np.ndarray, p: np.ndarray):
    """A line with p = (ℓ, Z0, R): Z' = (Z A + B)/(Z C + A), A = cosh γℓ, B = Zc sinh γℓ and C = sinh γℓ/Zc."""
    length, z0, resistance = p
    by_z0 = 1j * omega / _WAVE_SPEED  # ∂s/∂Z0
    s, y = resistance + by_z0 * z0, by_z0 / z0
    gamma = np.sqrt(s * y) * length
    a, share = np.cosh(gamma), np.sinc(1j * gamma / np.pi)  # sinh γℓ/γℓ
    denominator = a + z * y * length * share
    found = (z * a + s * length * share) / denominator
    by_length = s - y * found**2  # a Riccati equation along the line
    more, less = length * (a + share) / 2, length * (a - share) / 2
    a_by_s, a_by_y = y * length**2 * share / 2, s * length**2 * share / 2
    by_s = (z * a_by_s + more - found * (z * less * y / s + a_by_s)) / denominator
    by_y = (z * a_by_y + less * s / y - found * (z * more + a_by_y)) / denominator
    return found, 1 / denominator**2, np.stack([by_length, by_s * by_z0 - by_y * y / z0, by_s], axis=1)


def candidates(context: EffectContext) -> tuple[Effect, ...]:
    """Usual sizes are shares of impedance, admittance and capacitance of the specimen, the last at least `_CLIPS`."""
    omega = 2 * np.pi * context.fundamental_Hz
    typical_capacitance, typical_inductance = 1 / (omega * context.impedance), context.impedance / omega
    conductance, stray = 1 / context.impedance, max(0.1 * typical_capacitance, _CLIPS)
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
            circuit=_resistor,
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
                EffectParameter(
                    "time_constant",
                    "s",
                    -1 / omega,
                    1 / omega,
                    0.02 / omega,
                    0.05 / omega,
                    starts=(0.05 / omega,),
                    optional=True,
                ),
            ),
            confusable_with=("series_resistance", "dielectric_dispersion"),
            advice=("measure with a four-wire fixture after a short-circuit compensation",),
            circuit=_lead,
            outward=3.0,
        ),
        Effect(
            name="stray_capacitance",
            sentence="the cable or the fixture adds a capacitance in parallel with the specimen",
            parameters=(
                EffectParameter(
                    "capacitance",
                    "F",
                    -0.5 * typical_capacitance,
                    30 * stray,
                    0.1 * stray,
                    stray,
                    tolerance=tolerances.get("capacitance", 0.0),
                ),
                # 2e-4 of polyethylene to 0.1 of soft PVC
                EffectParameter("loss_tangent", "1", -0.2, 0.2, 0.01, 0.03, optional=True, often_small=True),
            ),
            confusable_with=("eps33T",),
            advice=(
                "sweep the open fixture without the specimen, and compensate its capacitance",
                "measure a second specimen of the same material and another size: its capacitance differs, the stray "
                "capacitance stays the same",
            ),
            circuit=_capacitor,
            outward=4.0,
        ),
        Effect(
            name="leakage",
            sentence="a leakage conductance lies in parallel with the specimen (surface, moisture, fixture)",
            parameters=(
                EffectParameter(
                    "conductance", "S", -0.1 * conductance, conductance, 1e-3 * conductance, 0.02 * conductance
                ),
            ),
            confusable_with=("tan_eps33T", "dielectric_dispersion"),
            advice=(
                "measure at 100 Hz to 1 kHz, where a leakage conductance raises the loss tangent most",
                "clean and dry the rim",
            ),
            circuit=_conductance,
            outward=1.0,
        ),
        Effect(
            name="contact_gap",
            sentence="an electrode or contact does not touch its face, and the gap is a capacitance in series",
            parameters=(
                EffectParameter(
                    "inverse_capacitance",
                    "1/F",
                    0.0,
                    10 / typical_capacitance,
                    1e-3 / typical_capacitance,
                    _GAP / typical_capacitance,
                ),
                EffectParameter(
                    "corner_frequency",
                    "Hz",
                    0.0,
                    context.fundamental_Hz,
                    0.02 * context.fundamental_Hz,
                    0.05 * context.fundamental_Hz,
                    starts=(0.02 * context.fundamental_Hz, 0.1 * context.fundamental_Hz),
                    optional=True,
                ),
            ),
            confusable_with=("eps33T", "d31", "series_inductance"),
            advice=(
                "measure again with electrodes sputtered or painted onto the faces",
                "press the contacts harder, or move them: this changes a gap, but not the material",
                "measure a second specimen of the same material and another thickness: both have the same ε33T",
            ),
            circuit=_gap,
            outward=0.5,
        ),
        Effect(
            name="cable",
            sentence="a length of cable between instrument and specimen was not compensated",
            parameters=(
                EffectParameter("length", "m", -20.0, 100.0, 0.05, 1.0),
                EffectParameter("wave_impedance", "ohm", 20.0, 200.0, 10.0, 15.0, rest=_WAVE_IMPEDANCE, optional=True),
                # 0.05 ohm/m of RG-58 to 0.4 of RG-174, more by the skin effect
                EffectParameter("conductor_resistance", "ohm/m", 0.0, 5.0, 0.05, 0.2, optional=True),
            ),
            confusable_with=("stray_capacitance", "series_inductance", "series_resistance", "eps33T"),
            advice=(
                "sweep the cable with its end open for its capacitance, and with its end shorted for its inductance",
                "measure again at the terminals of the instrument, or compensate with the cable in place",
            ),
            circuit=_cable,
            outward=5.0,
        ),
    )
