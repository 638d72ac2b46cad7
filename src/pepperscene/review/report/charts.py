"""Charts by matplotlib as SVG elements, in CSS variables as colours, so that they follow the page's theme."""

from __future__ import annotations

import io
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from markupsafe import Markup
from numpy.typing import NDArray

# Layout in units of the SVG. Chosen: on a phone, a unit is about a pixel.
_WIDTH, _LEFT, _RIGHT, _BOTTOM = 300, 38, 284, 46
_LINE_CHART: Final = (196, 26)  # height and upper margin
_DOT_CHART: Final = (92, 0)

_BINS: Final = 24
_MIN_VALUES: Final = 40
"""Chosen: fewer values than this are drawn as dots, since most bins of a histogram would be empty."""

_COLOURS: Final = {"a": "#a0000a", "b": "#a0000b", "faint": "#a0000c", "line": "#a0000d"}
"""Colours for matplotlib by the name of the CSS variable that replaces them in the SVG."""

_STYLE: Final = {
    **dict.fromkeys(("axes.edgecolor", "axes.labelcolor", "text.color"), _COLOURS["faint"]),
    **dict.fromkeys(("xtick.color", "ytick.color"), _COLOURS["faint"]),
    **dict.fromkeys(("xtick.major.size", "ytick.major.size"), 0.0),
    **dict.fromkeys(("axes.spines.left", "axes.spines.right", "axes.spines.top"), False),
    "axes.axisbelow": True,
    "font.size": 12.0,
    "grid.color": _COLOURS["line"],
    "svg.fonttype": "none",
    "xtick.major.pad": 6.0,
}

_SVG: Final = Markup(
    '<svg class="chart" viewBox="0 0 {width} {height}" role="img" aria-labelledby="{id}-t {id}-d">'
    '<title id="{id}-t">{title}</title><desc id="{id}-d">{description}</desc>{content}</svg>'
)
"""Texts are escaped when they are put in."""

Axis = tuple[str, Sequence[float]]
"""Label and ticks; the axis ends at the first and the last tick."""


@dataclass(frozen=True, eq=False)
class Curve:
    """One line of a chart."""

    key: str  # "a" or "b", which selects the colour
    name: str  # for the description of the chart
    x: NDArray[np.floating]  # (n,), ascending
    y: NDArray[np.floating]  # (n,), at least 0


def line_chart(
    chart_id: str,
    title: str,
    curves: Sequence[Curve],
    x_axis: Axis,
    y_label: str,
    hue_strip: bool = False,
) -> Markup:
    """Draw lines from zero upwards over a common axis; the first one is filled.

    Args:
        chart_id: unique in the page.
        title: for screen readers.
        curves: at least one.
        x_axis: horizontal axis.
        y_label: of the vertical axis.
        hue_strip: whether to draw the hues below an axis in degrees.
    """
    peaks = [(curve, int(np.argmax(curve.y))) for curve in curves]
    description = "; ".join(
        f"{curve.name}: maximum {curve.y[at]:.3g} at {curve.x[at]:.3g} ({x_axis[0]})" for curve, at in peaks
    )

    def draw(axes: Any) -> None:
        _set_ticks(axes, "y", _round_ticks(0.0, max(float(curve.y[at]) for curve, at in peaks) or 1.0))
        axes.grid(axis="y")
        axes.figure.text(0, 1 - 12 / _LINE_CHART[0], y_label)
        first = curves[0]
        outline = np.pad(first.x, 1, mode="edge"), np.pad(first.y, 1)
        axes.fill(*outline, color=_COLOURS[first.key], alpha=0.16, linewidth=0)
        for curve in curves:
            dashes = (0, (2.8, 1.7)) if curve.key == "b" else "solid"
            axes.plot(curve.x, curve.y, color=_COLOURS[curve.key], linestyle=dashes, linewidth=1.8)
        if hue_strip:
            _add_hue_strip(axes)

    return _draw_svg(chart_id, title, description, _LINE_CHART, x_axis, draw)


def value_chart(
    chart_id: str, title: str, values: Sequence[tuple[str, str, NDArray[np.floating]]], unit: str
) -> Markup:
    """Draw the distribution of values: a histogram, or a dot for each value if there are few.

    The values are given as key, name and `(n,)` values of each set.
    """
    together = np.concatenate([numbers for _, _, numbers in values])
    ticks = _round_ticks(*_padded_range(float(together.min()), float(together.max())))
    if len(together) >= _MIN_VALUES:
        edges = np.linspace(ticks[0], ticks[-1], _BINS + 1)
        series = [
            (key, name, 100.0 * np.histogram(numbers, edges)[0] / len(numbers))
            for key, name, numbers in values
        ]
        return step_chart(chart_id, title, edges, series, unit, "% of frames")
    description = "; ".join(
        f"{name}: {len(numbers)} values, median {np.median(numbers):.3g}" for _, name, numbers in values
    )

    def draw(axes: Any) -> None:
        axes.set(yticks=[], ylim=(0, _DOT_CHART[0] - _BOTTOM))
        for row, (key, _, numbers) in enumerate(values):
            y = np.full(len(numbers), 12 + 20 * row)
            style = {"color": _COLOURS[key], "alpha": 0.65, "markersize": 10, "markeredgewidth": 0}
            axes.plot(np.sort(numbers), y, "o", clip_on=False, **style)

    return _draw_svg(chart_id, title, description, _DOT_CHART, (unit, ticks), draw)


def step_chart(
    chart_id: str,
    title: str,
    edges: NDArray[np.floating],
    series: Sequence[tuple[str, str, NDArray[np.floating]]],
    unit: str,
    y_label: str,
) -> Markup:
    """Draw histograms over common bins.

    Args:
        chart_id: unique in the page.
        title: for screen readers.
        edges: `(n + 1,)` of the bins, ascending.
        series: key, name, and `(n,)` heights.
        unit: label of the horizontal axis.
        y_label: of the vertical axis.
    """
    ticks = _round_ticks(float(edges[0]), float(edges[-1]))
    curves = [
        Curve(key, name, np.repeat(edges, 2), np.pad(np.repeat(heights, 2), 1))
        for key, name, heights in series
    ]
    return line_chart(chart_id, title, curves, (unit, ticks), y_label)


def _draw_svg(
    chart_id: str,
    title: str,
    description: str,
    layout: tuple[int, int],
    x_axis: Axis,
    draw: Callable[[Any], None],
) -> Markup:
    """An SVG element of axes whose content is drawn by `draw`."""
    from matplotlib import rc_context
    from matplotlib.figure import Figure

    height, top = layout
    buffer = io.StringIO()
    # The salt makes ids the same in every run, and different in every chart.
    with rc_context({**_STYLE, "svg.hashsalt": chart_id}):
        figure = Figure(figsize=(_WIDTH / 72, height / 72))
        bounds = np.array([_LEFT, _BOTTOM, _RIGHT - _LEFT, height - top - _BOTTOM])
        axes = figure.add_axes(tuple(bounds / [_WIDTH, height, _WIDTH, height]))
        axes.set_xlabel(x_axis[0])
        _set_ticks(axes, "x", x_axis[1])
        draw(axes)
        metadata = dict.fromkeys(("Creator", "Date", "Format", "Type"))
        figure.savefig(buffer, format="svg", transparent=True, metadata=metadata)
    content = buffer.getvalue().partition("<svg")[2].partition(">")[2]
    # Its style sheet would apply to the whole page, and names of groups are the same in every chart.
    content = re.sub(r"<style.*?</style>|<!--.*?-->", "", content, flags=re.DOTALL)
    content = re.sub(r' id="(?![mp][0-9a-f]{10}")[^"]*"', "", content)
    content = re.sub(r"font-size: [^;]*; font-family: [^;\"]*;? ?", "", content)
    for name, colour in _COLOURS.items():
        content = content.replace(colour, f"var(--{name})")
    content = re.sub(r' style="([^"]*)"', _style_as_attributes, content.removesuffix("</svg>\n"))
    return _SVG.format(
        id=chart_id,
        title=title,
        description=description,
        width=_WIDTH,
        height=height,
        # Matplotlib has drawn numbers and constants only.
        content=Markup(" ".join(content.split())),
    )


def _style_as_attributes(style: re.Match[str]) -> str:
    """A style as SVG's presentation attributes, because the page's security policy forbids style attributes.

    Of several values of a property, the last one counts, as in CSS.
    """
    pairs = (rule.partition(":")[::2] for rule in style[1].split(";") if rule.strip())
    attributes = {name.strip(): value.strip() for name, value in pairs}
    return "".join(f' {name}="{value}"' for name, value in attributes.items())


def _set_ticks(axes: Any, axis: str, ticks: Sequence[float]) -> None:
    """Set the ticks of the axis "x" or "y", and its limits to the first and the last."""
    labels = [f"{round(float(tick), 12):g}" for tick in ticks]
    axes.set(**{f"{axis}ticks": ticks, f"{axis}ticklabels": labels, f"{axis}lim": (ticks[0], ticks[-1])})


def _round_ticks(low: float, high: float) -> list[float]:
    """Three to six round numbers, the first at most `low` and the last at least `high`."""
    from matplotlib.ticker import MaxNLocator

    return [float(tick) for tick in MaxNLocator(4, steps=[1, 2, 2.5, 5, 10]).tick_values(low, high)]


def _padded_range(low: float, high: float) -> tuple[float, float]:
    """A range that is not empty, and not below zero unless the values are."""
    margin = max(0.02 * (high - low), 1e-3 * abs(high), 1e-6)
    return (low - margin if low < 0 else max(0.0, low - margin)), high + margin


def _add_hue_strip(axes: Any) -> None:
    """Draw the hues below the horizontal axis, and move its labels down."""
    from matplotlib.colors import hsv_to_rgb

    strip = axes.inset_axes((0.0, -8 / 124, 1.0, 5 / 124))
    strip.imshow(hsv_to_rgb([[(hue, 0.92, 0.925) for hue in np.linspace(0.0, 1.0, 73)]]), aspect="auto")
    strip.set_axis_off()
    axes.tick_params(axis="x", pad=13)
