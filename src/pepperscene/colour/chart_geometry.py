"""Where the fields of a chart lie in a picture, by its four corners."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

import numpy as np
from numpy.typing import NDArray

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
