"""Segments of a list sweep: they contain every frequency of the list, and no sweep is longer than the analyser
allows.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from femu_piezo.measurement.segments import RESOLUTION, Segment, in_sweeps, segment_data, segments

lists = st.lists(st.floats(40.0, 1e8), min_size=1, max_size=60).map(np.array)


@given(lists)
def test_every_frequency_is_a_point_of_a_segment(frequency):
    found = segments(frequency)
    every = np.concatenate([one.frequency for one in found])
    apart = np.min(np.abs(every[:, None] - frequency), axis=0)
    assert np.all(apart <= 1.01 * RESOLUTION) and all(one.points >= 2 for one in found)
    assert every.size <= np.unique(np.round(frequency, 3)).size + len(found)


@given(lists)
def test_segments_rise_within_the_list_and_do_not_overlap(frequency):
    found = segments(frequency)
    assert all(one.start < one.stop for one in found)
    assert all(one.stop < other.start or one.stop == other.start for one, other in pairwise(found))
    assert found[-1].stop <= frequency.max() + RESOLUTION
    assert found[0].start >= frequency.min() * (1 - 1.1e-4) - RESOLUTION


def test_equal_steps_are_one_segment_and_others_pairs():
    assert segments(np.linspace(1e3, 2e3, 11)) == [Segment(1e3, 2e3, 11)]
    assert segments(np.array([1e3, 2e3, 4e3, 8e3])) == [Segment(1e3, 2e3, 2), Segment(4e3, 8e3, 2)]
    assert segments(np.array([1e3, 2e3, 4e3])) == [Segment(1e3, 2e3, 2), Segment(3e3, 4e3, 2)]


@given(lists, st.integers(1, 20), st.integers(2, 30))
def test_no_sweep_has_more_than_the_analyser_takes(frequency, most_segments, most_points):
    found = segments(frequency)
    parts = list(in_sweeps(found, most_segments, most_points))
    assert all(len(part) <= most_segments and sum(one.points for one in part) <= most_points for part in parts)
    every = np.concatenate([one.frequency for part in parts for one in part])
    assert np.allclose(every, np.concatenate([one.frequency for one in found]), rtol=1e-12)


def test_the_argument_of_the_segment_command():
    """As in the sample program of the E4990A help, with nothing set for the segments."""
    found = segment_data([Segment(1e4, 1e5, 50), Segment(1.5e5, 1e6, 200)])
    assert found == "7,0,0,0,0,0,0,0,2,10000.000,100000.000,50,150000.000,1000000.000,200"
