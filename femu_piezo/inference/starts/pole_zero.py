"""Pole-zero updating of Cong et al. (2022): measured λ of one pole and one zero → two complex constants.

`update_simplified` is the paper's iteration for k31 plates (figures 4, 5) and k33 bars (figure 7) in the
variables (c11, γ) or (c33, κ); `update_pair` is the same Newton step in any two free constants of the full
anisotropic model. Sensitivities are exact: with α fixed, K = c11 K‡ + γ K_γ (eqs 52-58) and ∂λ/∂c11, ∂λ/∂γ follow
from the e-form sensitivities of the eigenvalue by the chain rule.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from femu_piezo.errors import ConvergenceError
from femu_piezo.forward.fundamental import PairSource, PoleZeroPair
from femu_piezo.inference.free_constants import FreeConstants
from femu_piezo.material.constants import PiezoConstants
from femu_piezo.material.simplified import Simplified, SimplifiedK31, SimplifiedK33

#: Relative distance |λ_model − λ_measured| at which an iteration ends.
TOLERANCE = 1e-10


@dataclass(frozen=True)
class Step:
    """One iteration: the constants it started from and the model's λ there."""

    constants: PiezoConstants
    eigenvalues: np.ndarray


@dataclass(frozen=True)
class PoleZeroUpdate:
    """Outcome of an update.

    Attributes
    ----------
    constants : the updated ten constants
    history : the iterations in order, the last at the updated constants
    """

    constants: PiezoConstants
    history: tuple[Step, ...]

    @property
    def iterations(self) -> int:
        """Number of constant updates made."""
        return len(self.history) - 1


def low_frequency_permittivity(frequency_Hz: float, impedance: complex, gap: float, area: float) -> complex:
    """ε33T = d/(2π f_L A |Z_L|) and tan δ = Re Z_L/|Im Z_L|, returned as ε33T(1 − j tan δ), F/m (eqs 41, 42).

    As printed, with the modulus of Z: the real part is too large by tan²δ/2. `static_permittivity` is exact.

    Parameters
    ----------
    frequency_Hz : f_L, far below the first resonance
    impedance : Z_L at f_L, ohm
    gap, area : distance between the electrodes (m) and area of one (m²)
    """
    eps = gap / (2 * np.pi * frequency_Hz * area * abs(impedance))
    return complex(eps * (1 - 1j * impedance.real / abs(impedance.imag)))


def static_permittivity(frequency_Hz: np.ndarray, impedance: np.ndarray, gap: float, area: float) -> np.ndarray:
    """Complex ε33T (n,) = d/(jω A Z) of a stress-free uniform plate, F/m, from its Z (n,) at frequencies (n,).

    gap, area : as `low_frequency_permittivity`
    """
    return gap / (2j * np.pi * frequency_Hz * area * impedance)


def _stiffness_slopes(simple: Simplified, sensitivity: np.ndarray) -> np.ndarray:
    """(2, 2) ∂λ/∂(c, γ) at fixed α from e-form sensitivities (2, 10) (eqs 52-58, 61).

    Scaling e31, e33 and ε33S all with γ changes γ alone, since the potential scales out of K_γ.
    """
    e_form = simple.full().to_e_form()
    alpha = simple.alpha
    elastic = sensitivity[:, :5] @ np.array([1.0, alpha, alpha, 1.0, (1 - alpha) / 2])
    electric = sensitivity[:, [5, 6, 9]] @ np.array([e_form.e31, e_form.e33, e_form.eps33S])
    return np.stack([elastic, electric / _electric_stiffness(simple)], axis=1)


def _electric_stiffness(simple: Simplified) -> complex:
    return simple.gamma if isinstance(simple, SimplifiedK31) else simple.kappa


def _elastic_stiffness(simple: Simplified) -> complex:
    return simple.c11 if isinstance(simple, SimplifiedK31) else simple.c33


def paper_step(
    simple: Simplified, pair: PoleZeroPair, measured: np.ndarray, eps33T: complex
) -> tuple[Simplified, complex, complex]:
    """One pass of figure 5 (k31) or 7 (k33): the 2×2 system (61), then (34), (33), (63), (62), (40).

    Parameters
    ----------
    measured : (2,) complex λ of the measured pole and zero
    eps33T : measured permittivity, F/m, which enters at (63)

    Returns
    -------
    the new simplified constants, and the new c11 (c33) and γ (κ) in Pa
    """
    slopes = _stiffness_slopes(simple, pair.sensitivities)
    scale = np.array([_elastic_stiffness(simple), _electric_stiffness(simple)])
    change = np.linalg.solve(slopes * scale, measured - pair.eigenvalues) * scale
    stiffness, electric = scale + change
    if isinstance(simple, SimplifiedK31):
        return SimplifiedK31.from_stiffness(stiffness, electric, eps33T, simple.s12), stiffness, electric
    return SimplifiedK33.from_stiffness(stiffness, electric, eps33T, simple.s13), stiffness, electric


def update_simplified(
    source: PairSource,
    start: Simplified,
    measured: np.ndarray,
    eps33T: complex,
    *,
    tolerance: float = TOLERANCE,
    max_iterations: int = 40,
) -> PoleZeroUpdate:
    """The paper's update of (s11, d31) or (s33, d33) at known ε33T and s12 or s13.

    Parameters
    ----------
    source : model pair at given constants
    start : baseline constants, its own eps33T included
    measured : (2,) complex λ of pole and zero, rad²/s²
    eps33T : measured permittivity, F/m (eqs 41, 42)
    tolerance : relative distance |λ_model − λ_measured| at which the iteration ends

    Raises
    ------
    ConvergenceError : the iteration leaves the physical range, or does not settle
    """
    measured = np.asarray(measured, dtype=complex)
    near = float(np.sqrt(measured[0].real)) / (2 * np.pi)
    simple, history = start, list[Step]()
    for _ in range(max_iterations + 1):
        constants = simple.full()
        _check_step(constants, history)
        pair = source(constants, near)
        history.append(Step(constants, pair.eigenvalues))
        if np.max(np.abs(pair.eigenvalues / measured - 1)) < tolerance:
            return PoleZeroUpdate(constants, tuple(history))
        simple, _, _ = paper_step(simple, pair, measured, eps33T)
    raise _not_settled(history, measured)


def update_pair(
    source: PairSource,
    free: FreeConstants,
    measured: np.ndarray,
    *,
    tolerance: float = TOLERANCE,
    max_iterations: int = 40,
) -> PoleZeroUpdate:
    """Complex Newton iteration for two free constants of the full model: Σ (∂λ_i/∂θ_n) δθ_n = λ_i' − λ_i (app. A).

    `measured`: (2,) complex λ. Steps that would change a constant by more than 40 % are shortened. Errors as
    `update_simplified`.
    """
    measured = np.asarray(measured, dtype=complex)
    near = float(np.sqrt(measured[0].real)) / (2 * np.pi)
    theta, history = free.start.copy(), list[Step]()
    for _ in range(max_iterations + 1):
        constants = free.constants(theta)
        _check_step(constants, history)
        pair = source(constants, near)
        history.append(Step(constants, pair.eigenvalues))
        if np.max(np.abs(pair.eigenvalues / measured - 1)) < tolerance:
            return PoleZeroUpdate(constants, tuple(history))
        slopes = pair.sensitivities @ free.e_form_jacobian(theta)
        relative = np.linalg.solve(slopes * theta, measured - pair.eigenvalues)
        largest = np.max(np.abs(relative))
        theta = theta * (1 + relative * (0.4 / largest if largest > 0.4 else 1.0))
    raise _not_settled(history, measured)


def _check_step(constants: PiezoConstants, history: list[Step]) -> None:
    faults = constants.physical_faults(passive=False)
    if faults:
        raise ConvergenceError(
            f"pole-zero update: after {len(history)} iterations {'; '.join(map(str, faults))}; the measured pole and "
            "zero do not belong to one mode of this plate: check dimensions, density and the known constants"
        )


def _not_settled(history: list[Step], measured: np.ndarray) -> ConvergenceError:
    away = np.max(np.abs(history[-1].eigenvalues / measured - 1))
    return ConvergenceError(
        f"pole-zero update: {len(history) - 1} iterations left the model {away:.1e} (relative) from the measured pole "
        "and zero; start from a closer base material or check dimensions, density and the extracted pole and zero"
    )
