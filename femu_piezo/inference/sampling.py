"""Posterior samples of a fit, where the Gaussian around the best point is not to be trusted (emcee, optional)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from femu_piezo.errors import ConvergenceError, InputError
from femu_piezo.inference.fit import Fit, Response, log_posterior

#: Independent samples below which an answer is refused.
_ENOUGH = 1000


@dataclass(frozen=True)
class Posterior:
    """Samples of the unknowns.

    Attributes
    ----------
    names : unknowns as in `Unknowns.names`
    samples : (k, m) real parts of constants in SI, their loss tangents, parameters of effects over their scales;
        burn-in removed, thinned to near independence
    autocorrelation : (m,) integrated autocorrelation times of the chain, steps
    """

    names: tuple[str, ...]
    samples: np.ndarray
    autocorrelation: np.ndarray

    def interval(self, name: str, level: float = 0.68) -> tuple[float, float]:
        """Central interval of one unknown that holds `level` of the samples."""
        column = self.samples[:, self.names.index(name)]
        low, high = np.quantile(column, [(1 - level) / 2, (1 + level) / 2])
        return float(low), float(high)


def sample_posterior(
    response: Response, solution: Fit, *, steps: int = 2000, walkers: int | None = None, seed: int = 0
) -> Posterior:
    """Sample the posterior of a fit by affine-invariant ensemble sampling, at the noise level reached.

    Parameters
    ----------
    response : Z of the sweeps at given unknowns, as for the fit
    steps, walkers : length of the chain and size of the ensemble (4 per unknown where None)

    Raises
    ------
    InputError : emcee is not installed
    ConvergenceError : the chain is too short for its autocorrelation; the message says how long it should be
    """
    try:
        import emcee
    except ImportError:
        raise InputError("sampling needs the package emcee: pip install 'femu-piezo[sampling]'") from None

    parameters = solution.parameters
    lower, upper = parameters.bounds.T

    density = log_posterior(response, solution)

    def log_probability(x: np.ndarray) -> float:
        return -np.inf if np.any(x <= lower) or np.any(x >= upper) else density(x)

    size = solution.x.size
    walkers = walkers or 4 * size
    rng = np.random.default_rng(seed)
    start = rng.multivariate_normal(solution.x, solution.covariance, walkers)
    start = np.clip(start, lower + 1e-9, upper - 1e-9)
    sampler = emcee.EnsembleSampler(walkers, size, log_probability)
    sampler._random.seed(seed)
    sampler.run_mcmc(start, steps)
    times = sampler.get_autocorr_time(tol=0)
    longest = float(np.max(times))
    if not steps * walkers / longest > _ENOUGH:
        needed = int(np.ceil(_ENOUGH * longest / walkers))
        raise ConvergenceError(
            f"the chain of {steps} steps has an autocorrelation of {longest:.0f}; ask for {needed} steps"
        )
    chain = sampler.get_chain(discard=int(5 * longest), thin=max(int(longest / 2), 1), flat=True)
    scale = np.ones(size)
    scale[: parameters.of_material : 2] = parameters.material.scale
    return Posterior(parameters.names, chain * scale, times)
