"""The uncertainty budget of a fit: how much of every variance comes from noise, dimensions, held constants and so on.

About the solution the estimate is linear in the data and in the prior means,

    x = H^-1 (Jᵗ y/s² + Σ^-1 m),    H = Jᵗ J/s² + Σ^-1.

So its covariance is the sum of what each source contributes (law of propagation, Guide to the Expression of
Uncertainty in Measurement, 5.1): A N Aᵗ with A = H^-1 Jᵗ/s² from noise N, s² A K Aᵗ from the discrepancy,
A L Lᵗ Aᵗ from errors of the laws of causes, likewise from mesh and basis, H^-1 Rᵗ R H^-1 from readings of other
instruments, and H^-1 Σ_g^-1 H^-1 from the prior means of the unknowns of group g.
"""

from __future__ import annotations

import numpy as np

from femu_piezo.effects.effect import Effect
from femu_piezo.inference.fit import Fit
from femu_piezo.inference.unknowns import Estimate, MaterialParameters, Unknowns

#: Sources of uncertainty in the order they are listed; "law" is the errors of the approximate laws of causes, "prior"
#: the priors of free constants and causes, and the walls of the material.
SOURCES = (
    *("noise", "readings", "mesh", "discrepancy", "law", "geometry", "density", "held", "instrument"),
    *("temperature", "prior"),
)


def source_of(effect: Effect) -> str:
    """Which source of the budget the tolerance of an effect belongs to."""
    if effect.freed:
        return "prior"
    if effect.resizes:
        return "geometry"
    if effect.density is not None:
        return "density"
    if effect.of_conditions:
        return "temperature"
    return "held" if effect.constants is not None else "instrument"


def budget(fit: Fit) -> dict[str, np.ndarray]:
    """Source → (n_x,) its part of the standard deviation of every unknown; the squares add up to the variances."""
    inverse, squares = fit.precision_inverse, fit.gain**2
    share = np.tile(fit.data.model_share, 2) if fit.data.model_share.size else np.zeros(fit.residual.size)
    noise = fit.noise_scale**2
    parts = {"noise": noise * (squares @ (1 - share)), "mesh": noise * (squares @ share)}
    if fit.discrepancy is not None:
        parts["discrepancy"] = noise * np.sum((fit.gain @ fit.discrepancy.columns) ** 2, axis=1)
    if fit.mesh is not None:
        parts["mesh"] += np.sum((fit.gain @ fit.mesh) ** 2, axis=1)
    if fit.law is not None and fit.law.size:
        parts["law"] = np.sum((fit.gain @ fit.law) ** 2, axis=1)
    for source, columns in groups(fit.parameters).items():
        moves = inverse[:, columns] / fit.parameters.prior_std[columns]
        parts[source] = parts.get(source, 0.0) + np.sum(moves**2, axis=1)
    further = (inverse @ fit.prior_rows[fit.x.size :].T) ** 2
    wall, read = np.split(further, [further.shape[1] - len(fit.parameters.readings)], axis=1)
    parts["prior"] = parts["prior"] + np.sum(wall, axis=1)
    if read.size:
        parts["readings"] = np.sum(read, axis=1)
    return {source: np.sqrt(parts[source]) for source in SOURCES if source in parts}


def groups(parameters: Unknowns) -> dict[str, np.ndarray]:
    """Source → (m,) places in x of the unknowns whose prior means are this source."""
    found: dict[str, list[int]] = {"prior": list(range(parameters.of_material))}
    for number, effect in enumerate(parameters.effects):
        source = "prior" if effect.key in parameters.candidates else source_of(effect)
        found.setdefault(source, []).extend(range(*parameters.columns(number).indices(parameters.count)))
    return {source: np.array(columns) for source, columns in found.items()}


def constants_of(fit: Fit) -> dict[str, Estimate]:
    """Free constant → value and loss tangent with standard deviations and budgets."""
    return estimates_of(fit.parameters.material, fit.x, fit.std, budget(fit))


def estimates_of(
    material: MaterialParameters, x: np.ndarray, std: np.ndarray, parts: dict[str, np.ndarray]
) -> dict[str, Estimate]:
    """Free constant → its estimate, from unknowns x (n_x,), their deviations and the parts of these (n_x,)."""
    found = {}
    for index, (name, scale) in enumerate(zip(material.free.names, material.scale, strict=True)):
        real, tangent = 2 * index, 2 * index + 1
        size = abs(scale)
        found[name] = Estimate(
            value=float(scale * x[real]),
            std=float(size * std[real]),
            tan=float(x[tangent]),
            tan_std=float(std[tangent]),
            budget={source: float(size * part[real]) for source, part in parts.items()},
            tan_budget={source: float(part[tangent]) for source, part in parts.items()},
        )
    return found
