"""Figs. 10 to 13 of Barth et al. 2018 with both sets in one picture, as an SVG that stands alone.

The charts are those of the report of a data set; what is drawn here around them is a page of paper, with
colours told outright, so that every viewer and every paper shows the same.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from html import escape
from itertools import pairwise
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.classes import OrganClass
from pepperscene.colour.comparison import similarity
from pepperscene.colour.comparison.tables import cell
from pepperscene.colour.statistics.bootstrap import Estimate
from pepperscene.colour.statistics.circular import bin_angles
from pepperscene.dataset.report.colours import VIRIDIS, drawing, share_colours
from pepperscene.truth import HUE_BINS, centre_falloff

if TYPE_CHECKING:
    from pepperscene.colour.comparison.result import Comparison, KindComparison


# Charts as SVG, formerly of the report.
_CHART_WIDTH: Final = 300
_CHART_HEIGHT: Final = 196
_LEFT: Final = 38
_RIGHT: Final = 284
_TOP: Final = 26
_FLOOR: Final = 150
_STRIP: Final = 5


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


def _drawing(
    identity: str, title: str, told: str, across: Axis, upright: Axis | None, content: str, hues: bool
) -> str:
    parts = [
        f'<svg class="chart" viewBox="0 0 {_CHART_WIDTH} {_CHART_HEIGHT}" role="img" '
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


def _across(share: NDArray[np.floating]) -> NDArray[np.floating]:
    return _LEFT + share * (_RIGHT - _LEFT)


def _upwards(share: NDArray[np.floating]) -> NDArray[np.floating]:
    return _FLOOR - share * (_FLOOR - _TOP)


# Layout in the drawing's own units, chosen: four charts of the report's own width stand in a row.
_COLUMNS: Final = 4
_CHART: Final = (300, 190)
_GAP: Final = 28
_MARGIN: Final = 36
_WIDTH: Final = 2 * _MARGIN + _COLUMNS * _CHART[0] + (_COLUMNS - 1) * _GAP
_BAR: Final = 12
_MAP: Final = 146
_RINGS: Final = 40  # chosen: each 12 pixels wide in a picture of 800 x 600
_MAP_PX: Final = 400
_HUE_AXIS: Final = Axis("hue, degrees", 0.0, 360.0, (0, 60, 120, 180, 240, 300, 360))
_FALLOFF_AXIS: Final = Axis("from the middle (0) to the corners (1)", 0.0, 1.0, (0, 0.25, 0.5, 0.75, 1))

_STYLE: Final = """
svg { font-family: "DejaVu Sans", Verdana, Arial, sans-serif; }
text { font-size: 12px; fill: #46503f; }
.head { font-size: 22px; font-weight: bold; fill: #1b211a; }
.part { font-size: 16px; font-weight: bold; fill: #1b211a; }
.name { font-size: 13px; font-weight: bold; fill: #1b211a; }
.end { text-anchor: end; } .mid { text-anchor: middle; }
.grid { stroke: #dde1d6; } .floor { stroke: #5c6657; } .range { stroke: #1b211a; stroke-width: 1.2; }
.none { fill: #f1f3ee; stroke: #cdd3c5; stroke-dasharray: 4 3; }
polyline { fill: none; stroke-width: 1.8; stroke-linejoin: round; }
polyline.a { stroke: #00796b; } polyline.b { stroke: #d1500f; stroke-dasharray: 5 3; }
polygon.a { fill: #00796b; opacity: .16; } polygon.b { fill: #d1500f; opacity: .16; }
rect.a { fill: #00796b; } rect.b { fill: #d1500f; }
"""


def figure(found: Comparison) -> str:
    """The comparison as one SVG, with as much of it as both sides can tell."""
    parts = [_heading(found)]
    top = 78.0
    for title, content, height in _parts(found):
        parts.append(f'<text class="part" x="{_MARGIN}" y="{top + 16:g}">{escape(title)}</text>')
        parts.append(f'<g transform="translate({_MARGIN} {top + 34:g})">{content}</g>')
        top += 34 + height + 34
    words = f"{found.names[0]} compared with {found.names[1]}"
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{_WIDTH}" height="{top:g}" '
        f'viewBox="0 0 {_WIDTH} {top:g}" role="img"><title>{escape(words)}</title><style>{_STYLE}</style>'
        f'<rect width="{_WIDTH}" height="{top:g}" fill="#ffffff"/>{"".join(parts)}</svg>\n'
    )


def _parts(found: Comparison) -> Iterator[tuple[str, str, float]]:
    """Title, drawing and height of each of the paper's figures that can be drawn."""
    if any(side.share.value is not None for kind in found.kinds.values() for side in (kind.one, kind.other)):
        yield ("Fig. 10: share of each class in all pixels", *_shares(found))
        yield ("Fig. 11: where each class lies (its mean mask over the greatest value)", *_places(found))
    yield ("Fig. 12: hues of each kind, in the middle of the pictures", *_hues(found))
    means = [side.statistics.mean_intensity() for side in (found.one, found.other)]
    if any(mean is not None for mean in means):
        # All are brightened alike, as far as none is cut off, as the paper does.
        brightest = max(float(np.percentile(mean, 99.5)) for mean in means if mean is not None)
        factor = max(1.0, float(np.floor(10.0 * 255.0 / max(1.0, brightest)) / 10.0))
        shown = f", shown {factor:g} times as bright" if factor > 1.0 else ""
        yield (f"Fig. 13: mean intensity over all pictures{shown}", *_light(found, factor))


def _heading(found: Comparison) -> str:
    left, texts = float(_MARGIN), []
    for key, name, side in zip("ab", found.names, (found.one, found.other), strict=True):
        noun = "pictures" if side.pictured else "pictures and spectra that patches are from"
        words = f"{_short(name, 45)}: {side.units:,} of {side.of:,} {noun}"
        texts.append(
            f'<rect class="{key}" x="{left:g}" y="52" width="14" height="8"/>'
            f'<text x="{left + 20:g}" y="60">{escape(words)}</text>'
        )
        left += 20 + 7.6 * len(words) + 30
    title = f"{_short(found.names[0], 45)} and {_short(found.names[1], 45)}"
    return f'<text class="head" x="{_MARGIN}" y="36">{escape(title)}</text>{"".join(texts)}'


def _shares(found: Comparison) -> tuple[str, float]:
    """Bars from zero, with the interval as a line and the number behind it."""
    kinds = [kind for kind in found.kinds.values() if "." not in kind.kind]
    sides = [(key, side.share) for kind in kinds for key, side in (("a", kind.one), ("b", kind.other))]
    widest = max((one.high or one.value or 0.0) for _, one in sides) or 1.0
    left, length = 110.0, _WIDTH - 2 * _MARGIN - 110.0 - 190.0
    drawn = []
    for row, kind in enumerate(kinds):
        y = row * (2 * _BAR + 14.0)
        drawn.append(f'<text class="end" x="{left - 10:g}" y="{y + _BAR + 5:g}">{escape(kind.kind)}</text>')
        for place, (key, share) in enumerate(sides[2 * row : 2 * row + 2]):
            drawn.append(_bar(key, share, left, y + place * (_BAR + 2), length / widest))
    height = len(kinds) * (2 * _BAR + 14.0)
    told = f"correlation of the shares: r = {cell(found.share_correlation, 3)}"
    if found.share_correlation.value is None:
        told = f"correlation of the shares: not known ({found.share_correlation.why})"
    drawn.append(f'<line class="floor" x1="{left:g}" x2="{left:g}" y1="-4" y2="{height - 6:g}"/>')
    drawn.append(f'<text x="{left:g}" y="{height + 12:g}">{escape(told)}</text>')
    return "".join(drawn), height + 16


def _bar(key: str, share: Estimate, left: float, top: float, scale: float) -> str:
    middle = top + _BAR / 2.0
    if share.value is None:
        return f'<text x="{left + 6:g}" y="{middle + 4:g}">{escape(share.why)}</text>'
    width = scale * share.value
    drawn = f'<rect class="{key}" x="{left:g}" y="{top:g}" width="{width:.2f}" height="{_BAR}"/>'
    ends = width
    if share.low is not None and share.high is not None:
        low, ends = left + scale * share.low, scale * share.high
        drawn += (
            f'<line class="range" x1="{low:.2f}" x2="{left + ends:.2f}" y1="{middle:g}" y2="{middle:g}"/>'
        )
    return f'{drawn}<text x="{left + ends + 6:.1f}" y="{middle + 4:g}">{cell(share, 2, 100.0)} %</text>'


def _places(found: Comparison) -> tuple[str, float]:
    """A pair of maps for each class that a side shows, as bright as the place where it is seen most."""
    masks = [side.statistics.mean_masks() for side in (found.one, found.other)]
    kinds = [kind for kind in found.kinds.values() if "." not in kind.kind]
    tallest = max(_MAP * mask.shape[1] / mask.shape[2] for mask in masks if mask is not None)
    cells = []
    for kind in kinds:
        organ_class = OrganClass[kind.kind.upper()]
        maps = []
        for place, mask in enumerate(masks):
            some = None if mask is None else mask[organ_class]
            why = (kind.one, kind.other)[place].share.why or "not seen"
            maps.append(_map(found.names[place], some, place * (_CHART[0] - _MAP), tallest, why))
        r = kind.place_correlation
        told = "" if r.value is None else f"r = {cell(r)},  SSIM {cell(kind.place_ssim)}"
        cells.append(f'<text class="name" x="0" y="0">{escape(kind.kind)}</text>{"".join(maps)}'
                     f'<text x="0" y="{tallest + 44:g}">{told}</text>')  # fmt: skip
    drawn, height = _in_rows(cells, tallest + 76)
    ramp = "".join(
        f'<stop offset="{place / (len(VIRIDIS) - 1):g}" stop-color="{code}"/>'
        for place, code in enumerate(VIRIDIS)
    )
    legend = (
        f'<defs><linearGradient id="ramp">{ramp}</linearGradient></defs>'
        f'<text x="0" y="{height + 4:g}">never</text>'
        f'<rect x="44" y="{height - 6:g}" width="180" height="12" fill="url(#ramp)"/>'
        f'<text x="232" y="{height + 4:g}">most often</text>'
    )
    return drawn + legend, height + 10


def _map(name: str, mask: NDArray[np.float64] | None, left: float, tallest: float, why: str) -> str:
    """One class in one set; its greatest value stands below, or the reason why there is none."""
    greatest = 0.0 if mask is None else float(mask.max())
    if mask is None or greatest == 0.0:
        x, y = left + _MAP / 2.0, 14.0 + tallest / 2.0
        return (
            f'<rect class="none" x="{left:g}" y="10" width="{_MAP}" height="{tallest:g}"/>'
            f'<text class="mid" x="{x:g}" y="{y:g}">{escape(_short(why, 22))}</text>'
        )
    height = _MAP * mask.shape[0] / mask.shape[1]
    address = drawing(share_colours(mask / greatest), _MAP_PX)
    return (
        f'<image x="{left:g}" y="10" width="{_MAP}" height="{height:.1f}" href="{address}"/>'
        f'<text x="{left:g}" y="{tallest + 26:g}">{escape(_short(name))}: up to {100 * greatest:.0f} %</text>'
    )


def _hues(found: Comparison) -> tuple[str, float]:
    """A chart of both spectra for each kind; what they have in common stands below."""
    cells = []
    for place, kind in enumerate(found.kinds.values()):
        curves = _spectra(found, kind)
        chart = line_chart(
            f"hue{place}", f"Hues of {kind.kind}", curves, _HUE_AXIS, "% of its pixels", hues=True
        )
        if kind.hue_correlation.value is None:
            told = f"not compared: {kind.hue_correlation.why}"
        else:
            told = f"r = {cell(kind.hue_correlation)},  EMD {cell(kind.hue_emd_deg, 0)}°"
        cells.append(
            f'<text class="name" x="0" y="0">{escape(kind.kind)}</text>{_placed(chart, 0, 8, *_CHART)}'
            f'<text x="0" y="{_CHART[1] + 26}">{escape(told)}</text>'
            f'<text x="0" y="{_CHART[1] + 43}">{escape(_colours(kind))}</text>'
        )
    drawn, height = _in_rows(cells, _CHART[1] + 76.0)
    mean = f"mean over the plant parts: r = {cell(found.hue_correlation)}"
    return f'{drawn}<text x="0" y="{height:g}">{escape(mean)}</text>', height + 6


def _spectra(found: Comparison, kind: KindComparison) -> list[Curve]:
    """The hue spectra of those sets that show the kind."""
    return [
        Curve(key, name, bin_angles(HUE_BINS), similarity.hue_spectra(sums[:1])[0])
        for key, name, side in zip("ab", found.names, (found.one, found.other), strict=True)
        if (sums := side.totals(kind.kind)) is not None
    ]


def _colours(kind: KindComparison) -> str:
    if kind.delta_e_2000.value is None:
        return ""
    return f"ΔE2000 of the mean colours {cell(kind.delta_e_2000, 1)}"


def _light(found: Comparison, factor: float) -> tuple[str, float]:
    """Both mean pictures, `factor` times as bright, and how they fall from the middle."""
    sides = [(key, name, mean) for key, name, side in zip("ab", found.names, (found.one, found.other),
             strict=True) if (mean := side.statistics.mean_intensity()) is not None]  # fmt: skip
    cells, tallest = [], max(_CHART[0] * mean.shape[0] / mean.shape[1] for _, _, mean in sides)
    for _key, name, mean in sides:
        grey = np.rint(np.minimum(factor * mean, 255.0)).astype(np.uint8)
        measure = found.light.one if name == found.names[0] else found.light.other
        height = _CHART[0] * mean.shape[0] / mean.shape[1]
        cells.append(
            f'<text class="name" x="0" y="0">{escape(name)}</text>'
            f'<image x="0" y="10" width="{_CHART[0]}" height="{height:.1f}" '
            f'href="{drawing(np.repeat(grey[..., None], 3, axis=-1), 2 * _MAP_PX)}"/>'
            f'<text x="0" y="{tallest + 28:g}">mean {cell(measure, 1)} of 255</text>'
        )
    chart = line_chart("falloff", "Mean intensity by distance from the middle",
                       [_falloff(*side) for side in sides], _FALLOFF_AXIS, "grey value")  # fmt: skip
    light = found.light
    told = (
        f"correlation of the falls r = {cell(light.falloff_correlation)}",
        f"of the mean pictures r = {cell(light.correlation)},  SSIM {cell(light.ssim)}",
    )
    lines = "" if light.correlation.value is None else "".join(
        f'<text x="0" y="{_CHART[1] + 26 + 17 * row}">{line}</text>' for row, line in enumerate(told)
    )  # fmt: skip
    cells.append(f'<text class="name" x="0" y="0">fall towards the corners</text>'
                 f"{_placed(chart, 0, 8, *_CHART)}{lines}")  # fmt: skip
    return _in_rows(cells, max(tallest + 40.0, _CHART[1] + 50.0))


def _falloff(key: str, name: str, mean: NDArray[np.float64]) -> Curve:
    radii = np.linspace(0.0, 1.0, _RINGS + 1)
    rings = centre_falloff(mean, radii)
    held = np.isfinite(rings)
    return Curve(key, name, ((radii[1:] + radii[:-1]) / 2.0)[held], rings[held])


def _in_rows(cells: Sequence[str], height: float) -> tuple[str, float]:
    """Drawings beside and below each other, and how tall they are together."""
    placed = [
        f'<g transform="translate({place % _COLUMNS * (_CHART[0] + _GAP)} '
        f'{place // _COLUMNS * height + 14:g})">{content}</g>'
        for place, content in enumerate(cells)
    ]
    return "".join(placed), -(-len(cells) // _COLUMNS) * height + 14


def _placed(chart: str, left: float, top: float, width: float, height: float) -> str:
    """A chart of the report as a part of a larger drawing."""
    place = f'x="{left:g}" y="{top:g}" width="{width:g}" height="{height:g}"'
    return chart.replace("<svg ", f"<svg {place} ", 1)


def _short(name: str, most: int = 12) -> str:
    return name if len(name) <= most else name[: most - 1] + "…"
