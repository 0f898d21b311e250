"""Sweeps of 10 to 30 overlapping modes: how many of the visible modes are found, and that no false ones are."""

import numpy as np
import pytest

from femu_piezo.extraction import extract

from .crowded import crowded, matched


def counted(seeds, error: float = 0.0) -> dict[str, float]:
    """Counts over sweeps: modes with a loop above 5 σ, those whose residue has 5 σ by the Cramér-Rao bound, and how
    many of either are found.

    Also false modes among sound and doubtful ones, and |δλ|/σ of sound poles.
    """
    count, pulls = dict.fromkeys(("seen", "found", "can_be_told", "told", "false", "false_doubtful"), 0), []
    for seed in seeds:
        case = crowded(seed, error)
        extraction = extract(case.spectrum)
        sound = np.array([r.eigenvalue for r in extraction.resonances.poles])
        doubtful = np.array([r.eigenvalue for r in extraction.doubtful if r.kind == "pole"])
        hit, right = matched(np.concatenate([sound, doubtful]), case.poles)
        seen = case.loops > 5
        count["seen"] += np.count_nonzero(seen)
        count["found"] += np.count_nonzero(hit[seen])
        separate = seen & (case.certain > 5)
        count["can_be_told"] += np.count_nonzero(separate)
        count["told"] += np.count_nonzero(hit[separate])
        count["false"] += np.count_nonzero(~right[: sound.size])
        count["false_doubtful"] += np.count_nonzero(~right[sound.size :])
        for one in extraction.resonances.poles:
            away = np.abs(case.poles - one.eigenvalue).min()
            pulls.append(away / np.sqrt(np.trace(one.covariance)))
    return {**count, "median_pull": float(np.median(pulls)), "far": float(np.mean(np.array(pulls) > 3))}


def test_overlapping_modes_are_found_and_no_others():
    """Five sweeps: 98 % of the modes above 5 σ, no false mode, and deviations of the right size."""
    found = counted((0, 5, 6, 7, 9))
    assert found["found"] >= 0.98 * found["seen"]
    assert found["seen"] > 80
    assert found["false"] == found["false_doubtful"] == 0
    assert 0.5 < found["median_pull"] < 1.2  # the median of |δλ|/σ is 0.83 for Gaussian errors of the stated size


def test_a_smooth_error_of_the_instrument_makes_no_modes():
    """A smooth error of 0.1 %: at most one mode is missed, and none is false."""
    found = counted((0, 4), error=1e-3)
    assert found["found"] >= found["seen"] - 1
    assert found["false"] == 0
    assert found["median_pull"] < 1.8


@pytest.mark.slow
@pytest.mark.parametrize("error", [0.0, 1e-3])
def test_recall_and_false_modes(error):
    """50 sweeps: 98 % of the modes with 5 σ by the Cramér-Rao bound, one false mode at most."""
    found = counted(range(100, 150), error)
    print(f"\nerror {error:g}: {found}")
    assert found["told"] >= 0.98 * found["can_be_told"]
    assert found["false"] <= 1
