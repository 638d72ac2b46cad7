"""Times at equal error, Markdown tables, and the plot of time against error."""

from __future__ import annotations

import io
import itertools
import math
import statistics
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

from pepperscene.bench.measure import BenchResult
from pepperscene.bench.reference import SquaredError
from pepperscene.bench.settings import ADAPTIVE, NAMED, OUR_FAMILIES, PATH, PLAIN

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Point = tuple[float, float]
"""Seconds and error, both above 0."""

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


def time_at_error(error: float, points: Sequence[Point]) -> float | None:
    """Seconds for an error on the Pareto front of measured points.

    log(seconds) is linear in log(error) between neighbours: Monte Carlo integration follows such a line,
    error ~ seconds^-1/2.

    Args:
        error: above 0.
        points: of one family of settings.

    Returns:
        Seconds; None for an error above the largest or below the smallest one of the front.

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


def relative_path_time(result: BenchResult, results: Iterable[BenchResult]) -> float | None:
    """Time of the path tracer at a result's error relative to the result's; None if it is not measured."""
    error = result.errors.codes.root
    if error is None:
        return None
    points = _points(other for other in results if other.family == PLAIN and other.scene == result.scene)
    seconds = time_at_error(error, points)
    return None if seconds is None else seconds / result.median_s


def _points(results: Iterable[BenchResult]) -> list[Point]:
    """The Pareto front of the measurable results."""
    points = [(result.median_s, result.errors.codes.root) for result in results]
    return pareto_front((seconds, error) for seconds, error in points if error is not None)


# --- tables -------------------------------------------------------------------------------------------------


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
    rows = []
    for result in results:
        ratio = relative_path_time(result, results)
        rows.append(
            (
                result.scene,
                result.label,
                format_error(result.errors.codes),
                *_time_cells(result.seconds),
                "–" if ratio is None else f"{ratio:.2g} ×" if ratio < 99.5 else f"{ratio:.0f} ×",
            )
        )
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
    decimals = _decimals(uncertainty) if uncertainty > 0.0 else _MOST_DECIMALS
    return f"{root:.{decimals}f} ± {_round_up(uncertainty, decimals):.{decimals}f}"


_MOST_DECIMALS: Final = 3


def _decimals(value: float) -> int:
    """Decimals that show one digit of a value above 0."""
    return min(max(-math.floor(math.log10(value)), 0), _MOST_DECIMALS)


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


# --- plot ---------------------------------------------------------------------------------------------------


_COLOURS: Final = {"pepperscene": "#0072b2", PATH: "#b07800", PLAIN: "#d55e00"}
_OTHER_COLOUR: Final = "#00795a"
"""After Okabe and Ito (2008), for the colour-blind too; two of them darker, for lines on white."""

_MARKERS: Final = "osD^vP"
_DASHES: Final[tuple[Any, ...]] = ("-", "--", "-.", ":", (0, (5, 1)), (0, (1, 1)))
_STYLE: Final = {"svg.fonttype": "none", "svg.hashsalt": "pepperscene", "font.size": 10}
_LEGEND: Final = {PLAIN: "Mitsuba's path tracer, no denoiser"}
_ARROW_POINTS: Final = 22.0
"""Length of the arrow of an upper limit."""


@dataclass(frozen=True)
class Panel:
    """Results of one scene in the plot."""

    title: str  # above the panel
    description: str  # below the title
    results: Sequence[BenchResult]  # of all settings


def plot_pareto(panels: Sequence[Panel], title: str) -> dict[str, bytes]:
    """Plot error against time, one panel for each scene, as "png" and "svg".

    Args:
        panels: at least one.
        title: above all panels.
    """
    import matplotlib
    from matplotlib.figure import Figure

    columns = min(len(panels), 2)
    rows = math.ceil(len(panels) / columns)
    with matplotlib.rc_context(_STYLE):
        figure = Figure(figsize=(1.0 + 5.5 * columns, 1.3 + 4.2 * rows), layout="constrained")
        figure.suptitle(title, fontsize=13, fontweight="bold")
        axes = figure.subplots(rows, columns, squeeze=False).ravel()
        styles = _family_styles([result.family for panel in panels for result in panel.results])
        handles: dict[str, Any] = {}
        for axis, panel in zip(axes, panels, strict=False):
            handles |= _draw_panel(axis, panel, styles)
        for axis in axes[len(panels) :]:
            axis.set_visible(False)
        figure.legend(
            handles.values(), handles.keys(), loc="outside lower center", ncols=columns + 1, frameon=False
        )
        files = {}
        for file_format in ("png", "svg"):
            file = io.BytesIO()
            metadata = {"Date": None} if file_format == "svg" else None
            figure.savefig(file, format=file_format, dpi=150, metadata=metadata)
            files[file_format] = file.getvalue()
        return files


@dataclass(frozen=True)
class _Style:
    colour: str
    marker: str
    dashes: Any


def _family_styles(families: Iterable[str]) -> dict[str, _Style]:
    """Colour, marker and dashes by family, the same in all panels."""
    styles: dict[str, _Style] = {}
    for family in dict.fromkeys(families):
        colour = next((c for start, c in _COLOURS.items() if family.startswith(start)), _OTHER_COLOUR)
        number = sum(style.colour == colour for style in styles.values()) % len(_MARKERS)
        styles[family] = _Style(colour, _MARKERS[number], _DASHES[number])
    return styles


def _draw_panel(axes: Axes, panel: Panel, styles: Mapping[str, _Style]) -> dict[str, Any]:
    """Draw the results of a scene; returns the artists of the legend by label."""
    from matplotlib.lines import Line2D

    axes.set_title(f"{panel.title}\n", loc="left", fontsize=11, fontweight="bold")
    axes.annotate(
        panel.description, (0.0, 1.0), (0, 5), "axes fraction", "offset points", fontsize=8, color="0.35"
    )
    handles: dict[str, Any] = {}
    for family, style in styles.items():
        members = [result for result in panel.results if result.family == family]
        measured = sorted(
            (result for result in members if result.errors.codes.is_measurable),
            key=lambda result: result.median_s,
        )
        limits = [result for result in members if 0.0 < _upper_limit(result) < math.inf]
        if measured:
            handles[_LEGEND.get(family, family)] = _draw_measured(
                axes, measured, style, named=family.startswith(NAMED)
            )
        for result in limits:
            _draw_limit(axes, result, style)
        for result in (*measured, *limits):
            _annotate(axes, result, style)
    if any(0.0 < _upper_limit(result) < math.inf for result in panel.results):
        handles["upper limit: the error is not measurable"] = Line2D(
            [], [], color="0.35", marker="v", markersize=8, markerfacecolor="white", linestyle="none"
        )
    _set_scales(axes)
    if not handles:
        axes.text(0.5, 0.5, "no error is measurable", transform=axes.transAxes, ha="center", color="0.35")
    axes.set_xlabel("time of a frame, seconds (median; bars: minimum to maximum)")
    axes.set_ylabel("RMS error, 8-bit codes (bars: ± standard error)")
    return handles


def _upper_limit(result: BenchResult) -> float:
    """Upper limit of an error that is not measurable; 0 for others."""
    return 0.0 if result.errors.codes.is_measurable else result.errors.codes.root_limit


def _draw_measured(axes: Axes, results: Sequence[BenchResult], style: _Style, *, named: bool) -> Any:
    """Draw the points of a family in the order of time; named qualities are not connected."""
    seconds = [result.median_s for result in results]
    spread = [
        [result.median_s - min(result.seconds) for result in results],
        [max(result.seconds) - result.median_s for result in results],
    ]
    return axes.errorbar(
        seconds,
        [result.errors.codes.root or 0.0 for result in results],
        yerr=[result.errors.codes.root_uncertainty or 0.0 for result in results],
        xerr=spread,
        color=style.colour,
        marker=style.marker,
        linestyle="none" if named else style.dashes,
        linewidth=1.4,
        elinewidth=1.0,
        capsize=2.0,
        markersize=9 if named else 5,
        zorder=4 if named else 3,
    )


def _draw_limit(axes: Axes, result: BenchResult, style: _Style) -> None:
    """Draw a bar at the limit, with a hollow arrow below."""
    limit, seconds = result.errors.codes.root_limit, result.median_s
    axes.plot([seconds], [limit], color=style.colour, marker="_", markersize=10, linestyle="none", zorder=4)
    axes.annotate(
        "",
        (seconds, limit),
        (0, -_ARROW_POINTS),
        textcoords="offset points",
        arrowprops={
            "arrowstyle": "<|-",
            "edgecolor": style.colour,
            "facecolor": "white",
            "shrinkA": 0,
            "shrinkB": 0,
        },
    )


def _annotate(axes: Axes, result: BenchResult, style: _Style) -> None:
    """Write the name of a setting next to its point."""
    error = result.errors.codes.root or result.errors.codes.root_limit
    bold = result.family.startswith(NAMED)
    # Lines fall to the right; other targets are often near a named quality.
    below = result.family == ADAPTIVE
    axes.annotate(
        result.name,
        (result.median_s, error),
        (-5, -11) if below else (6, 6),
        textcoords="offset points",
        ha="right" if below else "left",
        fontsize=9 if bold else 7.5,
        fontweight="bold" if bold else "normal",
        color=style.colour,
        zorder=5,
    )


def _set_scales(axes: Axes) -> None:
    """Logarithmic axes with a labelled grid."""
    from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter

    axes.set(xscale="log", yscale="log")
    axes.margins(x=0.16, y=0.14)  # chosen: for the names of settings
    if not axes.has_data():
        axes.set(xlim=(0.1, 10.0), ylim=(0.1, 10.0))
    for axis in (axes.xaxis, axes.yaxis):
        low, high = axis.get_view_interval()
        # At least a decade, so that some ticks are inside.
        margin = max((10.0 * low / high) ** 0.5, 1.0)
        axis.set_view_interval(low / margin, high * margin, ignore=True)
        axis.set_major_locator(LogLocator(10.0, subs=(1.0, 2.0, 5.0), numticks=40))
        axis.set_major_formatter(StrMethodFormatter("{x:g}"))
        axis.set_minor_formatter(NullFormatter())
    axes.grid(which="major", color="0.93", linewidth=0.8)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)
