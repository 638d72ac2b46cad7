"""How deep points lie inside stems and cords: these are chains of capsules."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.geometry.contact_organs import Organs, Points, Vectors

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

    def box(self) -> tuple[Points, Points]:
        """The corners `(3,)` and `(3,)` of the box around all of them."""
        end, wide = self.start + self.span, self.radius[:, None]
        low, high = np.minimum(self.start, end) - wide, np.maximum(self.start, end) + wide
        return low.min(axis=0).astype(np.float32), high.max(axis=0).astype(np.float32)

    def near(self, low: Vectors, high: Vectors) -> Capsules:
        """Those whose boxes meet a box with the corners `(3,)` and `(3,)`."""
        end, wide = self.start + self.span, self.radius[:, None]
        kept = np.all(np.minimum(self.start, end) - wide < high, axis=1)
        kept &= np.all(np.maximum(self.start, end) + wide > low, axis=1)
        return Capsules(self.start[kept], self.span[kept], self.radius[kept])

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


def capsules(organs: Organs, tube: int) -> Capsules:
    """A tube as it stands; each piece is as thick as the wider of the rings at its ends."""
    # The vertices of one ring stand equally far along the tube.
    place, ring = np.unique(np.round(organs.along(tube) * 1e5), return_inverse=True)
    rotation, shift = organs.pose(tube)
    vertices = organs.vertices(tube) @ rotation.T + shift
    number = np.bincount(ring)
    centre = np.stack([np.bincount(ring, column) for column in vertices.T], axis=1) / number[:, None]
    radius = np.zeros(len(place))
    np.maximum.at(radius, ring, np.linalg.norm(vertices - centre[ring], axis=1))
    if len(place) < 2:
        centre, radius = centre.repeat(2, axis=0), radius.repeat(2)
    # Rings close together make one piece.
    walked = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(centre, axis=0), axis=1))])
    first = np.unique(np.searchsorted(walked[:-1], np.arange(0.0, walked[-1], _PIECE)))
    first = first[first < len(walked) - 1]
    ends = np.append(first, len(walked) - 1)
    widest = np.maximum(np.maximum.reduceat(radius, first), radius[ends[1:]])
    return Capsules(centre[first], np.diff(centre[ends], axis=0), widest)


def joined(parts: list[Capsules]) -> Capsules:
    """All of some chains."""
    return Capsules(
        np.concatenate([part.start for part in parts]),
        np.concatenate([part.span for part in parts]),
        np.concatenate([part.radius for part in parts]),
    )
