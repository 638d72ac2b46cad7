"""Run time against error as a picture: both axes in logarithms, a line for each way, its name beside it."""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

from pepperscene.bench.measure import BenchResult
from pepperscene.bench.peers import CYCLES
from pepperscene.bench.settings import NAMED, OUR_FAMILIES, PATH, PLAIN
from pepperscene.bench.tables import Point, front

_LINE_OF_NOTE: Final = 1.0
"""Codes: what the eye does not see, and what the standard quality is to reach."""


@dataclass(frozen=True)
class _Style:
    colour: str
    marker: str
    dashes: Any


_OURS, _PLAIN, _PATHS, _PEER = "#0072b2", "#d55e00", "#b07800", "#00795a"
"""After Okabe and Ito (2008), told apart by the colour-blind too; two of them darker, for lines on white."""

_MARKERS: Final = "osD^vP"
_DASHES: Final[tuple[Any, ...]] = ("-", "--", "-.", ":", (0, (5, 1)), (0, (1, 1)))


def pareto(
    measured: Sequence[BenchResult], title: str, subtitle: str, floor: float | None = None
) -> dict[str, bytes]:
    """The plot of one scene as `png` and `svg`.

    Args:
        measured: its settings.
        title: above the plot.
        subtitle: below it.
        floor: error of the reference in codes; a line shows it.
    """
    import matplotlib

    matplotlib.use("agg")
    from matplotlib import pyplot

    # Text stays text in the SVG, and its bytes depend on what it shows alone.
    with matplotlib.rc_context({"svg.fonttype": "none", "svg.hashsalt": "pepperscene", "font.size": 10}):
        figure, axes = pyplot.subplots(figsize=(10, 6.2))
        try:
            figure.subplots_adjust(left=0.08, right=0.73, top=0.88, bottom=0.1)
            _draw(axes, measured, floor)
            figure.text(0.08, 0.95, title, fontsize=13, fontweight="bold", va="center")
            figure.text(0.08, 0.91, subtitle, fontsize=9, color="0.35", va="center")
            files = {}
            for kind in ("png", "svg"):
                file = io.BytesIO()
                figure.savefig(file, format=kind, dpi=150, metadata={"Date": None} if kind == "svg" else None)
                files[kind] = file.getvalue()
            return files
        finally:
            pyplot.close(figure)


def _draw(axes: Any, measured: Sequence[BenchResult], floor: float | None) -> None:
    from matplotlib.ticker import LogLocator, StrMethodFormatter

    axes.set_xscale("log")
    axes.set_yscale("log")
    shown = [one for one in measured if one.errors.rmse_codes > 0.0]
    families = list(dict.fromkeys(one.family for one in shown))
    ends: list[tuple[str, Point, _Style]] = []
    for family, style in zip(families, _styles(families), strict=True):
        points = sorted((one.median_s, one.errors.rmse_codes) for one in shown if one.family == family)
        # Named qualities are single points: no line leads from one to the next.
        dashes = "none" if family.startswith(NAMED) else style.dashes
        axes.plot(
            *zip(*points, strict=True),
            color=style.colour,
            marker=style.marker,
            linestyle=dashes,
            linewidth=1.6,
            markersize=10 if family.startswith(NAMED) else 5,
            markerfacecolor="white" if family.startswith(NAMED) else style.colour,
            zorder=4 if family in OUR_FAMILIES else 3,
        )
        if not family.startswith(NAMED):
            ends.append((family, points[-1], style))
    for one in shown:
        if one.family.startswith(NAMED):
            axes.annotate(
                one.name,
                (one.median_s, one.errors.rmse_codes),
                xytext=(9, 7),
                textcoords="offset points",
                fontweight="bold",
                zorder=5,
            )
    best = front((one.median_s, one.errors.rmse_codes) for one in shown)
    if len(best) > 1:
        axes.plot(*zip(*best, strict=True), color="0.85", linewidth=7, zorder=1, solid_capstyle="round")
    axes.margins(x=0.08, y=0.1)
    axes.set_xlim(_wide(*axes.get_xlim()))
    axes.set_ylim(_wide(*axes.get_ylim()))
    low, high = axes.get_ylim()
    for error, name in ((_LINE_OF_NOTE, "1 code"), (floor, "reference's own error")):
        if error and low < error < high:
            axes.axhline(error, color="0.6", linewidth=0.8, zorder=0)
            axes.annotate(name, (0.005, error), xycoords=("axes fraction", "data"), xytext=(0, 3),
                          textcoords="offset points", fontsize=8, color="0.4")  # fmt: skip
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_locator(LogLocator(10.0, subs=(1.0, 2.0, 5.0), numticks=40))
        axis.set_major_formatter(StrMethodFormatter("{x:g}"))
        axis.set_minor_formatter("")
    axes.grid(which="major", color="0.93", linewidth=0.8)
    axes.spines[["top", "right"]].set_visible(False)
    axes.set_xlabel("seconds a frame, in sequence (median)")
    axes.set_ylabel("RMSE of the noise-free picture, codes of 8 bits")
    _name_lines(axes, ends)


def _wide(low: float, high: float) -> tuple[float, float]:
    """Limits of an axis that hold a decade at least, so that some of its marks fall between them."""
    more = max((10.0 * low / high) ** 0.5, 1.0)
    return low / more, high * more


def _name_lines(axes: Any, ends: list[tuple[str, Point, _Style]]) -> None:
    """Names in a column beside the plot with a piece of their line, led to from where it ends."""
    axes.set_xlim(axes.get_xlim())
    axes.set_ylim(axes.get_ylim())
    to_share = axes.transData + axes.transAxes.inverted()
    wanted = sorted(((float(to_share.transform(point)[1]), family, point, style)
                     for family, point, style in ends), key=lambda one: one[:2])  # fmt: skip
    for place, (_, family, point, style) in zip(_apart([one[0] for one in wanted]), wanted, strict=True):
        axes.annotate(
            "",
            point,
            xytext=(1.015, place),
            textcoords="axes fraction",
            annotation_clip=False,
            arrowprops={
                "arrowstyle": "-",
                "color": style.colour,
                "linewidth": 0.6,
                "alpha": 0.35,
                "shrinkA": 0,
                "shrinkB": 5,
            },
        )
        axes.plot(
            (1.02, 1.04, 1.06),
            (place,) * 3,
            transform=axes.transAxes,
            clip_on=False,
            color=style.colour,
            marker=style.marker,
            markevery=[1],
            linestyle=style.dashes,
            linewidth=1.6,
            markersize=5,
        )
        axes.text(1.07, place, family, transform=axes.transAxes, color=style.colour, va="center")


def _apart(wanted: Sequence[float], step: float = 0.05) -> list[float]:
    """Ascending places at least a step apart, each run of them about the middle of where it was wanted."""
    runs: list[list[float]] = []
    for place in wanted:
        runs.append([place])
        while len(runs) > 1 and _start(runs[-1], step) - _start(runs[-2], step) < step * len(runs[-2]):
            runs[-2:] = [[*runs[-2], *runs[-1]]]
    return [_start(run, step) + step * number for run in runs for number in range(len(run))]


def _start(run: Sequence[float], step: float) -> float:
    """Where a run begins, kept within the height of the plot."""
    length = step * (len(run) - 1)
    middle = sum(run) / len(run) - length / 2
    return min(max(middle, 0.0), max(1.0 - length, 0.0))


def _styles(families: Sequence[str]) -> list[_Style]:
    """A colour for each program, a marker and a kind of line for each of its families."""
    seen: dict[str, int] = {}
    styles = []
    for family in families:
        colour = _colour(family)
        number = seen.get(colour, 0)
        seen[colour] = number + 1
        styles.append(_Style(colour, _MARKERS[number % 6], _DASHES[number % 6]))
    return styles


def _colour(family: str) -> str:
    if family.startswith(CYCLES):
        return _PEER
    if family == PLAIN:
        return _PLAIN
    return _PATHS if family.startswith(PATH) else _OURS
