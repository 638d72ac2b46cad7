"""Centrelines with frames that turn no more than they must, for many organs at once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

_STEPS = 8  # chosen: straight pieces that stand for one smooth piece of a curve while its length is measured


@dataclass(frozen=True, eq=False)
class Spines:
    """Smooth curves of n organs at m equal steps along each, with a right-handed frame at every step.

    Attributes:
        points: `(n, m, 3)` metres.
        normals: `(n, m, 3)` the organ's upper side.
        across: `(n, m, 3)` tangent x normal: to the right of one who looks along the curve, upper side up.
        lengths: `(n,)` metres.
    """

    points: NDArray[np.float64]
    normals: NDArray[np.float64]
    across: NDArray[np.float64]
    lengths: NDArray[np.float64]

    def place(
        self, along: NDArray[np.float64], right: NDArray[np.float64], up: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """`(n, q, 3)` points that lie so far along, to the right of and above the curves.

        Args:
            along: `(n, q)` metres from the base; beyond either end the curve goes straight on.
            right: `(n, q)` metres.
            up: `(n, q)` metres.
        """
        point, normal, across = self.frames(along)
        return point + right[..., None] * across + up[..., None] * normal

    def frames(
        self, along: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """Points, normals and across, `(n, q, 3)` each, so far along the curves: `(n, q)` metres."""
        steps = self.points.shape[1] - 1
        position = along * (steps / self.lengths)[:, None]
        index = np.clip(np.floor(position), 0, steps - 1).astype(np.intp)
        part = (position - index)[..., None]
        here = np.arange(len(self.points))[:, None], index
        there = here[0], index + 1
        point = self.points[here] + part * (self.points[there] - self.points[here])
        part = np.clip(part, 0.0, 1.0)
        normal = unit(self.normals[here] * (1.0 - part) + self.normals[there] * part)
        across = unit(self.across[here] * (1.0 - part) + self.across[there] * part)
        return point, normal, across


def unit(vectors: NDArray[np.float64]) -> NDArray[np.float64]:
    """The vectors at length 1; those of no length stay zero."""
    length = np.sqrt(np.einsum("...i,...i->...", vectors, vectors))[..., None]
    return vectors / np.where(length > 0.0, length, 1.0)


def spines(
    curves: Sequence[NDArray[np.float64]],
    ups: Sequence[NDArray[np.float64]],
    steps: int,
    twist: NDArray[np.float64] | None = None,
) -> Spines:
    """Smooth the centrelines and carry a frame along each.

    The curve through the points is a cubic Hermite spline with chord-length knots; the frame is carried by
    double reflection (Wang, Juettler, Zheng & Liu 2008, "Computation of rotation minimizing frames").

    Args:
        curves: n centrelines `(k, 3)` in metres, k >= 2; k may differ between them.
        ups: n vectors `(3,)` that tell the upper side at the base.
        steps: pieces that each curve is cut into.
        twist: `(n,)` radians by which the frame at the tip is turned about the tangent, right-handed.

    Raises:
        ValueError: a curve has fewer than two distinct points.
    """
    points = np.empty((len(curves), steps + 1, 3))
    lengths = np.empty(len(curves))
    sizes = np.array([len(curve) for curve in curves])
    for size in np.unique(sizes):
        rows = np.flatnonzero(sizes == size)
        alike = np.stack([np.asarray(curves[int(row)], dtype=np.float64) for row in rows])
        points[rows], lengths[rows] = _even(alike, steps)
    tangents = _tangents(points)
    normals = _carried(points, tangents, unit(np.array(ups, dtype=float)))
    across = np.cross(tangents, normals)
    if twist is not None:
        # The twist grows evenly from nothing at the base.
        angle = (twist[:, None] * np.linspace(0.0, 1.0, steps + 1))[..., None]
        normals, across = (
            np.cos(angle) * normals + np.sin(angle) * across,
            np.cos(angle) * across - np.sin(angle) * normals,
        )
    return Spines(points, normals, across, lengths)


def _even(curves: NDArray[np.float64], steps: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """`(n, steps + 1, 3)` points at equal distances along smooth curves through `(n, k, 3)`; the lengths."""
    n, k, _ = curves.shape
    chord = np.linalg.norm(np.diff(curves, axis=1), axis=2) if k > 1 else np.zeros((n, 0))
    if k < 2 or not np.all(chord.sum(axis=1) > 0.0):
        raise ValueError("a centreline needs at least two distinct points")
    if k == 2:
        part = np.linspace(0.0, 1.0, steps + 1)[:, None]
        return curves[:, :1] + part * (curves[:, 1:] - curves[:, :1]), chord[:, 0]
    # Slopes at the points: the parabola through each point and its two neighbours.
    chord = np.maximum(chord, 1e-6 * chord.sum(axis=1, keepdims=True))[..., None]
    secant = np.diff(curves, axis=1) / chord
    inner = (secant[:, :-1] * chord[:, 1:] + secant[:, 1:] * chord[:, :-1]) / (chord[:, :-1] + chord[:, 1:])
    first, last = 2.0 * secant[:, :1] - inner[:, :1], 2.0 * secant[:, -1:] - inner[:, -1:]
    slope = np.concatenate([first, inner, last], axis=1)
    # A cubic on each piece, cut into short straight bits.
    t = (np.arange(_STEPS) / _STEPS)[:, None]
    start, end, size = curves[:, :-1, None], curves[:, 1:, None], chord[:, :, None]
    fine = (
        (2 * t**3 - 3 * t**2 + 1) * start
        + (3 * t**2 - 2 * t**3) * end
        + size * ((t**3 - 2 * t**2 + t) * slope[:, :-1, None] + (t**3 - t**2) * slope[:, 1:, None])
    ).reshape(n, -1, 3)
    fine = np.concatenate([fine, curves[:, -1:]], axis=1)
    walked = np.concatenate(
        [np.zeros((n, 1)), np.cumsum(np.linalg.norm(np.diff(fine, axis=1), axis=2), axis=1)], axis=1
    )
    return _resampled(fine, walked, steps), walked[:, -1]


def _resampled(points: NDArray[np.float64], walked: NDArray[np.float64], steps: int) -> NDArray[np.float64]:
    """`(n, steps + 1, 3)` points at equal distances on polylines `(n, q, 3)`, linear in `walked` `(n, q)`."""
    n, count, _ = points.shape
    # All rows are looked up at once on one scale, row i from 2 i to 2 i + 1.
    row, part = np.arange(n)[:, None], np.linspace(0.0, 1.0, steps + 1)
    scale = walked / walked[:, -1:]
    found = np.searchsorted((scale + 2.0 * row).ravel(), (part + 2.0 * row).ravel(), side="right")
    first = np.clip(found.reshape(n, -1) - 1 - count * row, 0, count - 2)
    start, end = scale[row, first], scale[row, first + 1]
    share = np.clip((part - start) / np.where(end > start, end - start, 1.0), 0.0, 1.0)[..., None]
    return points[row, first] * (1.0 - share) + points[row, first + 1] * share


def _tangents(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Unit tangents of evenly spaced points: second-order differences, one-sided at the ends."""
    difference = np.diff(points, axis=1)
    middle = 0.5 * (difference[:, :-1] + difference[:, 1:])
    if middle.shape[1] == 0:
        return unit(np.repeat(difference, 2, axis=1))
    first, last = 2.0 * difference[:, :1] - middle[:, :1], 2.0 * difference[:, -1:] - middle[:, -1:]
    return unit(np.concatenate([first, middle, last], axis=1))


def _carried(
    points: NDArray[np.float64], tangents: NDArray[np.float64], up: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Unit normals that start at `up`, made perpendicular, and follow the curve without needless turning."""
    # An upper side along the curve tells nothing; then any perpendicular will do.
    first = tangents[:, 0]
    normal = up - np.sum(up * first, axis=1, keepdims=True) * first
    useless = np.linalg.norm(normal, axis=1) < 1e-6
    other = np.cross(first, np.eye(3)[np.argmin(np.abs(first), axis=1)])
    normal = unit(np.where(useless[:, None], other, normal))
    normals = np.empty_like(points)
    normals[:, 0] = normal
    # What to reflect in: the planes between neighbouring points, then those between the tangents.
    chords = _mirrors(np.diff(points, axis=1))
    onto = _mirrors(tangents[:, 1:] - _reflected(tangents[:, :-1], chords))
    for step in range(points.shape[1] - 1):
        normal = _reflected(_reflected(normal, chords[:, step]), onto[:, step])
        normals[:, step + 1] = normal
    # Rounding must not make the frame skew.
    return unit(normals - np.einsum("nmi,nmi->nm", normals, tangents)[..., None] * tangents)


def _mirrors(across: NDArray[np.float64]) -> NDArray[np.float64]:
    """Normals of mirrors at length sqrt(2), as `_reflected` wants them; those of no length stay zero."""
    return np.asarray(np.sqrt(2.0) * unit(across))


def _reflected(vectors: NDArray[np.float64], mirrors: NDArray[np.float64]) -> NDArray[np.float64]:
    """The vectors mirrored in the planes through the origin with the normals `mirrors`."""
    return np.asarray(vectors - np.einsum("...i,...i->...", vectors, mirrors)[..., None] * mirrors)
