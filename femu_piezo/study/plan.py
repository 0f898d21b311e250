"""A plan of a sweep: points that watch the whole band, and points that tell most of the free constants."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from femu_piezo.errors import InputError
from femu_piezo.inference.design import covariance_after, most_informative
from femu_piezo.inference.response import Evaluation
from femu_piezo.inference.unknowns import Unknowns
from femu_piezo.measurement.spectrum import evenly
from femu_piezo.study.expectation import labels_of, whitened_jacobian
from femu_piezo.study.subjects import Subject
from femu_piezo.study.unknowns import as_filed, unknowns_of

#: Share of the points that are spread over the band, so that a resonance nobody expects is seen too.
SPREAD = 0.5
#: Frequencies to choose from: number over the band, and distances from each pole and zero in half widths.
_CANDIDATES, _ABOUT = 4001, np.linspace(-4.0, 4.0, 41)
#: Fewest points of a plan.
FEWEST = 16


@dataclass(frozen=True)
class Plan:
    """Frequencies of a sweep.

    Attributes
    ----------
    frequency : (n,) Hz, rising
    expected : recipe → "s11", "tan_s11", … → standard deviation (SI) that an update would state; recipes are this plan,
        as many and four times as many points equally spaced, and as many, half of them about poles and zeros
    """

    frequency: np.ndarray
    expected: Mapping[str, Mapping[str, float]]

    def to_json(self) -> dict:
        """ "plan" of identifiability.json."""
        return {
            "frequency_Hz": self.frequency.tolist(),
            "expected_std": {name: dict(one) for name, one in self.expected.items()},
        }


def plan_sweep(subject: Subject, evaluation: Evaluation, noise: float, points: int) -> Plan:
    """The plan of a sweep of one specimen over the band of an evaluation.

    Parameters
    ----------
    noise : relative standard deviation of every point
    points : at least 16

    Raises InputError for fewer.
    """
    if points < FEWEST:
        raise InputError(f"a plan of {points} points does not show a resonance; give at least {FEWEST}")
    unknowns = unknowns_of([subject], [evaluation.model])
    x = as_filed([subject], unknowns)
    labels = labels_of(unknowns.material)
    wanted = np.array([column for column, _ in labels.values()])
    low, high = evaluation.omega[[0, -1]] / (2 * np.pi)
    resonances = resonances_of(evaluation, unknowns, x)

    def rows(frequency: np.ndarray) -> np.ndarray:
        """(k, 2, n_x) whitened Jacobian per prior standard deviation, Re and Im of each frequency."""
        at = replace(evaluation, omega=2 * np.pi * frequency)
        sweep, _ = whitened_jacobian(unknowns, x, [subject], [at], noise)
        return (sweep * unknowns.prior_std).reshape(2, frequency.size, -1).transpose(1, 0, 2)

    readings = whitened_jacobian(unknowns, x, [subject], [evaluation], noise)[1] * unknowns.prior_std
    prior = covariance_after(np.eye(x.size), readings) if len(readings) else np.eye(x.size)

    def deviations(frequency: np.ndarray) -> dict[str, float]:
        std = np.sqrt(np.diag(covariance_after(prior, rows(frequency).reshape(-1, x.size)))) * unknowns.prior_std
        return {label: float(std[column] * size) for label, (column, size) in labels.items()}

    watching = np.linspace(low, high, round(SPREAD * points))
    candidates = np.setdiff1d(candidate_frequencies(resonances, low, high), watching)
    known = covariance_after(prior, rows(watching).reshape(-1, x.size))
    found = most_informative(rows(candidates), known, wanted, points - watching.size)
    frequency = np.sort(np.concatenate([watching, candidates[found]]))
    crowded = np.unique(np.concatenate([watching, _thinned(_about(resonances, low, high), points - watching.size)]))
    recipes = {
        "plan": frequency,
        "equal": np.linspace(low, high, points),
        "equal, four times": np.linspace(low, high, 4 * points),
        "dense at resonances": crowded,
    }
    return Plan(frequency, {name: deviations(one) for name, one in recipes.items()})


def resonances_of(evaluation: Evaluation, unknowns: Unknowns, x: np.ndarray) -> np.ndarray:
    """Poles and zeros λ (m,) of a model at unknowns (n_x,)."""
    modal = evaluation.modal(unknowns, x)
    found = np.concatenate([modal.eigenvalues, modal.zeros[0]])
    return found[found.real > 0]


def candidate_frequencies(resonances: np.ndarray, low: float, high: float) -> np.ndarray:
    """Frequencies (k,) to choose from, Hz, rising: over a band, and denser about its poles and zeros λ (m,)."""
    return np.union1d(np.linspace(low, high, _CANDIDATES), _about(resonances, low, high))


def _about(resonances: np.ndarray, low: float, high: float) -> np.ndarray:
    """Frequencies (k,) about poles and zeros within a band, Hz, rising."""
    middle = np.sqrt(resonances.real) / (2 * np.pi)
    found = middle[:, None] * (1 + _ABOUT * np.abs(resonances.imag / resonances.real)[:, None] / 2)
    return np.sort(found[(found > low) & (found < high)])


def _thinned(values: np.ndarray, count: int) -> Sequence[float]:
    return values[evenly(values.size, count)]
