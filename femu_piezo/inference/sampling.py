"""Posterior samples of a fit, where the Gaussian around the best point is not to be trusted (emcee, optional)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from femu_piezo.errors import ConvergenceError, InputError
from femu_piezo.inference.blocks import DataBlock
from femu_piezo.inference.least_squares import Fit

#: Independent samples below which an answer is refused.
_ENOUGH = 1000


@dataclass(frozen=True)
class Posterior:
    """Samples of the unknowns.

    Attributes
    ----------
    names : unknowns as in `MaterialParameters.names`
    samples : (k, m) real parts in SI, loss tangents; burn-in removed, thinned to near independence
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
    blocks: Sequence[DataBlock], solution: Fit, *, steps: int = 2000, walkers: int | None = None, seed: int = 0
) -> Posterior:
    """Sample exp(−½ Σ residual²), data in units of the noise reached, by affine-invariant ensemble sampling.

    Parameters
    ----------
    blocks : the data blocks of the fit
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

    def log_probability(x: np.ndarray) -> float:
        if np.any(x <= lower) or np.any(x >= upper):
            return -np.inf
        parts = zip(blocks, solution.block_scales, strict=True)
        residual = np.concatenate([block.residual(parameters, x) / scale for block, scale in parts])
        return float(-0.5 * residual @ residual)

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
    scale[0::2] = parameters.scale
    return Posterior(parameters.names, chain * scale, times)
