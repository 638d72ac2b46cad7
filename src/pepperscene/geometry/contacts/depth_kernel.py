"""Compiled search for patches of sample points near spheres, and their depth in fruit and stems."""

from __future__ import annotations

from typing import Any, Final, NamedTuple

import numpy as np

from pepperscene.geometry.contacts.compiled import compiled
from pepperscene.geometry.mesh import IndexArray, SingleArray

_ZERO: Final = np.float32(0.0)
_ONE: Final = np.float32(1.0)
_SMALL: Final = np.float32(1e-12)
_FAR: Final = np.float32(-np.inf)


@compiled
def spheres_near_boxes(
    low: SingleArray,
    high: SingleArray,
    centre: SingleArray,
    radius: SingleArray,
    transform: IndexArray,
    rotation: SingleArray,
    shift: SingleArray,
) -> tuple[IndexArray, SingleArray]:
    """Boxes `(n, 3)` to `(n, 3)` that overlap the sphere of each after some of its transforms `(t, k)`.

    Returns:
        `(h,)` index of each box times k plus that of the transform, ascending; and `(h, 3)` the sphere's
        centre relative to the box.
    """
    steps = rotation.shape[1]
    found, spheres = np.empty(len(centre) * steps, np.intp), np.empty((len(centre) * steps, 3), np.float32)
    count = 0
    for row in range(len(centre)):
        motion, limit = transform[row], radius[row] * radius[row]
        for step in range(steps):
            # Instead of moving organs to spheres, move spheres back to the organs.
            x = centre[row, 0] - shift[motion, step, 0]
            y = centre[row, 1] - shift[motion, step, 1]
            z = centre[row, 2] - shift[motion, step, 2]
            square = _ZERO
            for axis in range(3):
                target = (
                    x * rotation[motion, step, 0, axis]
                    + y * rotation[motion, step, 1, axis]
                    + z * rotation[motion, step, 2, axis]
                )
                offset = target - min(max(target, low[row, axis]), high[row, axis])
                square += offset * offset
                spheres[count, axis] = target
            if square < limit:
                found[count] = row * steps + step
                count += 1
    return found[:count], spheres[:count]


@compiled
def patches_near_spheres(
    first: IndexArray,
    count: IndexArray,
    centre: SingleArray,
    patch_radius: SingleArray,
    sphere: SingleArray,
    radius: SingleArray,
) -> tuple[IndexArray, IndexArray]:
    """Patches of organs, `first` to `first + count`, whose bounding spheres overlap the sphere of each organ.

    Returns:
        `(m,)` index of each patch's organ, and `(m,)` the patches.
    """
    total = 0
    for row in range(len(first)):
        total += count[row]
    hit, patch = np.empty(total, np.intp), np.empty(total, np.intp)
    found = 0
    for row in range(len(first)):
        for item in range(first[row], first[row] + count[row]):
            distance = _ZERO
            for axis in range(3):
                offset = centre[axis, item] - sphere[row, axis]
                distance += offset * offset
            limit = radius[row] + patch_radius[item]
            if distance < limit * limit:
                hit[found], patch[found] = row, item
                found += 1
    return hit[:found], patch[:found]


class FruitPlaces(NamedTuple):
    """Fruit, and where some organs are relative to them."""

    fruit: IndexArray  # `(h,)`
    matrix: SingleArray  # `(h, 3, 3)` and
    offset: SingleArray  # `(h, 3)` metres: matrix @ point + offset is relative to the fruit's centre
    limit: SingleArray  # `(h,)` metres from that centre; points farther away are ignored


@compiled
def depths_in_fruit(
    planes: SingleArray,
    cells: int,
    places: FruitPlaces,
    hit: IndexArray,
    points: SingleArray,
    patch: IndexArray,
    stride: int,
) -> SingleArray:
    """The depths of `FruitSurfaces.patch_depths`; `planes` `(f, cells * cells, 4)` are those of all fruit."""
    fruit, matrix, offset, limit = places
    depths = np.empty(len(patch), np.float32)
    for number in range(len(patch)):
        row, item = hit[number], patch[number]
        body, reach = fruit[row], limit[row] * limit[row]
        deepest = _FAR
        for place in range(0, points.shape[2], stride):
            a, b, c = points[0, item, place], points[1, item, place], points[2, item, place]
            x = matrix[row, 0, 0] * a + matrix[row, 0, 1] * b + matrix[row, 0, 2] * c + offset[row, 0]
            y = matrix[row, 1, 0] * a + matrix[row, 1, 1] * b + matrix[row, 1, 2] * c + offset[row, 1]
            z = matrix[row, 2, 0] * a + matrix[row, 2, 1] * b + matrix[row, 2, 2] * c + offset[row, 2]
            if x * x + y * y + z * z < reach:
                cell = _cell(x, y, z, cells)
                depth = (
                    planes[body, cell, 3]
                    - planes[body, cell, 0] * x
                    - planes[body, cell, 1] * y
                    - planes[body, cell, 2] * z
                )
                deepest = max(deepest, depth)
        depths[number] = deepest
    return depths


@compiled
def direction_cells(points: SingleArray, cells: int) -> IndexArray:
    """`(n,)` cells of the directions of points `(3, n)` in a map of `cells` by `cells`."""
    result = np.empty(points.shape[1], np.intp)
    for number in range(points.shape[1]):
        result[number] = _cell(points[0, number], points[1, number], points[2, number], cells)
    return result


@compiled
def _cell(x: Any, y: Any, z: Any, cells: int) -> int:
    """Cell of a direction on an octahedron that is unfolded into a square."""
    scale = _ONE / (abs(x) + abs(y) + abs(z) + _SMALL)
    u, v = x * scale, y * scale
    if z < _ZERO:
        # The lower half of the octahedron is folded out over the corners of the square.
        u, v = np.copysign(_ONE - abs(v), u), np.copysign(_ONE - abs(u), v)
    half = np.float32(0.5 * cells)
    column, row = int(u * half + half), int(v * half + half)
    return min(row, cells - 1) * cells + min(column, cells - 1)


@compiled
def depths_in_capsules(
    start: SingleArray,
    span: SingleArray,
    square: SingleArray,
    radius: SingleArray,
    capsule: IndexArray,
    points: SingleArray,
    patch: IndexArray,
    stride: int,
) -> SingleArray:
    """The depths of `Capsules.depths`; `square` `(c,)` are the squared lengths of the spans."""
    depths = np.empty(len(patch), np.float32)
    for number in range(len(patch)):
        row, item = capsule[number], patch[number]
        a, b, c = span[row, 0], span[row, 1], span[row, 2]
        nearest = -_FAR
        for place in range(0, points.shape[2], stride):
            x = points[0, item, place] - start[row, 0]
            y = points[1, item, place] - start[row, 1]
            z = points[2, item, place] - start[row, 2]
            along = min(max((x * a + y * b + z * c) / square[row], _ZERO), _ONE)
            x, y, z = x - along * a, y - along * b, z - along * c
            nearest = min(nearest, x * x + y * y + z * z)
        depths[number] = radius[row] - np.sqrt(nearest)
    return depths
