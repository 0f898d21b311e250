"""What the data can tell about each constant, and what they cannot.

The whitened Jacobian J in relative unknowns (real part over its value, loss tangent) holds it all: its singular
values are the signal-to-noise ratios of combinations of constants, (JᵗJ)^-1 their joint covariance, and 1/|J_i|
the standard deviation a constant would have if all others were known.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

#: Relative standard deviations of a real part that count as determined well, and at all.
WELL, AT_ALL = 0.01, 0.05
#: Absolute standard deviations of a loss tangent that count so.
TANGENT_WELL, TANGENT_AT_ALL = 0.002, 0.01
#: Singular values below this share of the largest count as zero.
_ZERO = 1e-15


@dataclass(frozen=True)
class Identifiability:
    """Attributes
    ----------
    names : unknowns, real parts relative to their value, tangents absolute
    singular_values : (m,) descending; the inverse is the standard deviation of the combination
    combinations : (m, m) rows are the combinations, unit length
    std : (m,) joint standard deviations; inf where the data leave a constant open
    std_alone : (m,) standard deviation if every other constant were known
    correlation : (m, m); nan rows where std is infinite
    """

    names: tuple[str, ...]
    singular_values: np.ndarray
    combinations: np.ndarray = field(repr=False)
    std: np.ndarray
    std_alone: np.ndarray
    correlation: np.ndarray = field(repr=False)

    def verdict(self, name: str) -> str:
        """ "well", "weakly" or "not" determined by the data, for one unknown."""
        std = self.std[self.names.index(name)]
        well, at_all = (TANGENT_WELL, TANGENT_AT_ALL) if name.startswith("tan_") else (WELL, AT_ALL)
        return "well" if std <= well else "weakly" if std <= at_all else "not"

    def verdict_or_absent(self, name: str) -> str:
        """As `verdict`, "absent" for an unknown that the problem does not have."""
        return self.verdict(name) if name in self.names else "absent"

    def weakest(self, count: int = 3) -> list[str]:
        """The combinations the data determine least, in words: their standard deviation and largest members."""
        sentences = []
        for index in range(len(self.names))[::-1][:count]:
            row = self.combinations[index]
            members = [i for i in np.argsort(-np.abs(row)) if abs(row[i]) > 0.3]
            terms = " ".join(f"{row[i]:+.2f} {self.names[i]}" for i in members)
            std = 1 / self.singular_values[index] if self.singular_values[index] > 0 else np.inf
            sentences.append(f"{terms} is known to {std:.2g}")
        return sentences

    def confounded(self, limit: float = 0.95) -> list[tuple[str, str, float]]:
        """Pairs of unknowns whose estimates are correlated beyond `limit`."""
        count = len(self.names)
        return [
            (self.names[i], self.names[j], float(self.correlation[i, j]))
            for i in range(count)
            for j in range(i)
            if abs(self.correlation[i, j]) > limit
        ]


def identifiability(jacobian: np.ndarray, names: tuple[str, ...], values: np.ndarray) -> Identifiability:
    """Analyse a whitened Jacobian (k, m) in the unknowns of `MaterialParameters`.

    Parameters
    ----------
    values : (m,) the unknowns x; real parts are made relative to their value
    """
    relative = np.where([name.startswith("tan_") for name in names], 1.0, values)
    scaled = jacobian * relative
    _, singular, combinations = np.linalg.svd(scaled, full_matrices=False)
    open_ = singular <= _ZERO * singular[0]
    with np.errstate(divide="ignore"):
        inverse = np.where(open_, np.inf, 1 / np.where(open_, 1.0, singular))
    contribution = np.where(np.abs(combinations) < 1e-8, 0.0, combinations) ** 2
    variance = np.array([np.sum(c[c > 0] * inverse[c > 0] ** 2) for c in contribution.T])
    finite = np.where(open_, 0.0, inverse**2)
    covariance = (combinations.T * finite) @ combinations
    std = np.sqrt(variance)
    with np.errstate(divide="ignore", invalid="ignore"):
        correlation = covariance / np.outer(std, std)
        alone = 1 / np.linalg.norm(scaled, axis=0)
    correlation[~np.isfinite(std), :] = np.nan
    correlation[:, ~np.isfinite(std)] = np.nan
    return Identifiability(names, singular, combinations, std, alone, correlation)
