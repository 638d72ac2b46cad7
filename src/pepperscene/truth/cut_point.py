"""Attachment and cut point of a fruit's stalk, and the approach of a tool to the fruit.

Growers cut or break the stalk at its natural abscission zone next to the stem and leave all of it on the
fruit: a wound there is small, while stumps and ragged ends go mouldy, and a complete stalk keeps the fruit
fresh and is paid for (freshknowledge.eu, "Moulds" of pepper: mould grows above all where the stem is not cut
at its natural breaking knot; Sa et al. 2017, "Peduncle detection of sweet pepper for autonomous crop
harvesting", section I). On a stem that is the furrow above the stalk's collar. A stalk that grows on another
fruit stalk, as a tomato's pedicel on its truss, breaks at the joint half-way along it.

The blossom end of a fruit: the point of its skin opposite the stalk.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

_FURROW: Final = 1.8
"""Distance from the stalk's base to the furrow over the collar's size, which is the stalk's radius but at
most `_COLLAR` of its length, as modelled by `geometry.tubes.stalk.peduncles`; a test compares the two."""
_COLLAR: Final = 0.12
_CLEARANCE: Final = 1.0  # chosen: radii of stalk between its parent and the cut, space for a blade
_JOINT: Final = 0.5  # chosen: fraction of a pedicel's free length at which it breaks
_LATEST: Final = 0.5  # chosen: no cut is beyond this fraction of the free length
_MIN_DISTANCE: Final = 1e-3  # chosen: metres between fruit and stem axis below which no side is in front


@dataclass(frozen=True, eq=False)
class FruitStalk:
    """The stalk that a fruit is harvested with, in world metres."""

    instance: int  # index of the stalk
    parent: int  # index of the organ that it grows on; -1 for none
    radius_m: float  # radius of the stalk above its collar
    curve: FloatArray  # `(k, 3)` its centreline, from where it emerges from its parent to the fruit's calyx
    length_m: float  # length of that curve
    cut: FloatArray  # `(3,)` cut point, on the centreline
    tangent: FloatArray  # `(3,)` unit tangent there, towards the fruit; the cut is perpendicular to it

    @property
    def attachment(self) -> FloatArray:
        """`(3,)` where the centreline emerges from the stalk's parent."""
        return self.curve[0]

    def moved(self, motion: FloatArray) -> FruitStalk:
        """The stalk after a motion `(4, 4)`."""
        rotation, shift = motion[:3, :3], motion[:3, 3]
        curve, cut = self.curve @ rotation.T + shift, rotation @ self.cut + shift
        return replace(self, curve=curve, cut=cut, tangent=rotation @ self.tangent)


def fruit_stalk(
    line: FloatArray,
    radius_m: float,
    parent: tuple[FloatArray, float, float] | None,
    *,
    instance: int = -1,
    parent_instance: int = -1,
    on_stalk: bool = False,
) -> FruitStalk:
    """Locate attachment and cut point of a fruit's stalk.

    Args:
        line: `(m, 3)` its centreline from base to calyx, densely sampled.
        radius_m: radius of the stalk above its collar.
        parent: centreline `(k, 3)` of the organ that it grows on, and the radii at both ends; None for none.
        instance: index of the stalk.
        parent_instance: index of that organ.
        on_stalk: whether that organ is another fruit stalk.
    """
    arc = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1)))
    start = 0.0 if parent is None else _emergence(line, arc, *parent)
    free_length = arc[-1] - start
    if on_stalk:
        cut = start + _JOINT * free_length
    else:
        furrow = _FURROW * min(radius_m, _COLLAR * arc[-1])
        cut = min(max(furrow, start + _CLEARANCE * radius_m), start + _LATEST * free_length)
    curve = np.vstack([_point_at(line, arc, start), line[arc > start + 1e-9]])
    # The tangent is that of the chord from a radius before the cut to a radius behind it.
    before, behind = max(cut - radius_m, 0.0), min(cut + radius_m, arc[-1])
    chord = _point_at(line, arc, behind) - _point_at(line, arc, before)
    tangent = np.asarray(chord / np.linalg.norm(chord))
    point = _point_at(line, arc, cut)
    return FruitStalk(instance, parent_instance, radius_m, curve, float(free_length), point, tangent)


def _point_at(line: FloatArray, arc: FloatArray, distance: float) -> FloatArray:
    """`(3,)` the point at a distance along a polyline."""
    return np.array([np.interp(distance, arc, axis) for axis in line.T])


def _emergence(line: FloatArray, arc: FloatArray, axis: FloatArray, first: float, last: float) -> float:
    """Distance along a centreline to where it leaves a tapered tube; 0 if it starts outside."""
    # Distance of each point from the axis, and the tube's radius at the nearest point of the axis.
    step = np.diff(axis, axis=0)
    squared = np.maximum(np.einsum("ki,ki->k", step, step), 1e-18)
    from_start = line[:, None] - axis[None, :-1]
    fraction = np.clip(np.einsum("nki,ki->nk", from_start, step) / squared, 0.0, 1.0)
    distance = np.linalg.norm(from_start - fraction[..., None] * step, axis=2)
    nearest = distance.argmin(axis=1)
    row = np.arange(len(line))
    axis_arc = np.append(0.0, np.cumsum(np.sqrt(squared)))
    along = axis_arc[nearest] + fraction[row, nearest] * np.sqrt(squared)[nearest]
    radius = first + (last - first) * along / axis_arc[-1]

    outside = distance[row, nearest] - radius
    emerged = np.flatnonzero(outside >= 0.0)
    if not emerged.size or emerged[0] == 0:
        return 0.0
    # Between two points the distance is nearly linear.
    after = int(emerged[0])
    below, above = outside[after - 1 : after + 1]
    return float(arc[after - 1] + (arc[after] - arc[after - 1]) * below / (below - above))


@dataclass(frozen=True, eq=False)
class Approach:
    """The horizontal approach of a harvest tool to a fruit, with the stem right behind it.

    The harvest robots of Wageningen reach for a sweet pepper in the horizontal plane, on the line through the
    centres of fruit and stem, so the cutter passes between the two. Barth, Hemming & van Henten 2019 ("Angle
    estimation between plant parts for grasp optimisation in harvest robots", Biosystems Engineering 183,
    26-46) estimate that angle between fruit and stem from colour images; their tool tolerates 25 degrees.

    Attributes:
        direction: `(3,)` horizontal unit vector of the tool's motion, from the fruit's centre to the stem.
        stem: `(3,)` world metres, the stem's centre at the fruit's height.
    """

    direction: FloatArray
    stem: FloatArray

    def azimuth(self, pose: FloatArray) -> float:
        """Radians from a camera's optical axis to the direction, both seen from above; positive to its right.

        0 if the camera looks at the fruit with the stem behind it. For a camera that looks straight up or
        down, the upper side of its image replaces the axis.
        """
        forward = pose[:3, 2] if np.hypot(*pose[:2, 2]) > 1e-6 else -pose[:3, 1]
        cross = forward[0] * self.direction[1] - forward[1] * self.direction[0]
        return float(-np.arctan2(cross, forward[:2] @ self.direction[:2]))


def tool_approach(centre: FloatArray, stem: FloatArray) -> Approach | None:
    """The approach to a fruit; None if its centre is on the stem's axis.

    Args:
        centre: `(3,)` of the fruit, world metres.
        stem: `(k, 3)` axis of the plant's main stem from the ground up.
    """
    point = _at_height(stem, centre)
    horizontal = (point - centre) * [1.0, 1.0, 0.0]
    distance = float(np.linalg.norm(horizontal))
    return Approach(horizontal / distance, point) if distance > _MIN_DISTANCE else None


def _at_height(line: FloatArray, centre: FloatArray) -> FloatArray:
    """`(3,)` the nearest point of a polyline at the height of a point; else the end nearest in height."""
    low, high = line[:-1], line[1:]
    rise = high[:, 2] - low[:, 2]
    fraction = (centre[2] - low[:, 2]) / np.where(rise == 0.0, np.inf, rise)
    crossing = np.flatnonzero((fraction >= 0.0) & (fraction <= 1.0) & (rise != 0.0))
    if not crossing.size:
        ends = line[[0, -1]]
        return np.asarray(ends[np.abs(ends[:, 2] - centre[2]).argmin()])
    points = low[crossing] + fraction[crossing, None] * (high - low)[crossing]
    return np.asarray(points[np.linalg.norm((points - centre)[:, :2], axis=1).argmin()])


def blossom_end(points: FloatArray, faces: NDArray[np.integer], v: NDArray[np.floating]) -> FloatArray:
    """Locate the blossom end on the triangles of a fruit.

    A modelled fruit has a vertex there, the only one with the surface coordinate v = 1; the axis of a bent
    fruit leaves it elsewhere. On a scan, it is the last point of the skin on the axis.

    Args:
        points: `(n, 3)` vertices in the fruit's axes, metres: the stalk end at 0, z along the axis.
        faces: `(f, 3)` their triangles.
        v: `(n,)` surface coordinate, from 0 at the stalk end to 1 at the blossom end.

    Returns:
        `(3,)` metres, in the same axes. If the axis misses the skin, the vertex farthest along it.
    """
    poles = np.flatnonzero(v == 1.0)
    if poles.size:
        return np.asarray(points[poles[0]], dtype=float)
    crossings = _axis_crossings(points[faces])
    if crossings.size:
        return np.array([0.0, 0.0, crossings.max()])
    return np.asarray(points[points[:, 2].argmax()], dtype=float)


def _axis_crossings(triangles: FloatArray) -> FloatArray:
    """`(k,)` z of the points where triangles `(f, 3, 3)` meet the z axis."""
    x, y = triangles[..., 0], triangles[..., 1]
    # Twice the areas of the triangles that the axis makes with each side, seen along the axis.
    following = np.roll(np.arange(3), -1)
    areas = x[:, following] * y[:, following[following]] - x[:, following[following]] * y[:, following]
    total = areas.sum(axis=1)
    inside = ((areas >= 0.0).all(axis=1) | (areas <= 0.0).all(axis=1)) & (total != 0.0)
    return np.einsum("fk,fk->f", areas[inside], triangles[inside, :, 2]) / total[inside]
