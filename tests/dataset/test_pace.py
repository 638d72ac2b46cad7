"""Rate and time left, by a clock that the test winds."""

from __future__ import annotations

import pytest

from pepperscene.dataset.execution.build import Throughput


class Clock:
    def __init__(self):
        self.now = 100.0

    def __call__(self):
        return self.now


@pytest.fixture
def clock():
    return Clock()


def test_nothing_is_known_before_the_first_frame(clock):
    pace = Throughput(10, clock)
    assert (pace.frames_per_s, pace.left_s) == (None, None)


def test_a_steady_rate(clock):
    pace = Throughput(10, clock)
    for _ in range(4):
        clock.now += 0.5
        pace.count(True)
    assert pace.frames_per_s == pytest.approx(2.0)
    assert pace.left_s == pytest.approx(3.0)


def test_frames_that_were_there_do_not_count_for_the_rate(clock):
    pace = Throughput(100, clock)
    for _ in range(50):
        clock.now += 0.01
        pace.count(False)
    assert pace.left_s is None
    clock.now += 2.0
    pace.count(True)
    assert pace.frames_per_s == pytest.approx(0.5)
    assert pace.left_s == pytest.approx(49 / 0.5)


def test_the_rate_follows_what_happens_lately(clock):
    pace = Throughput(10_000, clock)
    for step in [10.0] * 50 + [0.1] * 3000:
        clock.now += step
        pace.count(True)
    assert pace.frames_per_s == pytest.approx(10.0)


def test_the_end(clock):
    pace = Throughput(1, clock)
    clock.now += 1
    pace.count(True)
    assert pace.left_s == 0
