"""Times at equal error, and Markdown tables."""

from __future__ import annotations

import itertools
import math
import statistics
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

from pepperscene.bench.image_errors import SquaredError
from pepperscene.bench.measure import BenchResult
from pepperscene.bench.settings import NAMED, OUR_FAMILIES, PLAIN

Point = tuple[float, float]
"""Seconds and error, both above 0."""

CODES_OF_INTEREST: Final = 1.0
"""Error in codes at which every scene is compared, besides those of the named qualities: it is invisible, and
the standard quality is to reach it."""

_MAX_DECIMALS: Final = 3
"""Chosen: of printed errors."""

_UNKNOWN: Final = "–"


def pareto_front(points: Iterable[Point]) -> list[Point]:
    """Points that no other point dominates in time and error, from the fastest to the most accurate."""
    front: list[Point] = []
    for seconds, error in sorted(points):
        if not front or error < front[-1][1]:
            front.append((seconds, error))
    return front


def time_at_error(error: float, points: Sequence[Point]) -> float | None:
    """Seconds for an error on the Pareto front of measured points.

    log(seconds) is linear in log(error) between neighbours: Monte Carlo integration follows such a line,
    error ~ seconds^-1/2. None for an error above the largest or below the smallest one of the front.

    Raises:
        ValueError: the error is not above 0.
    """
    if not error > 0.0:
        raise ValueError(f"the error must be above 0, not {error}")
    front = pareto_front(points)
    for (t0, e0), (t1, e1) in itertools.pairwise(front):
        if e1 < error < e0:
            fraction = math.log(error / e0) / math.log(e1 / e0)
            return math.exp(math.log(t0) + fraction * math.log(t1 / t0))
    return next((seconds for seconds, measured in front if measured == error), None)


@dataclass(frozen=True)
class TimeRatio:
    """Times of two families of settings at the same error, which both have measured or surround."""

    error_codes: float  # at which they are compared
    ours: str  # name of pepperscene's setting, or "best"
    ours_s: float  # its seconds
    other: str  # name of the other family
    other_s: float  # its seconds

    @property
    def times(self) -> float:
        """Time of the other family relative to pepperscene's."""
        return self.other_s / self.ours_s


def time_ratios(results: Sequence[BenchResult], others: Mapping[str, str] | None = None) -> list[TimeRatio]:
    """Times of other families at the errors that pepperscene's settings reach, on one scene.

    Args:
        results: of all settings; those without a measurable error are left out.
        others: other families, or groups "name" of families "name, ...", by their names in tables; None for
            the path tracer.
    """
    ours = _points(result for result in results if result.family in OUR_FAMILIES)
    named = {
        result.errors.codes.root: result
        for result in results
        if result.family == NAMED and result.errors.codes.root is not None
    }
    ratios = []
    for error in sorted({CODES_OF_INTEREST, *(root for root in named if root is not None)}, reverse=True):
        # At the error of a named quality that quality is compared, not the best of all settings.
        label, points = ("best", ours) if error not in named else (named[error].name, _points([named[error]]))
        for name, family in (others or {PLAIN: PLAIN}).items():
            other = _points(result for result in results if f"{result.family}, ".startswith(f"{family}, "))
            first, second = time_at_error(error, points), time_at_error(error, other)
            if first is not None and second is not None:
                ratios.append(TimeRatio(error, label, first, name, second))
    return ratios


def relative_path_time(result: BenchResult, results: Iterable[BenchResult]) -> str:
    """Time of the path tracer at a result's error relative to the result's: "36 ×", or "> 32 ×" for a bound.

    If all measured errors of the path tracer are larger, it is a lower bound, from its most accurate
    setting. "–" if the result has no measurable error, if the path tracer's are smaller, or for a bound
    below 1, which says nothing.
    """
    error = result.errors.codes.root
    points = _points(other for other in results if other.family == PLAIN and other.scene == result.scene)
    if error is None or not points:
        return _UNKNOWN
    slowest_s, least_error = points[-1]
    is_bound = error < least_error
    seconds = slowest_s if is_bound else time_at_error(error, points)
    if seconds is None or (is_bound and seconds <= result.median_s):
        return _UNKNOWN
    ratio = seconds / result.median_s
    return f"{'> ' if is_bound else ''}{f'{ratio:.2g}' if ratio < 99.5 else f'{ratio:.0f}'} ×"


def _points(results: Iterable[BenchResult]) -> list[Point]:
    """The Pareto front of the measurable results."""
    points = [(result.median_s, result.errors.codes.root) for result in results]
    return pareto_front((seconds, error) for seconds, error in points if error is not None)


def markdown_table(headers: Sequence[str], rows: Iterable[Sequence[str]], left: int = 1) -> str:
    """A Markdown table; columns after the first `left` ones are aligned to the right."""
    rules = ["---" if column < left else "---:" for column in range(len(headers))]
    lines = [f"| {' | '.join(cells)} |" for cells in (headers, *rows)]
    return "\n".join([lines[0], f"|{'|'.join(rules)}|", *lines[1:]])


def result_table(results: Sequence[BenchResult]) -> str:
    """Error, time and relative time of the path tracer of each setting of all scenes."""
    headers = (
        "scene", "setting", "error, codes", "median time", "min", "max", "runs",
        "path tracer's time at this error",
    )  # fmt: skip
    rows = [
        (
            result.scene,
            result.label,
            format_error(result.errors.codes),
            *_time_cells(result.seconds),
            _UNKNOWN if result.family == PLAIN else relative_path_time(result, results),
        )
        for result in results
    ]
    return markdown_table(headers, rows, left=2)


def format_error(error: SquaredError) -> str:
    """Root mean squared error with its standard error, "1.12 ± 0.02", or an upper limit, "< 0.3".

    Uncertainties and limits are rounded up.
    """
    root, uncertainty = error.root, error.root_uncertainty
    if root is None or uncertainty is None:
        limit = error.root_limit
        if not 0.0 < limit < math.inf:
            return f"< {limit:g}"
        decimals = _decimals(limit)
        return f"< {_round_up(limit, decimals):.{decimals}f}"
    decimals = _decimals(uncertainty) if uncertainty > 0.0 else _MAX_DECIMALS
    return f"{root:.{decimals}f} ± {_round_up(uncertainty, decimals):.{decimals}f}"


def _decimals(value: float) -> int:
    """Decimals that show one digit of a value above 0."""
    return min(max(-math.floor(math.log10(value)), 0), _MAX_DECIMALS)


def _round_up(value: float, decimals: int) -> float:
    # A rounding error of the product must not add a unit.
    return math.ceil(value * 10**decimals * (1.0 - 1e-12)) / 10**decimals


def ratio_table(ratios: Iterable[TimeRatio]) -> str:
    """Times at equal error."""
    headers = ("error", "pepperscene", "time", "compared with", "time", "ratio")
    rows = [
        (
            f"{ratio.error_codes:.2f} codes",
            ratio.ours,
            format_time(ratio.ours_s),
            ratio.other,
            format_time(ratio.other_s),
            f"{ratio.times:.1f}",
        )
        for ratio in ratios
    ]
    return markdown_table(headers, rows, left=0)


def time_table(rows: Iterable[tuple[str, Sequence[float]]], head: str = "what") -> str:
    """Median, minimum and maximum of several times for each row."""
    cells = [(name, *_time_cells(seconds)) for name, seconds in rows]
    return markdown_table((head, "median", "min", "max", "runs"), cells)


def _time_cells(seconds: Sequence[float]) -> tuple[str, ...]:
    times = (statistics.median(seconds), min(seconds), max(seconds))
    return (*map(format_time, times), str(len(seconds)))


def format_time(seconds: float) -> str:
    """A time in milliseconds below ten seconds, else in seconds."""
    return f"{1e3 * seconds:,.0f} ms" if seconds < 9.9995 else f"{seconds:,.1f} s"
