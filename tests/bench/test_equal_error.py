"""Times at equal error on made power laws, where they are known."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pepperscene.bench.tables import FURTHEST, front, ratio, time_for


def law(times, level, slope):
    """Points of error = level * seconds^-slope."""
    return [(t, level * t**-slope) for t in times]


@given(
    slope=st.floats(0.1, 2.0),
    level=st.floats(0.01, 100.0),
    share=st.floats(-0.3, 1.3),
)
def test_a_power_law_is_found_between_and_beyond(slope, level, share):
    points = law((1.0, 4.0, 16.0, 64.0), level, slope)
    seconds = 64.0**share
    error = level * seconds**-slope
    found = time_for(error, points)
    if not points[-1][1] / FURTHEST <= error <= points[0][1] * FURTHEST:
        assert found is None
        return
    assert found.seconds == pytest.approx(seconds, rel=1e-6)
    assert found.beyond == (not 1.0 <= seconds <= 64.0) or seconds == pytest.approx(64.0)


def test_ratio_of_two_laws():
    # Monte Carlo with thirty times the time for the same error.
    ours, other = law((0.5, 1.0, 2.0), 1.0, 0.5), law((1.0, 4.0, 16.0), np.sqrt(30.0), 0.5)
    found = ratio(1.0, ours, other)
    assert found.times == pytest.approx(30.0)
    assert (found.ours_s, found.other_s) == (pytest.approx(1.0), pytest.approx(30.0))
    # The other one has to be drawn on from 16 s to 30 s.
    assert found.beyond


def test_a_measured_point_is_taken_as_it_is():
    found = time_for(2.0, [(3.0, 2.0)])
    assert (found.seconds, found.beyond) == (3.0, False)
    assert not time_for(1.0, law((1.0, 4.0), 1.0, 0.5)).beyond


def test_one_point_tells_nothing_of_other_errors():
    assert time_for(1.0, [(3.0, 2.0)]) is None
    assert ratio(1.0, [(3.0, 2.0)], law((1, 2), 1, 0.5)) is None


def test_the_front_leaves_out_what_is_beaten():
    points = [(1.0, 5.0), (2.0, 6.0), (2.0, 3.0), (3.0, 3.0), (4.0, 1.0)]
    assert front(points) == [(1.0, 5.0), (2.0, 3.0), (4.0, 1.0)]
    assert time_for(6.0, points).beyond


@pytest.mark.parametrize("error", [0.0, -1.0, float("nan")])
def test_an_error_of_nothing_is_refused(error):
    with pytest.raises(ValueError, match="above 0"):
        time_for(error, [(1.0, 1.0), (2.0, 0.5)])
