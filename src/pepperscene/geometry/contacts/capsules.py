"""Penetration depth of points in stems and twine, as chains of capsules."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np

from pepperscene.geometry import compilation
from pepperscene.geometry.contacts.organs import Organs
from pepperscene.geometry.contacts.patches import Patches, expand_counts
from pepperscene.geometry.mesh import FloatArray, IndexArray, SingleArray

_PIECE: Final = 0.01  # m, chosen: stems bend so little that straight pieces of about this length are close


@dataclass(frozen=True, eq=False)
class Capsules:
    """Cylinders with hemispherical ends."""

    start: FloatArray  # `(c, 3)` metres
    span: FloatArray  # `(c, 3)` metres, from start to end
    radius: FloatArray  # `(c,)` metres

    @cached_property
    def low(self) -> FloatArray:
        """`(c, 3)` metres, lower corners of the bounding boxes."""
        return np.asarray(np.minimum(self.start, self.start + self.span) - self.radius[:, None])

    @cached_property
    def high(self) -> FloatArray:
        """`(c, 3)` metres, upper corners of the bounding boxes."""
        return np.asarray(np.maximum(self.start, self.start + self.span) + self.radius[:, None])

    def select(self, indices: IndexArray) -> Capsules:
        """Some of the capsules."""
        return Capsules(self.start[indices], self.span[indices], self.radius[indices])

    def depth(self, points: SingleArray, capsule: IndexArray) -> SingleArray:
        """`(h,)` metres: depth of the deepest point of each patch `(3, s, h)` in capsules `(h,)`."""
        start, span = self.start.T.astype(np.float32)[:, capsule], self.span.T.astype(np.float32)[:, capsule]
        square = np.maximum(_squares(span), np.float32(1e-12))
        offset = points - start[:, None]
        along = offset[0] * span[0] + offset[1] * span[1] + offset[2] * span[2]
        along = np.clip(along / square, 0.0, 1.0)
        nearest = np.zeros_like(along)
        for axis in range(3):
            across = offset[axis] - along * span[axis]
            nearest += across * across
        return np.asarray(self.radius.astype(np.float32)[capsule] - np.sqrt(nearest.min(axis=0)))

    def patch_depths(
        self, patches: Patches, patch: IndexArray, capsule: IndexArray, stride: int = 1
    ) -> SingleArray:
        """`(m,)` metres: depth of the deepest point of patches `(m,)` in capsules `(m,)`, by some points."""
        if not compilation.AVAILABLE:
            return self.depth(patches.coordinates(patch, stride), capsule)
        from pepperscene.geometry.contacts.depth_kernel import depths_in_capsules

        start, span = self.start.astype(np.float32), self.span.astype(np.float32)
        square = np.maximum(_squares(span.T), np.float32(1e-12))
        points = patches.points.transpose(2, 0, 1)
        return depths_in_capsules(
            start, span, square, self.radius.astype(np.float32), capsule, points, patch, stride
        )


def _squares(vectors: SingleArray) -> SingleArray:
    """`(n,)` squared lengths of `(3, n)` vectors."""
    x, y, z = vectors
    return np.asarray(x * x + y * y + z * z)


class StemCapsules:
    """The capsules of stems and twine, which never move, computed on first use."""

    def __init__(self, organs: Organs) -> None:
        self._organs = organs
        self._first = np.zeros(len(organs), dtype=np.intp)
        self._count = np.full(len(organs), -1)
        self._capsules = Capsules(np.empty((0, 3)), np.empty((0, 3)), np.empty(0))

    def of_tubes(self, tubes: IndexArray) -> tuple[Capsules, IndexArray, IndexArray]:
        """All capsules so far, `(m,)` indices of those of some tubes, and `(m,)` positions of their tube."""
        missing = np.unique(tubes[self._count[tubes] < 0])
        if len(missing):
            old = self._capsules
            new, count = _tube_capsules(self._organs, missing.tolist())
            self._first[missing] = len(old.radius) + np.cumsum(count) - count
            self._count[missing] = count
            self._capsules = Capsules(
                np.concatenate([old.start, new.start]),
                np.concatenate([old.span, new.span]),
                np.concatenate([old.radius, new.radius]),
            )
        position, number = expand_counts(self._count[tubes])
        return self._capsules, self._first[tubes][position] + number, position


def _tube_capsules(organs: Organs, tubes: Sequence[int]) -> tuple[Capsules, IndexArray]:
    """Capsules of tubes, each as thick as the wider of the rings at its ends, and `(t,)` their numbers."""
    vertices = [
        organs.original_vertices(tube) @ organs.rotation[tube].T + organs.shift[tube] for tube in tubes
    ]
    owner = np.repeat(np.arange(len(tubes)), [len(group) for group in vertices])
    points = np.concatenate(vertices)
    # The vertices of a ring follow one another and have the same v; along twine v repeats.
    v = np.round(np.concatenate([organs.vertex_v(tube) for tube in tubes]).astype(np.float64) * 1e5)
    starts_ring = (np.diff(v, prepend=-1.0) != 0.0) | (np.diff(owner, prepend=-1) != 0)
    ring = np.cumsum(starts_ring) - 1
    tube_of = owner[starts_ring]
    number = np.bincount(ring)
    centre = np.stack([np.bincount(ring, column) for column in points.T], axis=1) / number[:, None]
    radius = np.zeros(len(tube_of))
    np.maximum.at(radius, ring, np.sqrt(np.square(points - centre[ring]).sum(axis=1)))
    # A piece starts at the first ring of each centimetre, and ends where the next starts or at the last ring.
    first = np.searchsorted(tube_of, np.arange(len(tubes)))
    last = np.append(first[1:], len(tube_of)) - 1
    steps = np.sqrt(np.square(np.diff(centre, axis=0, prepend=centre[:1])).sum(axis=1))
    steps[first] = 0.0
    along = np.cumsum(steps)
    along -= along[first][tube_of]
    starts = np.diff(np.floor(along / _PIECE), prepend=-1.0) > 0.0
    starts[first] = True
    starts[last] = False
    starts[first[first == last]] = True
    start = np.flatnonzero(starts)
    end = np.minimum(np.append(start[1:], len(tube_of)), last[tube_of[start]])
    widest = np.maximum(np.maximum.reduceat(radius, start), radius[end])
    capsules = Capsules(centre[start], centre[end] - centre[start], widest)
    return capsules, np.bincount(tube_of[start], minlength=len(tubes))
