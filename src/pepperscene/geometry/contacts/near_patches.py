"""Patches of moving organs near spheres.

Bounding boxes are compared first, then bounding spheres of patches.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np

from pepperscene.geometry import compilation
from pepperscene.geometry.contacts.joints import RigidTransforms
from pepperscene.geometry.contacts.organs import Organs
from pepperscene.geometry.contacts.patches import expand_counts
from pepperscene.geometry.mesh import FloatArray, IndexArray, SingleArray

ENTRIES: Final = 1 << 16
"""Distances computed at a time without compiled code, chosen: they fit into a cache."""


def near_patches(
    organs: Organs,
    movers: IndexArray,
    centre: FloatArray,
    radius: FloatArray,
    transform: IndexArray,
    transforms: RigidTransforms,
) -> Iterator[tuple[IndexArray, IndexArray, IndexArray, IndexArray]]:
    """Patches of moving organs that overlap spheres, one sphere for each mover.

    Yields:
        `(h,)` indices of movers and `(h,)` of the transforms with which they meet their spheres; `(m,)` index
        of each patch's pair among these, and `(m,)` the patches.
    """
    targets = _Targets(
        movers,
        organs.low[movers].astype(np.float32),
        organs.high[movers].astype(np.float32),
        centre.astype(np.float32),
        radius.astype(np.float32),
        transform,
        transforms.rotation.astype(np.float32),
        transforms.shift.astype(np.float32),
    )
    if compilation.AVAILABLE:
        yield _compiled_patches(organs, targets)
    else:
        yield from _patches_by_arrays(organs, targets)


@dataclass(frozen=True, eq=False)
class _Targets:
    """Moving organs and the sphere of each, in single precision."""

    movers: IndexArray  # `(n,)` organs
    low: SingleArray  # `(n, 3)` metres, lower corners of their boxes
    high: SingleArray  # `(n, 3)` metres, upper corners
    centre: SingleArray  # `(n, 3)` metres, of the spheres
    radius: SingleArray  # `(n,)` metres
    transform: IndexArray  # `(n,)` row of the transforms of each
    rotation: SingleArray  # `(t, k, 3, 3)`
    shift: SingleArray  # `(t, k, 3)` metres


def _compiled_patches(
    organs: Organs, targets: _Targets
) -> tuple[IndexArray, IndexArray, IndexArray, IndexArray]:
    from pepperscene.geometry.contacts.depth_kernel import patches_near_spheres, spheres_near_boxes

    near, spheres = spheres_near_boxes(
        targets.low,
        targets.high,
        targets.centre,
        targets.radius,
        targets.transform,
        targets.rotation,
        targets.shift,
    )
    pair, step = np.divmod(near, targets.shift.shape[1])
    # Sample only organs that come near to something.
    organs.sample(targets.movers[np.unique(pair)])
    near_organs, patches = targets.movers[pair], organs.all_patches
    hit, patch = patches_near_spheres(
        organs.patch_first[near_organs],
        organs.patch_count[near_organs],
        patches.centre.T,
        patches.radius,
        spheres,
        targets.radius[pair],
    )
    return pair, step, hit, patch


def _patches_by_arrays(
    organs: Organs, targets: _Targets
) -> Iterator[tuple[IndexArray, IndexArray, IndexArray, IndexArray]]:
    """The same without compiled code, in blocks."""
    steps = targets.shift.shape[1]
    block_size = max(ENTRIES // (4 * steps), 1)
    for start in range(0, len(targets.movers), block_size):
        block = slice(start, start + block_size)
        # Instead of moving organs to spheres, move spheres back to the organs.
        target = _move_back(targets.centre[block], targets.transform[block], targets.rotation, targets.shift)
        square = np.zeros(target.shape[1:], dtype=np.float32)
        for axis in range(3):
            offset = target[axis] - np.clip(
                target[axis], targets.low[block, axis, None], targets.high[block, axis, None]
            )
            square += offset * offset
        near = np.flatnonzero(square < np.square(targets.radius[block])[:, None])
        pair, step = np.divmod(near, steps)
        sphere, pair = target.reshape(3, -1).take(near, axis=1), pair + start
        # Sample only organs that come near to something.
        organs.sample(targets.movers[np.unique(pair)])
        count = organs.patch_count[targets.movers[pair]]
        for part in _blocks(count):
            hit, number = expand_counts(count[part])
            patch = organs.patch_first[targets.movers[pair[part]]][hit] + number
            limit = targets.radius.take(pair[part]).take(hit) + organs.all_patches.radius.take(patch)
            distance = np.zeros(len(patch), dtype=np.float32)
            for axis in range(3):
                offset = organs.all_patches.centre[:, axis].take(patch) - sphere[axis, part].take(hit)
                distance += offset * offset
            kept = np.flatnonzero(distance < limit * limit)
            if len(kept):
                yield pair[part], step[part], hit[kept], patch[kept]


def _move_back(
    centre: SingleArray, transform: IndexArray, rotation: SingleArray, shift: SingleArray
) -> SingleArray:
    """`(3, n, k)` points that transforms move to centres `(n, 3)`."""
    x, y, z = (centre[:, axis, None] - shift[transform, :, axis] for axis in range(3))
    r = rotation.transpose(2, 3, 0, 1)
    return np.stack(
        [x * r[0, i][transform] + y * r[1, i][transform] + z * r[2, i][transform] for i in range(3)]
    )


def _blocks(sizes: IndexArray) -> Iterator[slice]:
    """Blocks of items whose sizes add up to at most `ENTRIES`, if more than one."""
    total, start = np.cumsum(sizes), 0
    while start < len(sizes):
        done = total[start - 1] if start else 0
        stop = max(int(np.searchsorted(total, done + ENTRIES, side="right")), start + 1)
        yield slice(start, stop)
        start = stop
