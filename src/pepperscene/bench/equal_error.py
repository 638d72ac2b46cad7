"""How long one way takes for the error of another: lines between measured points, log against log."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Final

FURTHEST: Final = 4.0
"""Chosen: how many times smaller, or larger, than all that were measured an error may be. Further off, a line
through two points says nothing."""

Point = tuple[float, float]
"""Seconds and error, both above 0."""


@dataclass(frozen=True)
class TimeFor:
    """What a way of rendering takes for an error.

    Attributes:
        seconds: on the line through its points.
        beyond: True where the error is smaller, or larger, than all that were measured, so that the
            outermost two points' line was drawn on.
    """

    seconds: float
    beyond: bool


def front(points: Iterable[Point]) -> list[Point]:
    """The points that none other beats in both time and error, from the quickest to the most accurate."""
    best: list[Point] = []
    for seconds, error in sorted(points):
        if not best or error < best[-1][1]:
            best.append((seconds, error))
    return best


def time_for(error: float, points: Sequence[Point]) -> TimeFor | None:
    """Seconds for an error on the front of the points; None with fewer than two points on it, or far beyond.

    Between neighbours, and beyond the ends, log(seconds) is linear in log(error): the law of Monte Carlo
    integration, error ~ seconds^-1/2, is such a line, whatever its slope.

    Raises:
        ValueError: the error is not above 0.
    """
    if not error > 0.0:
        raise ValueError(f"an error above 0 is needed, not {error}")
    best = front(points)
    measured = [seconds for seconds, held in best if held == error]
    if measured:
        return TimeFor(measured[0], beyond=False)
    if len(best) < 2 or not best[-1][1] / FURTHEST <= error <= best[0][1] * FURTHEST:
        return None
    beyond = not best[-1][1] < error < best[0][1]
    # The pair about the error; outside, the pair at that end.
    right = next((i for i in range(1, len(best)) if best[i][1] < error), len(best) - 1)
    (t0, e0), (t1, e1) = best[right - 1], best[right]
    share = math.log(error / e0) / math.log(e1 / e0)
    return TimeFor(math.exp(math.log(t0) + share * math.log(t1 / t0)), beyond)


@dataclass(frozen=True)
class Ratio:
    """How many times as long the other way takes for the same error.

    Attributes:
        error: at which.
        ours_s, other_s: seconds of both.
        beyond: True where one of them lies beyond what was measured.
    """

    error: float
    ours_s: float
    other_s: float
    beyond: bool

    @property
    def times(self) -> float:
        """Other over ours."""
        return self.other_s / self.ours_s


def ratio(error: float, ours: Sequence[Point], other: Sequence[Point]) -> Ratio | None:
    """The ratio at an error; None where one of the two cannot tell."""
    first, second = time_for(error, ours), time_for(error, other)
    if first is None or second is None:
        return None
    return Ratio(error, first.seconds, second.seconds, first.beyond or second.beyond)
