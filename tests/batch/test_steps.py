"""What the steps of a lot hand back."""

import numpy as np

from femu_piezo.batch.steps import finite


def test_records_hold_plain_numbers_and_none_where_there_is_none():
    """Numbers of numpy, tuples, NaN and infinity at any depth, and numbers as keys."""
    record = {
        "a": np.float64(0.1),
        "b": (np.int64(3), float("nan"), [np.inf, -np.inf, True, None]),
        "c": {"d": np.array([1.0, np.nan]), 2: "words"},
        "e": np.bool_(False),
    }
    found = finite(record)
    assert found == {
        "a": 0.1,
        "b": [3, None, [None, None, True, None]],
        "c": {"d": [1.0, None], "2": "words"},
        "e": False,
    }
    assert type(found["a"]) is float and type(found["b"][0]) is int and type(found["e"]) is bool
    assert finite(np.float64("nan")) is None
    exact = np.random.default_rng(1).standard_normal(1000) * 10.0 ** np.arange(-250, 250, 0.5)
    assert np.array_equal(finite(exact), exact)
