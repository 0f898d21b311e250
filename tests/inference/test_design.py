"""The design of a sweep against determinants taken one by one."""

from __future__ import annotations

import numpy as np
import pytest

from femu_piezo.inference.design import chosen, information, observed


@pytest.fixture
def problem():
    rng = np.random.default_rng(5)
    rows = rng.standard_normal((40, 2, 6))
    root = rng.standard_normal((6, 6))
    return rows, root @ root.T + 0.1 * np.eye(6), np.array([0, 3])


def test_a_measurement_is_that_of_the_information_matrix(problem):
    rows, covariance, _ = problem
    found = observed(covariance, rows[0])
    assert found == pytest.approx(np.linalg.inv(np.linalg.inv(covariance) + rows[0].T @ rows[0]), rel=1e-9)


def test_information_is_what_the_marginal_determinant_loses(problem):
    """½ ln det C_SS before less after, everything else marginalised."""
    rows, covariance, wanted = problem
    part = np.ix_(wanted, wanted)
    gains = information(rows, covariance, wanted)
    for number in (0, 7, 39):
        after = observed(covariance, rows[number])
        lost = 0.5 * (np.linalg.slogdet(covariance[part])[1] - np.linalg.slogdet(after[part])[1])
        assert gains[number] == pytest.approx(lost, rel=1e-9)


def test_each_choice_is_the_best_of_those_left(problem):
    rows, covariance, wanted = problem
    found = chosen(rows, covariance, wanted, 8)
    assert len(set(found)) == 8
    part = np.ix_(wanted, wanted)
    for place, number in enumerate(found):
        left = [k for k in range(len(rows)) if k not in found[:place]]
        determinants = [np.linalg.det(observed(covariance, rows[k])[part]) for k in left]
        assert left[int(np.argmin(determinants))] == number
        covariance = observed(covariance, rows[number])
    assert chosen(rows[:3], covariance, wanted, 8).__len__() == 3


def test_nothing_is_spent_on_what_is_not_asked_for():
    """A frequency that tells of another unknown alone is taken last, however much it tells."""
    rows = np.zeros((3, 2, 2))
    rows[0, 0] = [0, 100]
    rows[1, 0] = [1, 0]
    rows[2, 0] = [0.5, 0]
    assert chosen(rows, np.eye(2), np.array([0]), 3) == [1, 2, 0]
