"""Charts as SVG inside the page: no library, no network, and colours that follow the page's light or dark."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from itertools import pairwise
from typing import Final

import numpy as np
from numpy.typing import NDArray

# Layout in the drawing's own units; chosen so that a chart that is as narrow as a telephone has about one
# pixel a unit, and its text is as large as the page's small print.
_WIDTH: Final = 300
_HEIGHT: Final = 196
_LEFT: Final = 38
_RIGHT: Final = 284
_TOP: Final = 26
_FLOOR: Final = 150
_DOTS: Final = 104
"""Where drawings begin that have no vertical axis."""
_STRIP: Final = 5
_BINS: Final = 24
_FEW: Final = 40
"""Chosen: of fewer values than this every single one is drawn, a histogram of them would be mostly gaps."""


@dataclass(frozen=True, eq=False)
class Curve:
    """One line of a chart.

    Attributes:
        key: "a" or "b", which tells its colour.
        name: what it is called.
        x: `(n,)`, ascending.
        y: `(n,)`, at least 0.
    """

    key: str
    name: str
    x: NDArray[np.floating]
    y: NDArray[np.floating]


@dataclass(frozen=True)
class Axis:
    """What an axis is called, from where to where it goes, and where it is marked."""

    title: str
    least: float
    greatest: float
    marks: Sequence[float]

    def share(self, values: NDArray[np.floating]) -> NDArray[np.floating]:
        """Places of values along the axis in [0, 1]."""
        return (np.asarray(values) - self.least) / (self.greatest - self.least)


def line_chart(
    identity: str, title: str, curves: Sequence[Curve], across: Axis, up: str, hues: bool = False
) -> str:
    """Lines over a common axis, from zero upwards.

    Args:
        identity: of the drawing, unique in the page.
        title: what is shown, for those who cannot see it.
        curves: the first is drawn filled.
        across: the horizontal axis.
        up: what the vertical axis tells.
        hues: whether a strip of the hues lies below, for an axis in degrees.
    """
    top = max((float(curve.y.max()) for curve in curves), default=0.0) or 1.0
    upright = _marked(up, 0.0, top)
    drawn = []
    for curve in curves:
        x, y = _across(across.share(curve.x)), _upwards(upright.share(curve.y))
        points = " ".join(f"{px:.1f},{py:.1f}" for px, py in zip(x, y, strict=True))
        if curve is curves[0]:
            drawn.append(
                f'<polygon class="{curve.key}" points="{x[0]:.1f},{_FLOOR} {points} {x[-1]:.1f},{_FLOOR}"/>'
            )
        drawn.append(f'<polyline class="{curve.key}" points="{points}"/>')
    told = "; ".join(_peak(curve, across) for curve in curves)
    return _drawing(identity, title, told, across, upright, "".join(drawn), hues)


def value_chart(
    identity: str, title: str, values: Sequence[tuple[str, str, NDArray[np.floating]]], unit: str
) -> str:
    """How values are distributed: a histogram, or the values one by one where they are few.

    Args:
        identity: of the drawing, unique in the page.
        title: what is shown.
        values: key, name and `(n,)` values of each set.
        unit: of the values.
    """
    every = np.concatenate([some for _, _, some in values])
    across = _marked(unit, *_room(float(every.min()), float(every.max())))
    if len(every) < _FEW:
        return _single_values(identity, title, values, across)
    edges = np.linspace(across.least, across.greatest, _BINS + 1)
    curves = []
    for key, name, some in values:
        share = 100.0 * np.histogram(some, edges)[0] / len(some)
        curves.append(
            Curve(key, name, np.repeat(edges, 2), np.concatenate([[0.0], np.repeat(share, 2), [0.0]]))
        )
    return line_chart(identity, title, curves, across, "% of frames")


def _single_values(
    identity: str, title: str, values: Sequence[tuple[str, str, NDArray[np.floating]]], across: Axis
) -> str:
    dots = []
    for row, (key, _, some) in enumerate(values):
        height = _FLOOR - 12 - 20 * row
        x = _across(across.share(np.sort(some)))
        dots += [f'<circle class="{key}" cx="{place:.1f}" cy="{height}" r="5"/>' for place in x]
    told = "; ".join(f"{name}: {len(some)} values, median {np.median(some):.3g}" for _, name, some in values)
    return _drawing(identity, title, told, across, None, "".join(dots), hues=False)


def _drawing(
    identity: str, title: str, told: str, across: Axis, upright: Axis | None, content: str, hues: bool
) -> str:
    above = _DOTS if upright is None else 0
    parts = [
        f'<svg class="chart" viewBox="0 {above} {_WIDTH} {_HEIGHT - above}" role="img" '
        f'aria-labelledby="{identity}-t {identity}-d">'
        f'<title id="{identity}-t">{escape(title)}</title><desc id="{identity}-d">{escape(told)}</desc>'
    ]
    if upright is not None:
        parts.append(f'<text x="0" y="{_TOP - 14}">{escape(upright.title)}</text>')
        for mark, y in zip(upright.marks, _upwards(upright.share(np.array(upright.marks))), strict=True):
            parts.append(f'<line class="grid" x1="{_LEFT}" x2="{_RIGHT}" y1="{y:.1f}" y2="{y:.1f}"/>')
            parts.append(f'<text class="end" x="{_LEFT - 5}" y="{y + 4:.1f}">{mark:g}</text>')
    parts.append(f'{content}<line class="floor" x1="{_LEFT}" x2="{_RIGHT}" y1="{_FLOOR}" y2="{_FLOOR}"/>')
    if hues:
        parts.append(_hue_strip(across))
    low = _FLOOR + (_STRIP + 4 if hues else 0)
    for mark, x in zip(across.marks, _across(across.share(np.array(across.marks))), strict=True):
        parts.append(f'<text class="mid" x="{x:.1f}" y="{low + 15}">{mark:g}</text>')
    parts.append(
        f'<text class="mid" x="{(_LEFT + _RIGHT) / 2:g}" y="{low + 32}">{escape(across.title)}</text>'
    )
    return "".join([*parts, "</svg>"])


def _hue_strip(across: Axis) -> str:
    """Full colours along an axis of hues, in steps of ten degrees."""
    edges = _across(across.share(np.arange(0.0, 361.0, 10.0)))
    return "".join(
        f'<rect x="{left:.2f}" y="{_FLOOR + 3}" width="{right - left + 0.3:.2f}" height="{_STRIP}" '
        f'fill="hsl({10 * step + 5} 85% 50%)"/>'
        for step, (left, right) in enumerate(pairwise(edges))
    )


def _peak(curve: Curve, across: Axis) -> str:
    place = int(np.argmax(curve.y))
    return f"{curve.name}: greatest {curve.y[place]:.3g} at {curve.x[place]:.3g} ({across.title})"


def _marked(title: str, least: float, greatest: float) -> Axis:
    """An axis with three to six marks at round numbers, so long that the greatest value fits."""
    rough = (greatest - least) / 4.0
    decade = 10.0 ** np.floor(np.log10(rough))
    step = float(decade * next(factor for factor in (1.0, 2.0, 2.5, 5.0, 10.0) if factor * decade >= rough))
    first, last = np.floor(least / step), np.ceil(greatest / step)
    marks = [round(float(number * step), 12) for number in np.arange(first, last + 0.5)]
    return Axis(title, marks[0], marks[-1], marks)


def _room(least: float, greatest: float) -> tuple[float, float]:
    """A range that is not empty."""
    away = max(0.02 * (greatest - least), 1e-3 * abs(greatest), 1e-6)
    return (least - away if least < 0 else max(0.0, least - away)), greatest + away


def _across(share: NDArray[np.floating]) -> NDArray[np.floating]:
    return _LEFT + share * (_RIGHT - _LEFT)


def _upwards(share: NDArray[np.floating]) -> NDArray[np.floating]:
    return _FLOOR - share * (_FLOOR - _TOP)
