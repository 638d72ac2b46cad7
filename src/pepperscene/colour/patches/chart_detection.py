"""Detection of a ColorChecker in a picture: flat quadrangles of one size on a grid of six by four.

The library for this, colour-checker-detection, weighs 50 MB, needs OpenImageIO, and installs the OpenCV with
windows over the headless one of `pepperscene[export]`; hence these functions on scikit-image and SciPy. They
find the grid only; the colours of the fields decide its orientation (`chart.calibrate`).
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
_HALF_CENTRE: Final = 0.25
"""Half the side of the centre of a field, in fields: beyond it the frame may show (chosen)."""

_MAX_CHART_PX: Final = 500_000
"""Pixels of a chart that are used at most: some five thousand in the centre of each field (chosen)."""

# All chosen, on drawn charts in any pose that leaves the fields' sides within a factor of 2 of each other.
_MAX_SIDE_PX: Final = 1000  # of the downscaled image; a chart over a sixth of it has fields of 20 px
_MAX_GRADIENTS: Final = (0.015, 0.03, 0.06)  # change of a channel per pixel within a field, of full scale
_SMOOTHING_PX: Final = 1.0  # removes noise from the gradients
_MIN_SOLIDITY: Final = 0.85  # fraction of its convex hull that a field fills
_AREA_RANGE: Final = (60, 0.03)  # of a field: least pixels, and largest fraction of the picture
_MAX_AREA_RATIO: Final = 2.5  # of neighbouring fields
_SEARCH_RADIUS: Final = 0.25  # in steps of the grid, around the predicted centre of the next field
_MIN_FIELDS: Final = 14  # of the 24; the others follow from the grid


def map_points(points: Floats, source: Floats, target: Floats) -> Floats:
    """Map points `(..., 2)` by the homography that maps `source` `(n, 2)` to `target`, n >= 4, best.

    The normalised direct linear transform (Hartley & Zisserman 2004, "Multiple view geometry", section 4.1).
    """
    from skimage.transform import estimate_transform

    transform = estimate_transform("projective", source, target)
    return np.asarray(transform(points.reshape(-1, 2)).reshape(points.shape))


def grid_corners(columns: int = COLUMNS, rows: int = ROWS) -> Floats:
    """`(4, 2)` corners of a chart with fields of side 1, clockwise from the first field's corner."""
    return np.array([[0.0, 0.0], [columns, 0.0], [columns, rows], [0.0, rows]])


def field_numbers(shape: tuple[int, int], corners: Floats) -> tuple[tuple[slice, slice], NDArray[np.intp]]:
    """The part of a picture that holds a chart, and in it the numbers `(h, w)` of the fields, row by row.

    Pixels in the central halves of fields have their numbers, others -1; large charts are subsampled. The
    corners `(4, 2)` go from the first field along its first row.
    """
    left, top = np.maximum(np.floor(corners.min(axis=0)).astype(int), 0)
    right, bottom = np.minimum(np.ceil(corners.max(axis=0)).astype(int), [shape[1], shape[0]])
    step = 1 + int(np.sqrt((right - left) * (bottom - top) / _MAX_CHART_PX))
    columns, rows = np.meshgrid(np.arange(left, right, step) + 0.5, np.arange(top, bottom, step) + 0.5)
    position = map_points(np.stack([columns, rows], axis=-1), corners, grid_corners())
    cell = np.floor(position)
    central = (np.abs(position - cell - 0.5) <= _HALF_CENTRE).all(axis=-1)
    inside = central & (cell >= 0).all(axis=-1) & (cell < [COLUMNS, ROWS]).all(axis=-1)
    numbers = np.where(inside, cell[..., 1] * COLUMNS + cell[..., 0], -1.0).astype(np.intp)
    return (slice(int(top), int(bottom), step), slice(int(left), int(right), step)), numbers


def orientations(corners: Floats) -> Iterator[Floats]:
    """The corners in all eight cyclic orders, as given first: four rotations, plain and mirrored."""
    for order in (corners, corners[::-1]):
        for rotation in range(4):
            yield np.roll(order, -rotation, axis=0)


@dataclass(frozen=True, eq=False)
class _Regions:
    """Flat quadrangles: centres `(n, 2)` as x, y, and areas `(n,)`."""

    centres: Floats
    areas: Floats


def find_chart(picture: NDArray[np.uint8], where: str | Path) -> Floats:
    """`(4, 2)` corners of the chart in a picture `(h, w, 3)`, in order around it, in pixel coordinates.

    Raises:
        InputError: no chart is found.
    """
    scale = max(1.0, max(picture.shape[:2]) / _MAX_SIDE_PX)
    small = _downscale(picture, scale)
    grids = [grid for gradient in _MAX_GRADIENTS for grid in _find_grids(_flat_regions(small, gradient))]
    if not grids:
        problem = "shows no ColorChecker that can be detected: give the four corners of its fields"
        raise InputError(where, problem, key="chart")
    cells, centres = max(grids, key=lambda grid: (len(grid[0]), -_misfit(*grid)))
    return map_points(_outline(cells), cells + 0.5, centres) * scale


def _misfit(cells: Floats, centres: Floats) -> float:
    """Mean distance of the fields from their positions on the grid."""
    predicted = map_points(cells + 0.5, cells + 0.5, centres)
    return float(np.linalg.norm(predicted - centres, axis=1).mean())


def _downscale(picture: NDArray[np.uint8], scale: float) -> Floats:
    """The picture in 0 to 1, with sides of at most `_MAX_SIDE_PX`."""
    from skimage.transform import resize

    height, width = (round(length / scale) for length in picture.shape[:2])
    if scale == 1.0:
        return picture / 255.0
    return np.asarray(resize(picture / 255.0, (height, width), anti_aliasing=True))


def _flat_regions(picture: Floats, max_gradient: float) -> _Regions:
    """Solid regions in which no channel changes by more than `max_gradient` from pixel to pixel."""
    from scipy.ndimage import gaussian_gradient_magnitude, label
    from skimage.measure import regionprops

    gradient = np.max([gaussian_gradient_magnitude(picture[..., k], _SMOOTHING_PX) for k in range(3)], axis=0)
    labels, _ = label(gradient < max_gradient)
    smallest, largest = _AREA_RANGE[0], _AREA_RANGE[1] * gradient.size
    rows = [
        (region.centroid[1] + 0.5, region.centroid[0] + 0.5, region.area)
        for region in regionprops(labels)
        if smallest <= region.area <= largest and region.area >= _MIN_SOLIDITY * region.area_convex
    ]
    table = np.array(rows, float).reshape(-1, 3)
    return _Regions(table[:, :2], table[:, 2])


def _find_grids(regions: _Regions) -> Iterator[tuple[Floats, Floats]]:
    """Grids of six by four among the regions: cells `(k, 2)` and centres `(k, 2)` of the detected fields."""
    visited: set[int] = set()
    for seed in np.argsort(regions.areas)[::-1].tolist():
        if seed in visited:
            continue
        cells = _grow_grid(regions, seed)
        visited |= cells.keys()
        positions, centres = np.array(list(cells.values())), regions.centres[list(cells)]
        # Other objects next to the chart may have joined the grid: try every window of the chart's size.
        for size in ((COLUMNS, ROWS), (ROWS, COLUMNS)):
            for first in np.ndindex(*np.maximum(np.ptp(positions, axis=0) + 2 - size, 1).tolist()):
                offset = positions - positions.min(axis=0) - first
                inside = ((offset >= 0) & (offset < size)).all(axis=1)
                extent = tuple((np.ptp(offset[inside], axis=0) + 1).tolist()) if inside.any() else ()
                if inside.sum() >= _MIN_FIELDS and extent == size:
                    yield offset[inside].astype(float), centres[inside]


def _grow_grid(regions: _Regions, seed: int) -> dict[int, tuple[int, int]]:
    """Cell of every region that can be reached from `seed` in steps of one field along either axis.

    Each region inherits the steps that led to it, so that the grid may shrink with perspective.
    """
    steps = _first_steps(regions, seed)
    cells = {seed: (0, 0)}
    if steps is None:
        return cells
    queue = deque([(seed, steps)])
    while queue:
        current, (along, down) = queue.popleft()
        for column, row in ((1, 0), (-1, 0), (0, 1), (0, -1)):
            step = column * along + row * down
            centre, radius = regions.centres[current] + step, _SEARCH_RADIUS * float(np.linalg.norm(step))
            neighbour = _region_at(regions, current, centre, radius)
            cell = (cells[current][0] + column, cells[current][1] + row)
            if neighbour is None or neighbour in cells or cell in cells.values():
                continue
            cells[neighbour] = cell
            offset = regions.centres[neighbour] - regions.centres[current]
            queue.append((neighbour, (offset * column, down) if column else (along, offset * row)))
    return cells


def _first_steps(regions: _Regions, seed: int) -> tuple[Floats, Floats] | None:
    """Vector to the nearest region of similar size, and to the nearest one across that direction."""
    vectors = regions.centres - regions.centres[seed]
    lengths = np.linalg.norm(vectors, axis=1)
    similar = _similar_size(regions, seed) & (lengths > 0.0)
    if not similar.any():
        return None
    first = vectors[np.where(similar, lengths, np.inf).argmin()]
    # Across: more than 45 degrees apart, which holds in perspective as well.
    cosine = np.abs(vectors @ first) / np.maximum(lengths * np.linalg.norm(first), 1e-12)
    across = similar & (cosine < np.sqrt(0.5))
    if not across.any():
        return None
    return first, vectors[np.where(across, lengths, np.inf).argmin()]


def _region_at(regions: _Regions, current: int, centre: Floats, radius: float) -> int | None:
    """The region of similar size that is nearest to a point, if it is within the radius."""
    away = np.linalg.norm(regions.centres - centre, axis=1)
    distance = np.where(_similar_size(regions, current), away, np.inf)
    nearest = int(distance.argmin())
    return nearest if distance[nearest] <= radius else None


def _similar_size(regions: _Regions, index: int) -> NDArray[np.bool_]:
    ratio = regions.areas / regions.areas[index]
    return np.asarray((ratio < _MAX_AREA_RATIO) & (ratio > 1.0 / _MAX_AREA_RATIO))


def _outline(cells: Floats) -> Floats:
    """`(4, 2)` corners of the grid that the cells fill."""
    columns, rows = (cells.max(axis=0) + 1).astype(int).tolist()
    corners = grid_corners(columns, rows)
    # Begin at a corner from which the first side is the longer one.
    return corners if columns == COLUMNS else np.roll(corners, -1, axis=0)
