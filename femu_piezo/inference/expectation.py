"""Standard deviations expected of a sweep before it is measured, and what a smaller tolerance would gain.

The model is linearised about the expected values (law of propagation, Guide to the Expression of Uncertainty in
Measurement, 5.1): with J the Jacobian of the data whitened by noise, R that of the readings over their deviations, and
Σ the prior covariance,

    H = Jᵗ J + Rᵗ R + Σ^-1,    covariance = H^-1 = H^-1 Jᵗ J H^-1 + H^-1 Rᵗ R H^-1 + Σ_g H^-1 Σ_g^-1 H^-1

that is noise, readings, and every group g of tolerances, as in `femu_piezo.inference.budget`. A smaller tolerance is a
smaller prior deviation, for which H^-1 is computed again: the better known quantity also weighs more in the fit. What
only data can tell, a discrepancy or an error of the mesh, is not included.
"""

from __future__ import annotations

import numpy as np

from femu_piezo.inference.budget import SOURCES, groups
from femu_piezo.inference.fit import precision_inverse
from femu_piezo.inference.unknowns import Unknowns

#: Share of a tolerance at which its quantity counts as exactly known.
EXACT = 1e-6


def expected_covariance(jacobian: np.ndarray, prior_std: np.ndarray) -> np.ndarray:
    """H^-1 (n_x, n_x) of a whitened Jacobian (m, n_x) of data and readings, and prior standard deviations (n_x,)."""
    return precision_inverse(np.concatenate([jacobian, np.diag(1 / prior_std)]), prior_std)


def expected_std(jacobian: np.ndarray, prior_std: np.ndarray) -> np.ndarray:
    """(n_x,) standard deviations of the unknowns."""
    return np.sqrt(np.diag(expected_covariance(jacobian, prior_std)))


def expected_budget(sweeps: np.ndarray, readings: np.ndarray, unknowns: Unknowns) -> dict[str, np.ndarray]:
    """Source → (n_x,) its part of the expected deviation of every unknown; the squares add up to the variances.

    Parameters
    ----------
    sweeps, readings : (2k, n_x), (m, n_x) whitened Jacobians
    """
    covariance = expected_covariance(np.concatenate([sweeps, readings]), unknowns.prior_std)
    parts = {"noise": np.linalg.norm(covariance @ sweeps.T, axis=1)}
    if readings.size:
        parts["readings"] = np.linalg.norm(covariance @ readings.T, axis=1)
    for source, columns in groups(unknowns).items():
        parts[source] = np.linalg.norm(covariance[:, columns] / unknowns.prior_std[columns], axis=1)
    return {source: parts[source] for source in SOURCES if source in parts}
