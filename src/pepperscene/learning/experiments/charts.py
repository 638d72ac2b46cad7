"""Charts of the page as SVG: bars with intervals, and curves of trainings."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Final

from pepperscene.review.report.markup import Html, element, joined

COLOURS: Final = MappingProxyType(
    {"A": "#8c8c8c", "B": "#e69f00", "C": "#56b4e9", "D": "#cc79a7", "E": "#009e73"}
)
"""Of experiments; apart from grey, those of Okabe and Ito, which colour-blind people can distinguish."""

_TEXT: Final = "#1a1a1a"
_GRID: Final = "#d9d9d9"

# Layout in units of the SVG, about pixels at 1200 px.
_BAR_WIDTH, _BAR_HEIGHT = 1120, 340
_CURVE_WIDTH, _CURVE_HEIGHT = 540, 260
_LEFT, _RIGHT, _TOP, _BOTTOM = 52, 10, 24, 40


@dataclass(frozen=True)
class Bar:
    """A bar with its interval, values from 0 to 1; None for one that is unknown."""

    key: str
    value: float | None
    low: float | None
    high: float | None


@dataclass(frozen=True)
class TrainingCurve:
    """A line through points, and its name."""

    name: str
    x: tuple[float, ...]
    y: tuple[float, ...]


def bar_chart(chart_id: str, title: str, groups: Sequence[tuple[str, Sequence[Bar]]]) -> Html:
    """Bars of IoU in percent by group, with intervals as lines and the value above each."""
    inner = _BAR_WIDTH - _LEFT - _RIGHT
    parts = [_horizontal_grid(_BAR_WIDTH, _BAR_HEIGHT, [0, 0.2, 0.4, 0.6, 0.8, 1], "%", 100)]
    step = inner / max(1, len(groups))
    for number, (name, bars) in enumerate(groups):
        left = _LEFT + number * step
        width = 0.8 * step / max(1, len(bars))
        for place, bar in enumerate(bars):
            parts.append(_bar(bar, left + 0.1 * step + place * width, width))
        parts.append(_text(name, left + step / 2, _BAR_HEIGHT - 14, 15))
    return _svg(chart_id, title, (_BAR_WIDTH, _BAR_HEIGHT), parts)


def curve_chart(
    chart_id: str, title: str, curves: Sequence[TrainingCurve], y_label: str, colour: str
) -> Html:
    """Lines over steps, from 0 upwards; each is named where it ends."""
    ends = [max(curve.x) for curve in curves]
    top = _round_up(max(max(curve.y) for curve in curves))
    size = (_CURVE_WIDTH, _CURVE_HEIGHT)
    ticks = [top * part / 4 for part in range(5)]
    parts = [_horizontal_grid(*size, ticks, "", 1), _text(y_label, _LEFT, 14, 13, "start")]
    for part in (0, 0.5, 1):
        x = _LEFT + part * (_CURVE_WIDTH - _LEFT - _RIGHT - 60)
        parts.append(_text(f"{part * max(ends):,.0f}", x, _CURVE_HEIGHT - 22, 12))
    parts.append(_text("step", _CURVE_WIDTH - 30, _CURVE_HEIGHT - 22, 12))
    labels = _apart([_y(curve.y[-1], _CURVE_HEIGHT, top) for curve in curves])
    for number, (curve, label_y) in enumerate(zip(curves, labels, strict=True)):
        parts.append(_line(curve, max(ends), top, colour, number, label_y))
    return _svg(chart_id, title, size, parts)


def _bar(bar: Bar, left: float, width: float) -> Html:
    if bar.value is None:
        return _text("-", left + width / 2, _BAR_HEIGHT - _BOTTOM - 4, 11)
    top = _y(bar.value, _BAR_HEIGHT, 1)
    rectangle = element(
        "rect",
        x=f"{left + 1:.1f}",
        y=f"{top:.1f}",
        width=f"{max(1, width - 2):.1f}",
        height=f"{_BAR_HEIGHT - _BOTTOM - top:.1f}",
        fill=COLOURS[bar.key],
    )
    parts, middle = [rectangle], left + width / 2
    high = bar.value
    if bar.low is not None and bar.high is not None:
        high = bar.high
        ends = [f"{_y(value, _BAR_HEIGHT, 1):.1f}" for value in (bar.low, bar.high)]
        x = f"{middle:.1f}"
        parts.append(element("line", x1=x, x2=x, y1=ends[0], y2=ends[1], stroke=_TEXT, stroke_width=1.5))
    label = f"{100 * bar.value:.0f}"
    return joined([*parts, _text(label, middle, _y(high, _BAR_HEIGHT, 1) - 4, 11)])


def _line(curve: TrainingCurve, end: float, top: float, colour: str, number: int, label_y: float) -> Html:
    inner = _CURVE_WIDTH - _LEFT - _RIGHT - 60
    points = [
        (_LEFT + x / end * inner, _y(y, _CURVE_HEIGHT, top)) for x, y in zip(curve.x, curve.y, strict=True)
    ]
    path = " ".join(f"{x:.1f},{y:.1f}" for x, y in points)
    dashes = (None, "6 3", "2 3", "8 3 2 3")[number % 4]
    line = element(
        "polyline", points=path, fill="none", stroke=colour, stroke_width=2, stroke_dasharray=dashes
    )
    label = _text(curve.name, points[-1][0] + 4, label_y + 4, 11, "start")
    dot = element("circle", cx=f"{points[0][0]:.1f}", cy=f"{points[0][1]:.1f}", r=2, fill=colour)
    return joined([line, dot, label])


def _apart(places: Sequence[float]) -> list[float]:
    """Heights near these places at which names do not overlap."""
    order = sorted(range(len(places)), key=lambda at: places[at])
    moved = list(places)
    for below, above in itertools.pairwise(order):
        moved[above] = max(moved[above], moved[below] + 11)
    # Names that would leave the chart move up together.
    excess = max(0.0, max(moved) - (_CURVE_HEIGHT - _BOTTOM))
    return [place - excess for place in moved]


def _horizontal_grid(width: int, height: int, ticks: Sequence[float], unit: str, factor: float) -> Html:
    parts = []
    for tick in ticks:
        y = f"{_y(tick, height, ticks[-1]):.1f}"
        parts.append(element("line", x1=_LEFT, x2=width - _RIGHT, y1=y, y2=y, stroke=_GRID))
        parts.append(_text(f"{factor * tick:.3g}{unit}", _LEFT - 6, float(y) + 4, 12, "end"))
    return joined(parts)


def _y(value: float, height: int, top: float) -> float:
    """Vertical place of a value on an axis from 0 to `top`."""
    return height - _BOTTOM - value / top * (height - _BOTTOM - _TOP)


def _round_up(value: float) -> float:
    """The next of 1, 2, 4 or 8 times a power of ten."""
    if not value > 0:
        return 1.0
    power = 10.0 ** math.floor(math.log10(value))
    return next(factor * power for factor in (1, 2, 4, 8, 10) if value <= factor * power * (1 + 1e-9))


def _text(text: str, x: float, y: float, size: int, anchor: str = "middle") -> Html:
    return element("text", text, x=f"{x:.1f}", y=f"{y:.1f}", fill=_TEXT, font_size=size, text_anchor=anchor)


def _svg(chart_id: str, title: str, size: tuple[int, int], parts: Sequence[Html]) -> Html:
    return element(
        "svg",
        element("title", title, id=f"{chart_id}-title"),
        *parts,
        class_="chart",
        viewBox=f"0 0 {size[0]} {size[1]}",
        role="img",
        aria_labelledby=f"{chart_id}-title",
    )
