"""Rate and remaining time of a build, by a clock that the test sets."""

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
    throughput = Throughput(10, clock)
    assert (throughput.frames_per_s, throughput.left_s) == (None, None)


def test_a_steady_rate_until_the_end(clock):
    throughput = Throughput(10, clock)
    for left in (4.5, 4.0, 3.5, 3.0, 2.5, 2.0, 1.5, 1.0, 0.5, 0.0):
        clock.now += 0.5
        throughput.count(True)
        assert throughput.frames_per_s == pytest.approx(2.0)
        assert throughput.left_s == pytest.approx(left)


def test_existing_frames_do_not_count_for_the_rate(clock):
    throughput = Throughput(100, clock)
    for _ in range(50):
        clock.now += 0.01
        throughput.count(False)
    assert throughput.left_s is None
    clock.now += 2.0
    throughput.count(True)
    assert throughput.frames_per_s == pytest.approx(0.5)
    assert throughput.left_s == pytest.approx(49 / 0.5)


@pytest.mark.parametrize(("slow", "fast"), [(50, 3000), (13, 100)])
def test_the_rate_follows_recent_frames(clock, slow, fast):
    throughput = Throughput(10_000, clock)
    for step in [10.0] * slow + [0.1 if fast > 1000 else 2.0] * fast:
        clock.now += step
        throughput.count(True)
    assert throughput.frames_per_s == pytest.approx(10.0 if fast > 1000 else 0.5)
