"""The choice of frequencies for a sweep, against determinants computed for every single choice."""

from __future__ import annotations

import numpy as np
import pytest

from femu_piezo.inference.design import (
    covariance_after,
    information,
    misfit_after_refit,
    most_informative,
    most_separating,
)


@pytest.fixture
def problem():
    """Slopes (40, 2, 6) of 40 candidate frequencies, a covariance (6, 6), and the two unknowns that are asked for."""
    rng = np.random.default_rng(5)
    rows = rng.standard_normal((40, 2, 6))
    root = rng.standard_normal((6, 6))
    return rows, root @ root.T + 0.1 * np.eye(6), np.array([0, 3])


def test_covariance_after_a_measurement(problem):
    """`covariance_after` gives (C^-1 + JᵗJ)^-1."""
    rows, covariance, _ = problem
    found = covariance_after(covariance, rows[0])
    assert found == pytest.approx(np.linalg.inv(np.linalg.inv(covariance) + rows[0].T @ rows[0]), rel=1e-9)


def test_information_is_what_the_marginal_determinant_loses(problem):
    """½ ln det C_SS before less that after a measurement, the other unknowns marginalised."""
    rows, covariance, wanted = problem
    part = np.ix_(wanted, wanted)
    gains = information(rows, covariance, wanted)
    for number in (0, 7, 39):
        after = covariance_after(covariance, rows[number])
        lost = 0.5 * (np.linalg.slogdet(covariance[part])[1] - np.linalg.slogdet(after[part])[1])
        assert gains[number] == pytest.approx(lost, rel=1e-9)


def test_each_frequency_is_the_best_of_the_remaining_ones(problem):
    """The determinant of the wanted unknowns' covariance is the least with it; with three candidates no more than
    three are chosen.
    """
    rows, covariance, wanted = problem
    found = most_informative(rows, covariance, wanted, 8)
    assert len(set(found)) == 8
    part = np.ix_(wanted, wanted)
    for place, number in enumerate(found):
        remaining = [k for k in range(len(rows)) if k not in found[:place]]
        determinants = [np.linalg.det(covariance_after(covariance, rows[k])[part]) for k in remaining]
        assert remaining[int(np.argmin(determinants))] == number
        covariance = covariance_after(covariance, rows[number])
    assert most_informative(rows[:3], covariance, wanted, 8).__len__() == 3


def test_a_frequency_that_informs_about_other_unknowns_comes_last():
    """However precise it is about them."""
    rows = np.zeros((3, 2, 2))
    rows[0, 0] = [0, 100]
    rows[1, 0] = [1, 0]
    rows[2, 0] = [0.5, 0]
    assert most_informative(rows, np.eye(2), np.array([0]), 3) == [1, 2, 0]


@pytest.fixture
def explanations(problem):
    """Two explanations with different unknowns, and the whitened difference (40, 2) of what they predict."""
    rng = np.random.default_rng(7)
    rows, covariance, _ = problem
    root = rng.standard_normal((4, 4))
    other = (0.7 * rng.standard_normal((40, 2, 4)), root @ root.T + 0.1 * np.eye(4))
    return [(rows, covariance), other], 3 * rng.standard_normal((40, 2))


def test_what_is_missed_is_the_misfit_of_a_refit(explanations):
    """The least over δ of |e − J δ|² + δᵗ C^-1 δ, by least squares."""
    for (rows, covariance), error in ((one, explanations[1]) for one in explanations[0]):
        flat = rows.reshape(80, -1)
        stacked = np.concatenate([flat, np.linalg.cholesky(np.linalg.inv(covariance)).T])
        target = np.concatenate([error.ravel(), np.zeros(len(covariance))])
        remainder = target - stacked @ np.linalg.lstsq(stacked, target, rcond=None)[0]
        assert misfit_after_refit(flat, covariance, error.ravel()) == pytest.approx(remainder @ remainder, rel=1e-9)


def test_each_frequency_separates_two_explanations_best(explanations):
    """Each next frequency is the one with which the summed misfit of both explanations, refitted to all frequencies
    so far, is largest.
    """
    two, apart = explanations
    found = most_separating(two, apart, 6)
    assert len(set(found)) == 6

    def misfit(places: list[int]) -> float:
        return sum(
            misfit_after_refit(rows[places].reshape(2 * len(places), -1), covariance, apart[places].ravel())
            for rows, covariance in two
        )

    for place, number in enumerate(found):
        remaining = [k for k in range(len(apart)) if k not in found[:place]]
        assert remaining[int(np.argmax([misfit([*found[:place], k]) for k in remaining]))] == number
    assert misfit(found) > 2 * misfit(list(range(0, 36, 6)))


def test_a_difference_that_a_refit_absorbs_is_not_chosen():
    """The largest difference lies along an unknown that either explanation may still change; the smaller one at the
    other frequency is chosen.
    """
    rows = np.zeros((2, 2, 1))
    rows[0, 0] = 1.0
    apart = np.array([[3.0, 0.0], [1.0, 0.0]])
    explanation = (rows, np.array([[100.0]]))
    assert most_separating([explanation, explanation], apart, 1) == [1]
    assert misfit_after_refit(rows[:1].reshape(2, 1), np.array([[100.0]]), apart[0]) == pytest.approx(9 / 101)
