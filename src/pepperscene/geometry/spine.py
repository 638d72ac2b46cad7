"""Spines of tubes, blades and petals: smooth centrelines with a minimally rotating frame, many at once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from pepperscene.geometry.mesh import FloatArray
from pepperscene.grammar.frames import cross
from pepperscene.grammar.plant import Organ

_CHORDS: Final = 8  # chosen: straight chords per cubic piece while its length is measured


@dataclass(frozen=True, eq=False)
class Spines:
    """Smooth curves of n organs at m equal steps, with a right-handed frame at every step."""

    points: FloatArray  # `(n, m, 3)` metres
    normals: FloatArray  # `(n, m, 3)` unit vectors to the organ's upper side
    binormals: FloatArray  # `(n, m, 3)` tangent x normal: right when looking along the curve, upper side up
    lengths: FloatArray  # `(n,)` metres

    def place(self, along: FloatArray, right: FloatArray, up: FloatArray) -> FloatArray:
        """Convert `(n, q)` curve coordinates along, binormal and normal to `(n, q, 3)` points, in metres.

        Beyond either end the curve continues straight.
        """
        point, normal, binormal = self.frames(along)
        return point + right[..., None] * binormal + up[..., None] * normal

    def frames(self, along: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Interpolate points, normals and binormals, `(n, q, 3)` each, at `(n, q)` metres from the base."""
        steps = self.points.shape[1] - 1
        position = along * (steps / self.lengths)[:, None]
        index = np.clip(np.floor(position), 0, steps - 1).astype(np.intp)
        fraction = (position - index)[..., None]
        start = index + (steps + 1) * np.arange(len(self.points))[:, None]

        def ends(values: FloatArray) -> tuple[FloatArray, FloatArray]:
            flat = values.reshape(-1, 3)
            return flat.take(start, axis=0), flat.take(start + 1, axis=0)

        before, after = ends(self.points)
        point = before + fraction * (after - before)
        fraction = np.clip(fraction, 0.0, 1.0)
        normal, binormal = (
            normalize(before * (1.0 - fraction) + after * fraction)
            for before, after in (ends(self.normals), ends(self.binormals))
        )
        return point, normal, binormal


def normalize(vectors: FloatArray) -> FloatArray:
    """Scale `(..., 3)` vectors to length 1; zero vectors stay zero."""
    length = np.sqrt(np.einsum("...i,...i->...", vectors, vectors))[..., None]
    return vectors / np.where(length > 0.0, length, 1.0)


def perpendicular(axis: FloatArray, preferred: FloatArray) -> FloatArray:
    """`(n, 3)` unit vectors across unit axes, as near to the preferred directions as possible.

    If the preferred direction is parallel to the axis, any perpendicular is returned.
    """
    side = preferred - np.sum(preferred * axis, axis=1, keepdims=True) * axis
    fallback = cross(axis, np.eye(3)[np.argmin(np.abs(axis), axis=1)])
    return normalize(np.where(np.linalg.norm(side, axis=1, keepdims=True) > 1e-6, side, fallback))


def organ_spines(organs: Sequence[Organ], steps: int) -> Spines:
    """Build the spines of organs from their curves and upper sides."""
    return spines([organ.curve for organ in organs], [organ.up for organ in organs], steps)


def spines(
    curves: Sequence[FloatArray], ups: Sequence[FloatArray], steps: int, twist: FloatArray | None = None
) -> Spines:
    """Smooth centrelines and carry a frame along each.

    The curve through the points is a cubic Hermite spline with chord-length knots; the frame follows by
    double reflection (Wang, Juettler, Zheng & Liu 2008, "Computation of rotation minimizing frames").

    Args:
        curves: n centrelines `(k, 3)` in metres, k >= 2; k may differ between them.
        ups: n vectors `(3,)` towards the upper side at the base.
        steps: equal pieces of each curve.
        twist: `(n,)` radians by which the frame at the tip is rotated about the tangent, right-handed.

    Raises:
        ValueError: a curve has fewer than two distinct points.
    """
    points = np.empty((len(curves), steps + 1, 3))
    lengths = np.empty(len(curves))
    sizes = np.array([len(curve) for curve in curves])
    for size in np.unique(sizes):
        rows = np.flatnonzero(sizes == size)
        group = np.stack([np.asarray(curves[int(row)], dtype=np.float64) for row in rows])
        points[rows], lengths[rows] = _smooth(group, steps)
    tangents = _tangents(points)
    normals = _transport_normals(points, tangents, normalize(np.array(ups, dtype=float)))
    binormals = cross(tangents, normals)
    if twist is not None:
        # The twist grows linearly from zero at the base.
        angle = (twist[:, None] * np.linspace(0.0, 1.0, steps + 1))[..., None]
        normals, binormals = (
            np.cos(angle) * normals + np.sin(angle) * binormals,
            np.cos(angle) * binormals - np.sin(angle) * normals,
        )
    return Spines(points, normals, binormals, lengths)


def _smooth(curves: FloatArray, steps: int) -> tuple[FloatArray, FloatArray]:
    """`(n, steps + 1, 3)` equidistant points on smooth curves through `(n, k, 3)` points, and the lengths."""
    n, k, _ = curves.shape
    chord = np.linalg.norm(np.diff(curves, axis=1), axis=2) if k > 1 else np.zeros((n, 0))
    if k < 2 or not np.all(chord.sum(axis=1) > 0.0):
        raise ValueError("a centreline needs at least two distinct points")
    if k == 2:
        fraction = np.linspace(0.0, 1.0, steps + 1)[:, None]
        return curves[:, :1] + fraction * (curves[:, 1:] - curves[:, :1]), chord[:, 0]
    # Slopes at the points: those of the parabola through each point and its two neighbours.
    chord = np.maximum(chord, 1e-6 * chord.sum(axis=1, keepdims=True))[..., None]
    secant = np.diff(curves, axis=1) / chord
    inner = (secant[:, :-1] * chord[:, 1:] + secant[:, 1:] * chord[:, :-1]) / (chord[:, :-1] + chord[:, 1:])
    first, last = 2.0 * secant[:, :1] - inner[:, :1], 2.0 * secant[:, -1:] - inner[:, -1:]
    slope = np.concatenate([first, inner, last], axis=1)
    # A cubic Hermite piece between neighbouring points, cut into short chords.
    t = (np.arange(_CHORDS) / _CHORDS)[:, None]
    start, end, size = curves[:, :-1, None], curves[:, 1:, None], chord[:, :, None]
    fine = (
        (2 * t**3 - 3 * t**2 + 1) * start
        + (3 * t**2 - 2 * t**3) * end
        + size * ((t**3 - 2 * t**2 + t) * slope[:, :-1, None] + (t**3 - t**2) * slope[:, 1:, None])
    ).reshape(n, -1, 3)
    fine = np.concatenate([fine, curves[:, -1:]], axis=1)
    distance = np.concatenate(
        [np.zeros((n, 1)), np.cumsum(np.linalg.norm(np.diff(fine, axis=1), axis=2), axis=1)], axis=1
    )
    return _resample(fine, distance, steps), distance[:, -1]


def _resample(points: FloatArray, distance: FloatArray, steps: int) -> FloatArray:
    """`(n, steps + 1, 3)` equidistant points on polylines `(n, q, 3)` with arc lengths `(n, q)`."""
    n, count, _ = points.shape
    # One search for all rows on a common scale, where row i covers 2 i to 2 i + 1.
    row, target = np.arange(n)[:, None], np.linspace(0.0, 1.0, steps + 1)
    scale = distance / distance[:, -1:]
    index = np.searchsorted((scale + 2.0 * row).ravel(), (target + 2.0 * row).ravel(), side="right")
    first = np.clip(index.reshape(n, -1) - 1 - count * row, 0, count - 2)
    start, end = scale[row, first], scale[row, first + 1]
    fraction = np.clip((target - start) / np.where(end > start, end - start, 1.0), 0.0, 1.0)[..., None]
    return points[row, first] * (1.0 - fraction) + points[row, first + 1] * fraction


def _tangents(points: FloatArray) -> FloatArray:
    """Unit tangents of evenly spaced points: second-order differences, one-sided at the ends."""
    difference = np.diff(points, axis=1)
    middle = 0.5 * (difference[:, :-1] + difference[:, 1:])
    if middle.shape[1] == 0:
        return normalize(np.repeat(difference, 2, axis=1))
    first, last = 2.0 * difference[:, :1] - middle[:, :1], 2.0 * difference[:, -1:] - middle[:, -1:]
    return normalize(np.concatenate([first, middle, last], axis=1))


def _transport_normals(points: FloatArray, tangents: FloatArray, up: FloatArray) -> FloatArray:
    """Unit normals that start at `up`, made perpendicular, and follow the curve with minimal rotation."""
    normal = perpendicular(tangents[:, 0], up)
    normals = np.empty_like(points)
    normals[:, 0] = normal
    # Reflect in the bisector plane of neighbouring points, then in that of reflected and next tangents.
    chords = _mirrors(np.diff(points, axis=1))
    bisectors = _mirrors(tangents[:, 1:] - _reflect(tangents[:, :-1], chords))
    for step in range(points.shape[1] - 1):
        normal = _reflect(_reflect(normal, chords[:, step]), bisectors[:, step])
        normals[:, step + 1] = normal
    # Remove the component along the tangent that rounding has added.
    return normalize(normals - np.einsum("nmi,nmi->nm", normals, tangents)[..., None] * tangents)


def _mirrors(normals: FloatArray) -> FloatArray:
    """Mirror normals at length sqrt(2), as `_reflect` needs them; zero vectors stay zero."""
    return np.asarray(np.sqrt(2.0) * normalize(normals))


def _reflect(vectors: FloatArray, mirrors: FloatArray) -> FloatArray:
    """The vectors mirrored in the planes through the origin with normals `mirrors`."""
    return np.asarray(vectors - np.einsum("...i,...i->...", vectors, mirrors)[..., None] * mirrors)
