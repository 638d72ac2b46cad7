"""How deep points lie inside stems and cords: these are chains of capsules."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.geometry.contacts.organs import Organs, Points, Vectors
from pepperscene.geometry.contacts.samples import counted

_PIECE: Final = 0.01  # m, chosen: stems bend so little that pieces of about this length stand for them


@dataclass(frozen=True, eq=False)
class Capsules:
    """Balls drawn out along straight lines.

    Attributes:
        start: `(c, 3)` metres.
        span: `(c, 3)` metres, from start to end.
        radius: `(c,)` metres.
    """

    start: Vectors
    span: Vectors
    radius: NDArray[np.float64]

    @cached_property
    def low(self) -> Vectors:
        """`(c, 3)` metres, the lower corners of the boxes around them, and"""
        return np.asarray(np.minimum(self.start, self.start + self.span) - self.radius[:, None])

    @cached_property
    def high(self) -> Vectors:
        """`(c, 3)` the upper ones."""
        return np.asarray(np.maximum(self.start, self.start + self.span) + self.radius[:, None])

    def some(self, which: NDArray[np.intp]) -> Capsules:
        """Some of them."""
        return Capsules(self.start[which], self.span[which], self.radius[which])

    def depth(self, points: Points) -> NDArray[np.float32]:
        """`(..., c)` metres that points `(..., 3)` lie inside each capsule; negative outside."""
        origin = self.start.mean(axis=0)
        start, span = (self.start - origin).astype(np.float32), self.span.astype(np.float32)
        points = points - origin.astype(np.float32)
        square = np.maximum(np.einsum("ci,ci->c", span, span), np.float32(1e-12))
        # |p - s - t d|^2 written out, so that only (..., c) arrays are made.
        along = points @ span.T - np.einsum("ci,ci->c", start, span)
        t = np.clip(along / square, 0.0, 1.0)
        off = np.einsum("...i,...i->...", points, points)[..., None] - 2.0 * points @ start.T
        off += np.einsum("ci,ci->c", start, start) - t * (2.0 * along - t * square)
        return np.asarray(self.radius.astype(np.float32) - np.sqrt(np.maximum(off, 0.0)))


def deepest(points: Points, chain: Capsules, which: NDArray[np.intp]) -> NDArray[np.float32]:
    """`(h,)` metres that the deepest point of each patch `(3, s, h)` lies inside one capsule of a chain."""
    start, span = chain.start.T.astype(np.float32)[:, which], chain.span.T.astype(np.float32)[:, which]
    square = np.maximum(np.einsum("ih,ih->h", span, span), np.float32(1e-12))
    off = points - start[:, None]
    along = off[0] * span[0] + off[1] * span[1] + off[2] * span[2]
    along = np.clip(along / square, 0.0, 1.0)
    nearest = np.zeros_like(along)
    for axis in range(3):
        beside = off[axis] - along * span[axis]
        nearest += beside * beside
    return np.asarray(chain.radius.astype(np.float32)[which] - np.sqrt(nearest.min(axis=0)))


def capsules(organs: Organs, tube: int) -> Capsules:
    """A tube as it stands; each piece is as thick as the wider of the rings at its ends."""
    return chains(organs, [tube])[0]


def chains(organs: Organs, tubes: Sequence[int]) -> list[Capsules]:
    """Each of some tubes as it stands."""
    vertices = [organs.vertices(tube) @ pose[0].T + pose[1] for tube in tubes for pose in [organs.pose(tube)]]
    owner = np.repeat(np.arange(len(tubes)), [len(one) for one in vertices])
    points = np.concatenate(vertices)
    # The vertices of one ring stand equally far along the tube.
    along = np.round(np.concatenate([organs.along(tube) for tube in tubes]).astype(np.float64) * 1e5)
    key, ring = np.unique(owner * 2**20 + along.astype(np.int64), return_inverse=True)
    tube_of = key >> 20
    number = np.bincount(ring)
    centre = np.stack([np.bincount(ring, column) for column in points.T], axis=1) / number[:, None]
    radius = np.zeros(len(key))
    np.maximum.at(radius, ring, np.sqrt(np.square(points - centre[ring]).sum(axis=1)))
    # Rings close together make one piece: the first ring of each centimetre, and the last of the tube.
    first = np.searchsorted(tube_of, np.arange(len(tubes)))
    last = np.append(first[1:], len(key)) - 1
    steps = np.sqrt(np.square(np.diff(centre, axis=0, prepend=centre[:1])).sum(axis=1))
    steps[first] = 0.0
    walked = np.cumsum(steps)
    walked -= walked[first][tube_of]
    begins = np.diff(np.floor(walked / _PIECE), prepend=-1.0) > 0.0
    begins[first] = True
    begins[last] = False
    lone = first[first == last]
    begins[lone] = True
    start = np.flatnonzero(begins)
    # Each piece ends where the next of its tube starts, or at the last ring.
    end = np.minimum(np.append(start[1:], len(key)), last[tube_of[start]])
    widest = np.maximum(np.maximum.reduceat(radius, start), radius[end])
    origin, span, stops = (
        centre[start],
        centre[end] - centre[start],
        np.searchsorted(tube_of[start], np.arange(len(tubes) + 1)),
    )
    return [
        Capsules(origin[one:other], span[one:other], widest[one:other])
        for one, other in pairwise(stops.tolist())
    ]


class Chains:
    """The capsules of many stems and cords, which never move, made when first asked for.

    Args:
        organs: of a mesh.
    """

    def __init__(self, organs: Organs) -> None:
        self._organs = organs
        self._first = np.zeros(len(organs), dtype=np.intp)
        self._count = np.full(len(organs), -1)
        self._made = Capsules(np.empty((0, 3)), np.empty((0, 3)), np.empty(0))

    def pieces(self, tubes: NDArray[np.intp]) -> tuple[Capsules, NDArray[np.intp], NDArray[np.intp]]:
        """All capsules made so far, `(m,)` those of some tubes, and `(m,)` the place of each one's tube."""
        missing = np.unique(tubes[self._count[tubes] < 0])
        if len(missing):
            made = chains(self._organs, missing.tolist())
            count = np.array([len(one.radius) for one in made])
            self._first[missing] = len(self._made.radius) + np.cumsum(count) - count
            self._count[missing] = count
            self._made = joined([self._made, *made])
        place, number = counted(self._count[tubes])
        return self._made, self._first[tubes][place] + number, place


def joined(parts: list[Capsules]) -> Capsules:
    """All of some chains."""
    return Capsules(
        np.concatenate([part.start for part in parts]),
        np.concatenate([part.span for part in parts]),
        np.concatenate([part.radius for part in parts]),
    )
