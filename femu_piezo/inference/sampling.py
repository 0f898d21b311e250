"""Samples of a posterior that is not Gaussian about its maximum, each of them a fit to perturbed data.

Every sample is the solution of a fit whose data and prior means are perturbed by draws of their errors,

    x_i = argmin ‖r(x) + δ_i‖²/s² + ‖f(x) + e_i‖²,

r the whitened residual of the data at the noise level s, f that of priors and readings; δ_i is a draw of noise,
discrepancy and errors of laws and mesh, e_i is standard normal (randomised maximum likelihood; Oliver, Reynolds and
Liu, Inverse Theory for Petroleum Reservoir Characterization and History Matching, 2008, section 10.4). For a linear
model these are samples of the posterior. Here the posterior lies on narrow curved ridges (a length and a compliance
move together a thousand times as far as their product may), along which a Markov chain of so many unknowns hardly
moves, whereas a fit does.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from femu_piezo.errors import ConvergenceError, InputError
from femu_piezo.inference.descent import Response
from femu_piezo.inference.fit import Fit, refitted

#: Fewest samples that may be asked for, and the share of the fits that may fail.
FEWEST, _LOST = 50, 0.05


@dataclass(frozen=True)
class Samples:
    """Samples of the unknowns.

    Attributes
    ----------
    names : unknowns as in `Unknowns.names`
    values : (k, n_x) real parts of constants in SI, their loss tangents, parameters of effects in SI
    """

    names: tuple[str, ...]
    values: np.ndarray = field(repr=False)

    def of(self, name: str) -> np.ndarray:
        """(k,) samples of one unknown."""
        return self.values[:, self.names.index(name)]

    def interval(self, name: str, level: float = 0.6827) -> tuple[float, float]:
        """Central interval of one unknown that holds `level` of the samples."""
        low, high = np.quantile(self.of(name), [(1 - level) / 2, (1 + level) / 2])
        return float(low), float(high)


def sample_posterior(
    response: Response,
    solution: Fit,
    count: int = 400,
    *,
    seed: int = 0,
    progress: Callable[[str], None] | None = None,
) -> Samples:
    """Draw `count` independent samples about a fit.

    Parameters
    ----------
    response : Z of the sweeps at given unknowns, as for the fit
    progress : called with a line on how many samples are done

    Raises
    ------
    InputError : fewer than `FEWEST` samples are asked for
    ConvergenceError : more than a few fits do not settle
    """
    if count < FEWEST:
        raise InputError(f"{count} samples tell no interval; ask for {FEWEST} at least, such as 400")
    rng, found, lost = np.random.default_rng(seed), [], 0
    for number in range(count):
        if progress is not None and number % 10 == 0:
            progress(f"sample {number} of {count}")
        sample = refitted(response, solution, _drawn(solution, rng), _pulled(solution, rng))
        if sample is None:
            lost += 1
        else:
            found.append(sample)
    if lost > _LOST * count:
        raise ConvergenceError(
            f"{lost} of {count} fits to drawn data did not settle: the posterior has several maxima, or the data do "
            "not determine the free constants; free fewer"
        )
    units = np.concatenate([solution.parameters.material.units, solution.parameters.scale])
    return Samples(solution.parameters.names, np.array(found) * units)


def _drawn(solution: Fit, rng: np.random.Generator) -> np.ndarray:
    """(2k,) a draw of the errors of the whitened data, not weighted by the loss: noise, discrepancy, laws and mesh."""
    scale = solution.noise_scale
    noise = scale * rng.standard_normal(solution.residual.size)
    discrepancy = None if solution.discrepancy is None else scale * solution.discrepancy.columns
    others = [part for part in (discrepancy, solution.law, solution.mesh) if part is not None]
    weighted = sum(part @ rng.standard_normal(part.shape[1]) for part in others)
    return noise + weighted / np.sqrt(solution.weight)


def _pulled(solution: Fit, rng: np.random.Generator) -> np.ndarray:
    """(m,) a draw of the errors of priors and readings; 0 for the walls of the material, which are no data."""
    unknowns, readings = solution.x.size, len(solution.parameters.readings)
    pulled = np.zeros(solution.further_residual.size)
    pulled[:unknowns] = rng.standard_normal(unknowns)
    if readings:
        pulled[-readings:] = rng.standard_normal(readings)
    return pulled
