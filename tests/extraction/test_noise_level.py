"""Relative and additive noise estimated from the residual of a fit by maximum likelihood."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import minimize

from femu_piezo.extraction.noise_level import noise_from_residual


def drawn(relative: float, additive: float, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Errors (401,) and impedances (401,), ohm, over four decades of |Z|."""
    rng = np.random.default_rng(seed)
    impedance = np.geomspace(1.0, 1e4, 401) * np.exp(1j * rng.uniform(-1.5, 1.5, 401))
    sigma = np.hypot(relative * np.abs(impedance), additive)
    return sigma * (rng.standard_normal((401, 2)) @ [1, 1j]) / np.sqrt(2), impedance


@pytest.mark.parametrize("seed", range(10))
def test_both_parts_are_the_likeliest(seed):
    """The likelihood is that at the end of a simplex search, and both parts are within 15 % of the true ones."""
    error, impedance = drawn(1e-3, 0.05, seed)
    found = noise_from_residual(error, impedance, 0)
    assert (found.relative, found.additive) == pytest.approx((1e-3, 0.05), rel=0.15)

    def negative(logs: np.ndarray) -> float:
        """Negative log likelihood, up to a factor and a constant."""
        variance = np.exp(2 * logs[0]) * np.abs(impedance) ** 2 + np.exp(2 * logs[1])
        return float(np.sum(np.log(variance) + np.abs(error) ** 2 / variance))

    logs = np.log([found.relative, found.additive])
    by_simplex = minimize(negative, np.log([2e-3, 0.02]), method="Nelder-Mead", options={"xatol": 1e-8, "fatol": 1e-10})
    assert negative(logs) < by_simplex.fun + 1e-7
    assert logs == pytest.approx(by_simplex.x, abs=1e-4)


def test_relative_noise_alone_has_no_additive_part():
    """In nine of ten draws at least, since an additive part has to increase the likelihood enough."""
    found = [noise_from_residual(*drawn(1e-3, 0.0, seed), 0) for seed in range(20)]
    assert sum(one.additive == 0 for one in found) >= 18
