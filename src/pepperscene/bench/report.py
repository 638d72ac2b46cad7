"""Times at equal error, Markdown tables, and the plot of time against error."""

from __future__ import annotations

import io
import math
import statistics
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

from pepperscene.bench.measure import BenchResult
from pepperscene.bench.settings import NAMED, OUR_FAMILIES, PATH, PLAIN

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Point = tuple[float, float]
"""Seconds and error, both above 0."""

MAX_EXTRAPOLATION: Final = 4.0
"""Chosen: ratio of an error to the nearest measured one up to which times are extrapolated."""

CODES_OF_INTEREST: Final = 1.0
"""Error in codes at which every scene is compared, besides those of the named qualities: it is invisible, and
the standard quality is to reach it."""


# --- equal error --------------------------------------------------------------------------------------------


def pareto_front(points: Iterable[Point]) -> list[Point]:
    """Points that no other point dominates in time and error, from the fastest to the most accurate."""
    front: list[Point] = []
    for seconds, error in sorted(points):
        if not front or error < front[-1][1]:
            front.append((seconds, error))
    return front


def time_at_error(error: float, points: Sequence[Point]) -> tuple[float, bool] | None:
    """Seconds for an error on the Pareto front of measured points.

    log(seconds) is linear in log(error) between neighbours and beyond the ends: Monte Carlo integration
    follows such a line, error ~ seconds^-1/2.

    Args:
        error: above 0.
        points: of one family of settings.

    Returns:
        Seconds, and whether they are extrapolated; None for fewer than two points, or too far away.

    Raises:
        ValueError: the error is not above 0.
    """
    if not error > 0.0:
        raise ValueError(f"the error must be above 0, not {error}")
    front = pareto_front(points)
    for seconds, measured in front:
        if measured == error:
            return seconds, False
    if len(front) < 2:
        return None
    if not front[-1][1] / MAX_EXTRAPOLATION <= error <= front[0][1] * MAX_EXTRAPOLATION:
        return None
    extrapolated = not front[-1][1] < error < front[0][1]
    # The two points around the error; beyond the front, the outermost two.
    right = next((i for i in range(1, len(front)) if front[i][1] < error), len(front) - 1)
    (t0, e0), (t1, e1) = front[right - 1], front[right]
    fraction = math.log(error / e0) / math.log(e1 / e0)
    return math.exp(math.log(t0) + fraction * math.log(t1 / t0)), extrapolated


@dataclass(frozen=True)
class TimeRatio:
    """Times of two families of settings at the same error."""

    error_codes: float  # at which they are compared
    ours: str  # name of pepperscene's setting, or "best"
    ours_s: float  # its seconds
    other: str  # name of the other family
    other_s: float  # its seconds
    beyond: bool  # True if one of them is extrapolated

    @property
    def times(self) -> float:
        """Time of the other family relative to pepperscene's."""
        return self.other_s / self.ours_s


def time_ratios(results: Sequence[BenchResult], others: Mapping[str, str] | None = None) -> list[TimeRatio]:
    """Times of other families at the errors that pepperscene's settings reach, on one scene.

    Args:
        results: of all settings.
        others: prefix of each other family, by its name in tables; None for the path tracer.
    """
    ours = _points(result for result in results if result.family in OUR_FAMILIES)
    named = {result.errors.rmse_codes: result for result in results if result.family == NAMED}
    ratios = []
    for error in sorted({CODES_OF_INTEREST, *named}, reverse=True):
        # At the error of a named quality that quality is compared, not the best of all settings.
        label, points = ("best", ours) if error not in named else (named[error].name, _points([named[error]]))
        for name, family in (others or {PLAIN: PLAIN}).items():
            other = _points(result for result in results if result.family.startswith(family))
            first, second = time_at_error(error, points), time_at_error(error, other)
            if first is not None and second is not None:
                ratios.append(TimeRatio(error, label, first[0], name, second[0], first[1] or second[1]))
    return ratios


def _points(results: Iterable[BenchResult]) -> list[Point]:
    points = [(result.median_s, result.errors.rmse_codes) for result in results]
    return pareto_front(point for point in points if point[1] > 0.0)


# --- tables -------------------------------------------------------------------------------------------------


def markdown_table(headers: Sequence[str], rows: Iterable[Sequence[str]], left: int = 1) -> str:
    """A Markdown table; columns after the first `left` ones are aligned to the right."""
    rules = ["---" if column < left else "---:" for column in range(len(headers))]
    lines = [f"| {' | '.join(cells)} |" for cells in (headers, *rows)]
    return "\n".join([lines[0], f"|{'|'.join(rules)}|", *lines[1:]])


def error_table(results: Sequence[BenchResult]) -> str:
    """Errors and times of each setting of one scene."""
    headers = ("family", "setting", "RMSE, codes", "relative MSE", "FLIP", "median", "min", "max", "runs")
    rows = [
        (
            result.family,
            result.name,
            f"{result.errors.rmse_codes:.2f}",
            f"{result.errors.relative_mse:.2g}",
            f"{result.errors.flip:.4f}",
            *_time_cells(result.seconds),
        )
        for result in results
    ]
    return markdown_table(headers, rows, left=2)


def ratio_table(ratios: Iterable[TimeRatio]) -> str:
    """Times at equal error."""
    headers = ("error", "ours", "time", "compared with", "time", "ratio")
    rows = [
        (
            f"{ratio.error_codes:.2f} codes",
            ratio.ours,
            format_time(ratio.ours_s),
            ratio.other,
            format_time(ratio.other_s),
            f"{ratio.times:.1f}{' *' if ratio.beyond else ''}",
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


# --- plot ---------------------------------------------------------------------------------------------------


_COLOURS: Final = {"ours": "#0072b2", PLAIN: "#d55e00", PATH: "#b07800"}
_OTHER_COLOUR: Final = "#00795a"
"""After Okabe and Ito (2008), for the colour-blind too; two of them darker, for lines on white."""

_MARKERS: Final = "osD^vP"
_DASHES: Final[tuple[Any, ...]] = ("-", "--", "-.", ":", (0, (5, 1)), (0, (1, 1)))
_STYLE: Final = {"svg.fonttype": "none", "svg.hashsalt": "pepperscene", "font.size": 10}


def plot_pareto(
    results: Sequence[BenchResult], title: str, subtitle: str, floor: float | None = None
) -> dict[str, bytes]:
    """Plot error against time of the settings of one scene, as "png" and "svg".

    Args:
        results: of its settings.
        title: above the plot.
        subtitle: below the title.
        floor: error of the reference in codes, drawn as a line.
    """
    import matplotlib
    from matplotlib.figure import Figure

    with matplotlib.rc_context(_STYLE):
        figure = Figure(figsize=(10, 6.2), layout="constrained")
        axes = figure.subplots()
        figure.suptitle(title, x=0.01, ha="left", fontsize=13, fontweight="bold")
        axes.set_title(subtitle, loc="left", fontsize=9, color="0.35")
        _draw_results(axes, [result for result in results if result.errors.rmse_codes > 0.0], floor)
        figure.legend(loc="outside right upper", labelcolor="linecolor", frameon=False)
        files = {}
        for file_format in ("png", "svg"):
            file = io.BytesIO()
            metadata = {"Date": None} if file_format == "svg" else None
            figure.savefig(file, format=file_format, dpi=150, metadata=metadata)
            files[file_format] = file.getvalue()
        return files


def _draw_results(axes: Axes, results: Sequence[BenchResult], floor: float | None) -> None:
    from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter

    families: list[str] = []
    for family in dict.fromkeys(result.family for result in results):
        colour = next((c for start, c in _COLOURS.items() if family.startswith(start)), _OTHER_COLOUR)
        style = families.count(colour) % len(_MARKERS)
        families.append(colour)
        members = [result for result in results if result.family == family]
        points = sorted((result.median_s, result.errors.rmse_codes) for result in members)
        # Named qualities are single points with a name, not a line.
        named = family.startswith(NAMED)
        axes.plot(
            *zip(*points, strict=True),
            label=family,
            color=colour,
            marker=_MARKERS[style],
            linestyle="none" if named else _DASHES[style],
            markersize=10 if named else 5,
            markerfacecolor="white" if named else colour,
            zorder=4 if family in OUR_FAMILIES else 3,
        )
        for result in members if named else ():
            point = (result.median_s, result.errors.rmse_codes)
            axes.annotate(result.name, point, (9, 7), textcoords="offset points", fontweight="bold", zorder=5)
    front = _points(results)
    axes.plot(*zip(*front, strict=True), color="0.85", linewidth=7, zorder=1, solid_capstyle="round")
    axes.set(xscale="log", yscale="log")
    axes.margins(x=0.08, y=0.1)
    for axis in (axes.xaxis, axes.yaxis):
        low, high = axis.get_view_interval()
        # At least a decade, so that some ticks are inside.
        margin = max((10.0 * low / high) ** 0.5, 1.0)
        axis.set_view_interval(low / margin, high * margin, ignore=True)
        axis.set_major_locator(LogLocator(10.0, subs=(1.0, 2.0, 5.0), numticks=40))
        axis.set_major_formatter(StrMethodFormatter("{x:g}"))
        axis.set_minor_formatter(NullFormatter())
    low, high = axes.get_ylim()
    for error, name in ((CODES_OF_INTEREST, "1 code"), (floor, "error of the reference")):
        if error and low < error < high:
            axes.axhline(error, color="0.6", linewidth=0.8, zorder=0)
            axes.annotate(
                name,
                (0.005, error),
                (0, 3),
                ("axes fraction", "data"),
                "offset points",
                fontsize=8,
                color="0.4",
            )
    axes.grid(which="major", color="0.93", linewidth=0.8)
    axes.spines[["top", "right"]].set_visible(False)
    axes.set_xlabel("seconds per frame, in sequence (median)")
    axes.set_ylabel("RMSE of the noise-free image, 8-bit codes")
