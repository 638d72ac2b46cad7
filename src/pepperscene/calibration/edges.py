"""Sharpness by slanted edges: the modulation transfer function of the borders of a chart's fields.

The edge-based spatial frequency response (e-SFR) of ISO 12233: linear values across a straight
edge that is slightly turned against the pixels are sorted by their distance from it into bins of a quarter of
a pixel; the derivative is the line spread function, and the modulus of its Fourier transform the MTF. Used
are the outer borders of the outer fields, beside which the black frame is wide.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.calibration.photographs import ChartPhotograph
from pepperscene.colour.patches.chart_detection import grid_corners, map_points

Floats = NDArray[np.float64]

FREQUENCIES: Final = np.linspace(0.0, 1.0, 51)
"""Cycles per pixel at which an MTF is given."""

_BIN_PX: Final = 0.25  # as in ISO 12233
_LENGTH: Final = 0.6  # chosen: middle of a border that is used, in steps of the grid; corners are rounded
_REACH: Final = (0.22, 16.0)  # chosen: distance from an edge, in steps of the grid, and at most in pixels
_FRAME_STEPS: Final = 0.05  # half the gap between fields
_MIN_REACH_PX: Final = 4.0  # chosen: the width of a blurred or sharpened edge
_MIN_DRIFT_PX: Final = 1.0  # the edge must pass all positions within a pixel
_MIN_CONTRAST: Final = 0.05  # chosen: linear difference of field and frame
_RESAMPLES: Final = 200  # chosen: a standard deviation is then known to 5 %
_LUMA: Final = np.array([0.2126, 0.7152, 0.0722])  # luminance of linear sRGB, IEC 61966-2-1


@dataclass(frozen=True, eq=False)
class Sharpness:
    """Modulation transfer at `FREQUENCIES`.

    Attributes:
        mtf: `(51,)` mean over the edges; 1 at frequency 0.
        mtf_sd: `(51,)` its standard deviation, over resamples of the edges.
        mtf50: lowest frequency at which it is 0.5, cycles per pixel; 1 if it does not fall so far.
        mtf50_sd: its standard deviation.
        edges: number of edges.
    """

    mtf: Floats
    mtf_sd: Floats
    mtf50: float
    mtf50_sd: float
    edges: int


def chart_sharpness(
    photograph: ChartPhotograph, linear: Floats, rng: np.random.Generator | None = None
) -> Sharpness | None:
    """Sharpness by the edges of a chart; None if fewer than three are turned far enough against the pixels.

    The line spread functions of all edges are averaged before they are transformed: the modulus of a noisy
    transform is too large.

    Args:
        photograph: of a chart.
        linear: `(h, w, 3)` linear values of its picture.
        rng: draws resamples of the edges for the standard deviations; None leaves these 0.
    """
    luminance = linear @ _LUMA
    edges = list(_outer_edges(photograph))
    reach_px = min((reach for *_, reach in edges), default=0.0)
    spreads = [
        spread
        for start, end, _ in edges
        if (spread := line_spread(luminance, start, end, reach_px)) is not None
    ]
    if len(spreads) < 3:
        return None
    # Edges of high contrast have less noise, by the square of their contrast.
    values, weights = np.array(spreads), np.array([spread.sum() ** 2 for spread in spreads])
    values /= values.sum(axis=1, keepdims=True)
    counts = np.ones((1, len(values)))
    if rng is not None:
        drawn = rng.multinomial(len(values), np.full(len(values), 1.0 / len(values)), _RESAMPLES)
        counts = np.concatenate([counts, drawn])
    shares = counts * weights
    mtf = np.array([transfer(spread) for spread in shares @ values / shares.sum(axis=1, keepdims=True)])
    if rng is None:
        return Sharpness(mtf[0], np.zeros(len(FREQUENCIES)), mtf50(mtf[0]), 0.0, len(values))
    spread_of_50 = float(np.std([mtf50(curve) for curve in mtf[1:]], ddof=1))
    return Sharpness(mtf[0], mtf[1:].std(axis=0, ddof=1), mtf50(mtf[0]), spread_of_50, len(values))


def mtf50(mtf: Floats) -> float:
    """The lowest of `FREQUENCIES`, interpolated, at which an MTF `(51,)` falls to 0.5; 1 if it does not."""
    below = np.flatnonzero(mtf < 0.5)
    if not len(below):
        return 1.0
    last = int(below[0])
    share = (mtf[last - 1] - 0.5) / (mtf[last - 1] - mtf[last])
    return float(FREQUENCIES[last - 1] + share * (FREQUENCIES[last] - FREQUENCIES[last - 1]))


def transfer(spread: Floats) -> Floats:
    """`(51,)` MTF at `FREQUENCIES` of a line spread function by `line_spread`."""
    place = (np.arange(len(spread)) - (len(spread) - 1) / 2) * _BIN_PX
    transform = np.abs(np.exp(-2j * np.pi * FREQUENCIES[:, None] * place) @ spread)
    # Bins and differences blur by a box of a bin each.
    return np.asarray(transform / transform[0] / np.sinc(FREQUENCIES * _BIN_PX) ** 2)


def line_spread(luminance: Floats, start: Floats, end: Floats, reach_px: float) -> Floats | None:
    """Line spread function across an edge in steps of a quarter of a pixel; None if it cannot be measured.

    It runs from the left to the right of the direction from start to end, and its sum is the contrast.

    Args:
        luminance: `(h, w)` linear image.
        start: `(2,)` x, y of a point near the beginning of the edge; pixel centres are at halves.
        end: `(2,)` of a point near its end.
        reach_px: distance from the edge up to which pixels are used.
    """
    along = (end - start) / np.linalg.norm(end - start)
    normal = np.array([-along[1], along[0]])
    places, values = _pixels_around(luminance, start, end, reach_px)
    if not len(values) or reach_px < _MIN_REACH_PX:
        return None
    # Refine the line: the centroids of the derivative in steps along the edge lie on it.
    for _ in range(2):
        across, position = (places - start) @ normal, (places - start) @ along
        line = _edge_line(across, position, values, float(np.linalg.norm(end - start)))
        if line is None:
            return None
        start = start + line[1] * normal
        along = along + line[0] * normal
        along /= np.linalg.norm(along)
        normal = np.array([-along[1], along[0]])
    drift = np.min(np.abs(along)) / np.max(np.abs(along)) * np.linalg.norm(end - start)
    if drift < _MIN_DRIFT_PX:
        return None
    # The refined line may be a pixel beside the first one, along which the pixels were chosen.
    return _binned_derivative((places - start) @ normal, values, reach_px - 1.0)


def _pixels_around(luminance: Floats, start: Floats, end: Floats, reach_px: float) -> tuple[Floats, Floats]:
    """Centres `(n, 2)` and values `(n,)` of the pixels beside an edge."""
    low = np.floor(np.minimum(start, end) - reach_px - 1).astype(int)
    high = np.ceil(np.maximum(start, end) + reach_px + 1).astype(int)
    if (low < 0).any() or (high > [luminance.shape[1], luminance.shape[0]]).any():
        return np.empty((0, 2)), np.empty(0)
    x, y = np.meshgrid(np.arange(low[0], high[0]), np.arange(low[1], high[1]))
    places = np.stack([x, y], axis=-1).reshape(-1, 2) + 0.5
    along = (end - start) / np.linalg.norm(end - start)
    offset = places - start
    position, across = offset @ along, offset @ np.array([-along[1], along[0]])
    inside = (position >= 0) & (position <= np.linalg.norm(end - start)) & (np.abs(across) <= reach_px)
    return places[inside], luminance[low[1] : high[1], low[0] : high[0]].ravel()[inside]


def _edge_line(across: Floats, position: Floats, values: Floats, length: float) -> tuple[float, float] | None:
    """Slope and offset of an edge against the assumed one, from the places of half height along it."""
    reach = float(np.abs(across).max())
    low, high = np.median(values[across < -reach / 2]), np.median(values[across > reach / 2])
    if abs(high - low) < _MIN_CONTRAST:
        return None
    # In a strip across the edge, the mean of the relative height gives the place of the edge.
    parts = max(int(length / 4.0), 3)
    numbers = np.minimum((position / length * parts).astype(int), parts - 1)
    height = (values - low) / (high - low)
    steps = []
    for number in range(parts):
        part = numbers == number
        if part.sum() < reach:
            continue
        order = np.argsort(across[part])
        place, profile = across[part][order], height[part][order]
        steps.append((position[part].mean(), place[-1] - np.trapezoid(profile, place)))
    if len(steps) < 3:
        return None
    middles, offsets = np.array(steps).T
    slope, offset = np.polyfit(middles, offsets, 1)
    return float(slope), float(offset)


def _binned_derivative(distance: Floats, values: Floats, reach_px: float) -> Floats | None:
    """Windowed derivative of values at distances from an edge."""
    bins = int(reach_px / _BIN_PX)
    numbers = np.floor(distance / _BIN_PX).astype(int) + bins
    inside = (numbers >= 0) & (numbers < 2 * bins)
    counts = np.bincount(numbers[inside], minlength=2 * bins)
    if (counts == 0).any():
        return None
    spread = np.diff(np.bincount(numbers[inside], values[inside], 2 * bins) / counts)
    # Tukey's window, flat over half of the reach, damps the noise far from the edge without a bias near it.
    place = (np.arange(len(spread)) - (len(spread) - 1) / 2) * _BIN_PX
    outside = np.clip(2.0 * np.abs(place) / reach_px - 1.0, 0.0, 1.0)
    return np.asarray(spread * (0.5 + 0.5 * np.cos(np.pi * outside)))


def _outer_edges(photograph: ChartPhotograph) -> Iterator[tuple[Floats, Floats, float]]:
    """Beginning and end of each outer border of outer fields, in pixels, and the reach on both sides."""
    for number in range(24):
        row, column = divmod(number, 6)
        if not photograph.usable[number].all():
            continue
        centre, half = np.array([column + 0.5, row + 0.5]), 0.5 - _FRAME_STEPS
        for side, is_outer in (((0, -1), row == 0), ((0, 1), row == 3), ((-1, 0), column == 0),
                               ((1, 0), column == 5)):  # fmt: skip
            if not is_outer:
                continue
            middle, along = centre + half * np.array(side), np.array([side[1], side[0]]) * _LENGTH / 2
            points = np.stack([middle - along, middle + along, middle + _REACH[0] * np.array(side)])
            start, end, out = map_points(points, grid_corners(), photograph.corners)
            direction = (end - start) / np.linalg.norm(end - start)
            outward = out - (start + end) / 2
            distance = float(outward @ np.array([-direction[1], direction[0]]))
            # The frame is always on the same side.
            ends = (start, end) if distance > 0.0 else (end, start)
            yield *ends, min(abs(distance), _REACH[1])
