"""Compiled search for patches of sample points near spheres, and their depth in fruit and stems."""

from __future__ import annotations

from typing import Any, Final

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
    """Boxes that overlap their sphere after transforms.

    Args:
        low: `(n, 3)` metres, lower corners of the boxes, and
        high: `(n, 3)` metres, their upper corners.
        centre: `(n, 3)` and
        radius: `(n,)` metres: the sphere of each.
        transform: `(n,)` row of the transforms of each box.
        rotation: `(t, k, 3, 3)` and
        shift: `(t, k, 3)` metres: the transforms.

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
    """Patches of organs that overlap a sphere.

    Args:
        first: `(h,)` first patch of each organ, and
        count: `(h,)` number of its patches.
        centre: `(3, p)` and
        patch_radius: `(p,)` metres: bounding spheres of all patches.
        sphere: `(h, 3)` and
        radius: `(h,)` metres: the sphere of each organ.

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


@compiled
def depths_in_fruit(
    planes: SingleArray,
    cells: int,
    fruit: IndexArray,
    matrix: SingleArray,
    offset: SingleArray,
    limit: SingleArray,
    hit: IndexArray,
    points: SingleArray,
    patch: IndexArray,
    stride: int,
) -> SingleArray:
    """Depth of the deepest point of each patch in a fruit; minus infinity where all points are ignored.

    Args:
        planes: `(f, cells * cells, 4)` of all fruit.
        cells: along either side of the map of directions.
        fruit: `(h,)` row in `planes`,
        matrix: `(h, 3, 3)`,
        offset: `(h, 3)` metres and
        limit: `(h,)` metres: of each organ near a fruit, the motion to the fruit's coordinates, and the
            distance from the fruit's centre beyond which points are ignored.
        hit: `(m,)` index of each patch's organ among these.
        points: `(3, p, s)` metres, of all patches.
        patch: `(m,)`.
        stride: use every `stride`-th point.
    """
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
    """Depth of the deepest point of each patch in a capsule, negative outside.

    Args:
        start: `(c, 3)` metres,
        span: `(c, 3)` metres,
        square: `(c,)` square metres, squared length of the span, and
        radius: `(c,)` metres of all capsules.
        capsule: `(m,)` capsule of each patch.
        points: `(3, p, s)` metres, of all patches.
        patch: `(m,)`.
        stride: use every `stride`-th point.
    """
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
