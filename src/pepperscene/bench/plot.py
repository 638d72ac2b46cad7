"""The plot of error against time, with one panel for each scene."""

from __future__ import annotations

import io
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

from pepperscene.bench.measure import BenchResult
from pepperscene.bench.settings import ADAPTIVE, NAMED, PATH, PLAIN

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_COLOURS: Final = {"pepperscene": "#0072b2", PATH: "#b07800", PLAIN: "#d55e00", "": "#00795a"}
"""By the start of a family's name; after Okabe and Ito (2008), for the colour-blind too; two are darker."""

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


@dataclass(frozen=True)
class _Style:
    colour: str
    marker: str
    dashes: Any


def plot_pareto(panels: Sequence[Panel], title: str) -> dict[str, bytes]:
    """Plot error against time, one panel for each scene, as "png" and "svg"."""
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
        for file_format, metadata in (("png", None), ("svg", {"Date": None})):
            file = io.BytesIO()
            figure.savefig(file, format=file_format, dpi=150, metadata=metadata)
            files[file_format] = file.getvalue()
        return files


def _family_styles(families: Iterable[str]) -> dict[str, _Style]:
    """Colour, marker and dashes by family, the same in all panels."""
    styles: dict[str, _Style] = {}
    for family in dict.fromkeys(families):
        colour = next(colour for start, colour in _COLOURS.items() if family.startswith(start))
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
    has_limits = False
    for family, style in styles.items():
        members = [result for result in panel.results if result.family == family]
        measured = [result for result in members if result.errors.codes.is_measurable]
        limits = [
            result
            for result in members
            if not result.errors.codes.is_measurable and 0.0 < result.errors.codes.root_limit < math.inf
        ]
        if measured:
            handles[_LEGEND.get(family, family)] = _draw_measured(axes, measured, style)
        for result in limits:
            _draw_limit(axes, result, style)
        for result in (*measured, *limits):
            _write_name(axes, result, style)
        has_limits = has_limits or bool(limits)
    if has_limits:
        handles["upper limit: the error is not measurable"] = Line2D(
            [], [], color="0.35", marker="v", markersize=8, markerfacecolor="white", linestyle="none"
        )
    if not handles:
        axes.text(0.5, 0.5, "no error is measurable", transform=axes.transAxes, ha="center", color="0.35")
    _set_scales(axes)
    axes.set_xlabel("time of a frame, seconds (median; bars: minimum to maximum)")
    axes.set_ylabel("RMS error, 8-bit codes (bars: ± standard error)")
    return handles


def _draw_measured(axes: Axes, results: Sequence[BenchResult], style: _Style) -> Any:
    """Draw the points of a family in the order of time; named qualities are not connected."""
    results = sorted(results, key=lambda result: result.median_s)
    named = results[0].family.startswith(NAMED)
    return axes.errorbar(
        [result.median_s for result in results],
        [result.errors.codes.root or 0.0 for result in results],
        yerr=[result.errors.codes.root_uncertainty or 0.0 for result in results],
        xerr=[
            [result.median_s - min(result.seconds) for result in results],
            [max(result.seconds) - result.median_s for result in results],
        ],
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
    arrow = {"arrowstyle": "<|-", "edgecolor": style.colour, "facecolor": "white", "shrinkA": 0, "shrinkB": 0}
    axes.annotate("", (seconds, limit), (0, -_ARROW_POINTS), textcoords="offset points", arrowprops=arrow)


def _write_name(axes: Axes, result: BenchResult, style: _Style) -> None:
    """Write the name of a setting next to its point."""
    bold = result.family.startswith(NAMED)
    # Lines fall to the right; other targets are often near a named quality.
    below = result.family == ADAPTIVE
    axes.annotate(
        result.name,
        (result.median_s, result.errors.codes.root or result.errors.codes.root_limit),
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
