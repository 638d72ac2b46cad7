"""Finding a ColorChecker in a picture: flat quadrangles of one size on a grid of six by four.

colour-checker-detection, the library for this, weighs 50 MB, brings OpenImageIO, and asks for the OpenCV with
windows, which puts itself over the one without that `pepperscene[export]` uses; hence these few lines on
scikit-image and SciPy. Which way the chart is held is not told here: its colours tell.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.errors import InputError

Floats = NDArray[np.float64]

COLUMNS: Final = 6
ROWS: Final = 4
_MIDDLE: Final = 0.25
"""Half the side of a field's middle, in fields: what lies further out may be the frame (chosen)."""

_MOST_PIXELS: Final = 500_000
"""Of a chart, that are looked at: some five thousand in the middle of each field (chosen)."""


def homography(source: Floats, target: Floats) -> Floats:
    """`(3, 3)` projective map of points `(n, 2)` onto others, n >= 4, by least squares.

    The direct linear transform (Hartley & Zisserman 2004, "Multiple view geometry", section 4.1), of
    points brought to mean 0 and scale 1.
    """
    (one, from_source), (other, from_target) = _normalised(source), _normalised(target)
    x, y = one.T
    u, v = other.T
    none, unit = np.zeros_like(x), np.ones_like(x)
    rows = np.concatenate(
        [
            np.stack([x, y, unit, none, none, none, -u * x, -u * y, -u], axis=1),
            np.stack([none, none, none, x, y, unit, -v * x, -v * y, -v], axis=1),
        ]
    )
    found = np.linalg.svd(rows)[2][-1].reshape(3, 3)
    return np.asarray(np.linalg.inv(from_target) @ found @ from_source)


def mapped(matrix: Floats, points: Floats) -> Floats:
    """Points `(..., 2)` through a projective map."""
    moved = points @ matrix[:, :2].T + matrix[:, 2]
    return np.asarray(moved[..., :2] / moved[..., 2:])


def grid_corners(columns: int = COLUMNS, rows: int = ROWS) -> Floats:
    """`(4, 2)` corners of a chart whose fields have the side 1, clockwise from the first field's."""
    return np.array([[0.0, 0.0], [columns, 0.0], [columns, rows], [0.0, rows]])


def field_numbers(shape: tuple[int, int], corners: Floats) -> tuple[tuple[slice, slice], NDArray[np.intp]]:
    """Which field's middle half each pixel shows; of a large chart, only some rows and columns are asked.

    Args:
        shape: height and width of the picture.
        corners: `(4, 2)` pixel coordinates of the chart's corners, from the first field along its first row.

    Returns:
        The part of the picture that holds the chart, and in it the fields' numbers `(h, w)`, row by row;
        -1 where there is none.
    """
    left, top = np.maximum(np.floor(corners.min(axis=0)).astype(int), 0)
    right, bottom = np.minimum(np.ceil(corners.max(axis=0)).astype(int), [shape[1], shape[0]])
    step = 1 + int(np.sqrt((right - left) * (bottom - top) / _MOST_PIXELS))
    columns, rows = np.meshgrid(np.arange(left, right, step) + 0.5, np.arange(top, bottom, step) + 0.5)
    place = mapped(homography(corners, grid_corners()), np.stack([columns, rows], axis=-1))
    cell = np.floor(place)
    near = (np.abs(place - cell - 0.5) <= _MIDDLE).all(axis=-1)
    inside = near & (cell >= 0).all(axis=-1) & (cell < [COLUMNS, ROWS]).all(axis=-1)
    numbers = np.where(inside, cell[..., 1] * COLUMNS + cell[..., 0], -1.0).astype(np.intp)
    return (slice(int(top), int(bottom), step), slice(int(left), int(right), step)), numbers


def orientations(corners: Floats) -> Iterator[Floats]:
    """The corners in all orders that go around the chart, as they are first: four turns, seen or mirrored."""
    for order in (corners, corners[::-1]):
        for turn in range(4):
            yield np.roll(order, -turn, axis=0)


def _normalised(points: Floats) -> tuple[Floats, Floats]:
    """Points with mean 0 and scale 1, and the map that makes them so."""
    middle = points.mean(axis=0)
    scale = np.sqrt(2.0) / np.linalg.norm(points - middle, axis=1).mean()
    matrix = np.array([[scale, 0.0, -scale * middle[0]], [0.0, scale, -scale * middle[1]], [0.0, 0.0, 1.0]])
    return (points - middle) * scale, matrix


# All chosen, on drawn charts in any pose that leaves the fields' sides within a factor of 2 of each other.
_LONGEST_PX: Final = 1000  # of a picture in which fields are looked for; a chart over a sixth has 20 px each
_FLAT: Final = (0.015, 0.03, 0.06)  # largest change of a channel per pixel within a field, of full scale
_SMOOTH_PX: Final = 1.0  # takes the noise out of the changes
_SOLID: Final = 0.85  # least share of its convex hull that a field fills
_AREA: Final = (60, 0.03)  # of a field: least pixels, and largest share of the picture
_ALIKE: Final = 2.5  # largest ratio of the areas of neighbours
_NEAR: Final = 0.25  # of a step, within which the next field is looked for
_LEAST_FOUND: Final = 14  # of the 24; the others follow from the grid


@dataclass(frozen=True, eq=False)
class _Fields:
    """Flat quadrangles: middles `(n, 2)` as x, y, and areas `(n,)`."""

    middles: Floats
    areas: Floats


def find_chart(picture: NDArray[np.uint8], where: str | Path) -> Floats:
    """`(4, 2)` corners of the chart in a picture, going around it, in pixel coordinates.

    Args:
        picture: `(h, w, 3)` uint8.
        where: the file, for messages.

    Raises:
        InputError: there is none.
    """
    scale = max(1.0, max(picture.shape[:2]) / _LONGEST_PX)
    small = _smaller(picture, scale)
    found = [grid for flat in _FLAT for grid in _grids(_fields(small, flat))]
    if not found:
        allowed = "shows no ColorChecker that can be found: give the four corners of its fields"
        raise InputError(where, allowed, key="chart")
    cells, middles = max(found, key=lambda grid: (len(grid[0]), -_misfit(*grid)))
    return mapped(homography(cells + 0.5, middles), _around(cells)) * scale


def _misfit(cells: Floats, middles: Floats) -> float:
    """Mean distance of the fields from where the grid has them."""
    placed = mapped(homography(cells + 0.5, middles), cells + 0.5)
    return float(np.linalg.norm(placed - middles, axis=1).mean())


def _smaller(picture: NDArray[np.uint8], scale: float) -> Floats:
    """The picture in 0 to 1, at most `_LONGEST_PX` long."""
    from skimage.transform import resize

    height, width = (round(length / scale) for length in picture.shape[:2])
    if scale == 1.0:
        return picture / 255.0
    return np.asarray(resize(picture / 255.0, (height, width), anti_aliasing=True))


def _fields(picture: Floats, flat: float) -> _Fields:
    """Quadrangles in which no channel changes by more than `flat` from pixel to pixel."""
    from scipy.ndimage import gaussian_gradient_magnitude, label
    from skimage.measure import regionprops

    change = np.max([gaussian_gradient_magnitude(picture[..., k], _SMOOTH_PX) for k in range(3)], axis=0)
    numbered, _ = label(change < flat)
    least, most = _AREA[0], _AREA[1] * change.size
    kept = [
        (one.centroid[1] + 0.5, one.centroid[0] + 0.5, one.area)
        for one in regionprops(numbered)
        if least <= one.area <= most and one.area >= _SOLID * one.area_convex
    ]
    table = np.array(kept, float).reshape(-1, 3)
    return _Fields(table[:, :2], table[:, 2])


def _grids(fields: _Fields) -> Iterator[tuple[Floats, Floats]]:
    """Grids of six by four among the fields: cells `(k, 2)` and middles `(k, 2)` of those that were found."""
    seen: set[int] = set()
    for seed in np.argsort(fields.areas)[::-1].tolist():
        if seed in seen:
            continue
        cells = _spread(fields, seed)
        seen |= cells.keys()
        places, middles = np.array(list(cells.values())), fields.middles[list(cells)]
        # What happens to lie beside the chart may have joined: every part that could be the chart is tried.
        for size in ((COLUMNS, ROWS), (ROWS, COLUMNS)):
            for first in np.ndindex(*np.maximum(np.ptp(places, axis=0) + 2 - size, 1).tolist()):
                inside = places - places.min(axis=0) - first
                held = ((inside >= 0) & (inside < size)).all(axis=1)
                filled = tuple((np.ptp(inside[held], axis=0) + 1).tolist()) if held.any() else ()
                if held.sum() >= _LEAST_FOUND and filled == size:
                    yield inside[held].astype(float), middles[held]


def _spread(fields: _Fields, seed: int) -> dict[int, tuple[int, int]]:
    """Cell of every field that can be reached from `seed` in steps of one field along either axis.

    Each field takes over the steps that led to it, so that the grid may shrink with the distance.
    """
    steps = _first_steps(fields, seed)
    cells = {seed: (0, 0)}
    if steps is None:
        return cells
    waiting = deque([(seed, steps)])
    while waiting:
        here, (along, down) = waiting.popleft()
        for column, row in ((1, 0), (-1, 0), (0, 1), (0, -1)):
            step = column * along + row * down
            found = _at(fields, here, fields.middles[here] + step, _NEAR * float(np.linalg.norm(step)))
            place = (cells[here][0] + column, cells[here][1] + row)
            if found is None or found in cells or place in cells.values():
                continue
            cells[found] = place
            moved = fields.middles[found] - fields.middles[here]
            onward = (moved * column, down) if column else (along, moved * row)
            waiting.append((found, onward))
    return cells


def _first_steps(fields: _Fields, seed: int) -> tuple[Floats, Floats] | None:
    """The way to the nearest field of like size, and the nearest across it."""
    ways = fields.middles - fields.middles[seed]
    lengths = np.linalg.norm(ways, axis=1)
    alike = _alike(fields, seed) & (lengths > 0.0)
    if not alike.any():
        return None
    first = ways[np.where(alike, lengths, np.inf).argmin()]
    # Across: more than 45 degrees off, seen in perspective as well.
    cosine = np.abs(ways @ first) / np.maximum(lengths * np.linalg.norm(first), 1e-12)
    across = alike & (cosine < np.sqrt(0.5))
    if not across.any():
        return None
    return first, ways[np.where(across, lengths, np.inf).argmin()]


def _at(fields: _Fields, here: int, place: Floats, within: float) -> int | None:
    """The field of like size at a place."""
    away = np.where(_alike(fields, here), np.linalg.norm(fields.middles - place, axis=1), np.inf)
    nearest = int(away.argmin())
    return nearest if away[nearest] <= within else None


def _alike(fields: _Fields, one: int) -> NDArray[np.bool_]:
    ratio = fields.areas / fields.areas[one]
    return np.asarray((ratio < _ALIKE) & (ratio > 1.0 / _ALIKE))


def _around(cells: Floats) -> Floats:
    """`(4, 2)` corners of the grid that the cells fill."""
    columns, rows = (cells.max(axis=0) + 1).astype(int).tolist()
    corners = grid_corners(columns, rows)
    # Begins at a corner from which the first side is the longer one.
    return corners if columns == COLUMNS else np.roll(corners, -1, axis=0)
