"""What was measured as Markdown, ready for `benchmarks/README.md`."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

from pepperscene.bench.measure import BenchResult
from pepperscene.bench.peers import CYCLES
from pepperscene.bench.settings import NAMED, OUR_FAMILIES, PLAIN

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


OF_NOTE: tuple[float, ...] = (1.0,)
"""Errors in codes that every scene is compared at, beside those of the named qualities."""


def error_table(measured: Sequence[BenchResult]) -> str:
    """Error and time of each setting of one scene."""
    lines = [
        "| way | setting | RMSE, codes | relative MSE | FLIP | median | least | most | runs |",
        "|---|---|---:|---:|---:|---:|---:|---:|---:|",
    ]
    for one in measured:
        wrong = one.errors
        flip = f"{wrong.flip:.4f}" if math.isfinite(wrong.flip) else ""
        spans = " | ".join(duration(s) for s in (one.median_s, min(one.seconds), max(one.seconds)))
        lines.append(
            f"| {one.family} | {one.name} | {wrong.rmse_codes:.2f} | {wrong.relative_mse:.2g} | {flip} "
            f"| {spans} | {one.runs} |"
        )
    return "\n".join(lines)


def ratios(measured: Sequence[BenchResult]) -> list[dict[str, Any]]:
    """How long others take for the errors that ours reaches, on one scene; see `equal_error`."""
    ours = _points(measured, lambda family: family in OUR_FAMILIES)
    named = {one.errors.rmse_codes: one for one in measured if one.family == NAMED}
    others = {
        "plain path": _points(measured, lambda family: family == PLAIN),
        "Cycles, raw": _points(measured, lambda family: family == f"{CYCLES}, raw"),
        "Cycles, denoised": _points(measured, lambda family: family == f"{CYCLES}, denoised"),
        "Cycles, its best": _points(measured, lambda family: family.startswith(CYCLES)),
    }
    found = []
    for level in sorted({*OF_NOTE, *named}, reverse=True):
        # At its own error a named quality is compared as it is, not the best of all settings.
        own = [(named[level].median_s, level)] if level in named else ours
        for name, points in others.items():
            compared = ratio(level, own, points) if points else None
            if compared is not None:
                found.append(_told(compared, named[level].name if level in named else "best", name))
    return found


def ratio_table(found: Iterable[Mapping[str, Any]]) -> str:
    """The ratios as a table."""
    lines = [
        "| at an error of | ours | takes | against | takes | times as long |",
        "|---:|---|---:|---|---:|---:|",
    ]
    lines += [
        f"| {one['error_codes']:.2f} codes | {one['ours']} | {duration(one['ours_s'])} | {one['other']} "
        f"| {duration(one['other_s'])} | {one['times']:.1f}{' *' if one['beyond'] else ''} |"
        for one in found
    ]
    return "\n".join(lines)


def time_table(rows: Iterable[tuple[str, Sequence[float]]], first: str = "what") -> str:
    """Median, least and most of several times each."""
    import statistics

    lines = [f"| {first} | median | least | most | runs |", "|---|---:|---:|---:|---:|"]
    for name, seconds in rows:
        spans = " | ".join(duration(s) for s in (statistics.median(seconds), min(seconds), max(seconds)))
        lines.append(f"| {name} | {spans} | {len(seconds)} |")
    return "\n".join(lines)


def duration(seconds: float) -> str:
    """A time as one reads it in a table: milliseconds below ten seconds."""
    return f"{1e3 * seconds:,.0f} ms" if seconds < 9.9995 else f"{seconds:,.1f} s"


def _points(measured: Sequence[BenchResult], wanted: Any) -> list[tuple[float, float]]:
    found = [(one.median_s, one.errors.rmse_codes) for one in measured if wanted(one.family)]
    return front(point for point in found if point[1] > 0.0)


def _told(compared: Ratio, ours: str, other: str) -> dict[str, Any]:
    return {
        "error_codes": compared.error,
        "ours": ours,
        "ours_s": compared.ours_s,
        "other": other,
        "other_s": compared.other_s,
        "times": compared.times,
        "beyond": compared.beyond,
    }
