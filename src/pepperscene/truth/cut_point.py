"""Where a fruit's stalk joins the plant, and where it is cut.

Growers cut or break the stalk where it breaks by itself, at the abscission zone right by the stem, and leave
all of it on the fruit: a wound there is small, while stumps and ragged ends go mouldy, and a whole stalk
keeps the fruit fresh and is paid for (freshknowledge.eu, "Moulds" of pepper: mould grows above all where the
stem is not cut at its natural breaking knot; Sa et al. 2017, "Peduncle detection of sweet pepper for
autonomous crop harvesting", section I). On a stem that is the furrow above the stalk's collar. A stalk that
grows on another fruit stalk, as a tomato's pedicel on its truss, breaks at the joint half-way along it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

_FURROW: Final = 1.8
"""Metres from the stalk's base to the furrow per metre of its foot, as its body is shaped (see
`geometry.stalk.peduncles`; a test holds them together)."""
_FOOT: Final = 0.12  # of the stalk's length, which its foot is never longer than; likewise
_CLEAR: Final = 1.0  # chosen: radii of stalk between what bears it and the cut, so that a blade finds room
_JOINT: Final = 0.5  # chosen: share of a pedicel's free length at which it breaks
_LATEST: Final = 0.5  # chosen: share of the free length that no cut lies beyond


@dataclass(frozen=True, eq=False)
class FruitStalk:
    """The stalk that a fruit is harvested with, in world metres.

    Attributes:
        instance: index of the stalk.
        bearer: index of what it grows on; -1 for none.
        radius_m: of the stalk, above its foot.
        curve: `(k, 3)` its centreline, from where it joins the plant to the fruit's calyx.
        length_m: of that curve.
        cut: `(3,)` where it is cut, on the centreline.
        tangent: `(3,)` unit, of the centreline there, towards the fruit; the cut lies across it.
    """

    instance: int
    bearer: int
    radius_m: float
    curve: FloatArray
    length_m: float
    cut: FloatArray
    tangent: FloatArray

    @property
    def attachment(self) -> FloatArray:
        """`(3,)` where the centreline comes out of what bears the stalk."""
        return self.curve[0]


def fruit_stalk(
    line: FloatArray,
    radius_m: float,
    bearer: tuple[FloatArray, float, float] | None,
    *,
    instance: int = -1,
    bearer_instance: int = -1,
    on_stalk: bool = False,
) -> FruitStalk:
    """A fruit's stalk.

    Args:
        line: `(m, 3)` its centreline from base to calyx, closely spaced.
        radius_m: of the stalk above its foot.
        bearer: centreline `(k, 3)` of what it grows on, and the radii at both ends; None for nothing.
        instance: index of the stalk.
        bearer_instance: of what bears it.
        on_stalk: it grows on another fruit stalk.
    """
    along = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1)))
    start = 0.0 if bearer is None else _surface(line, along, *bearer)
    free = along[-1] - start
    if on_stalk:
        cut = start + _JOINT * free
    else:
        furrow = _FURROW * min(radius_m, _FOOT * along[-1])
        cut = min(max(furrow, start + _CLEAR * radius_m), start + _LATEST * free)
    # The centreline from there on.
    later = along > start + 1e-9
    curve = np.vstack([_at(line, along, start), line[later]])
    return FruitStalk(
        instance,
        bearer_instance,
        radius_m,
        curve,
        float(free),
        _at(line, along, cut),
        _direction(line, along, cut, radius_m),
    )


def _surface(line: FloatArray, along: FloatArray, axis: FloatArray, first: float, last: float) -> float:
    """How far along a centreline comes out of the body around an axis; 0 where it is outside at once."""
    away, radius = _from_axis(line, axis, first, last)
    out = np.flatnonzero(away >= radius)
    if not out.size:
        return 0.0
    step = int(out[0])
    if step == 0:
        return 0.0
    # Between two points the distance runs nearly straight.
    below, above = (away - radius)[step - 1 : step + 1]
    return float(along[step - 1] + (along[step] - along[step - 1]) * below / (below - above))


def _from_axis(
    points: FloatArray, axis: FloatArray, first: float, last: float
) -> tuple[FloatArray, FloatArray]:
    """`(n,)` distances of points from a polyline, and its radius at the nearest places."""
    step = np.diff(axis, axis=0)
    square = np.maximum(np.einsum("ki,ki->k", step, step), 1e-18)
    from_start = points[:, None] - axis[None, :-1]
    part = np.clip(np.einsum("nki,ki->nk", from_start, step) / square, 0.0, 1.0)
    away = np.linalg.norm(from_start - part[..., None] * step, axis=2)
    nearest = away.argmin(axis=1)
    row = np.arange(len(points))
    length = np.append(0.0, np.cumsum(np.sqrt(square)))
    place = length[nearest] + part[row, nearest] * np.sqrt(square)[nearest]
    return away[row, nearest], first + (last - first) * place / length[-1]


def _at(line: FloatArray, along: FloatArray, place: float) -> FloatArray:
    """`(3,)` the point so far along a polyline."""
    return np.array([np.interp(place, along, axis) for axis in line.T])


def _direction(line: FloatArray, along: FloatArray, place: float, reach: float) -> FloatArray:
    """`(3,)` unit direction there, of the chord that reaches a radius to either side."""
    ahead, behind = min(place + reach, along[-1]), max(place - reach, 0.0)
    step = _at(line, along, ahead) - _at(line, along, behind)
    return np.asarray(step / np.linalg.norm(step))


_NEAREST: Final = 1e-3  # chosen: metres between fruit and stem axis below which no side is in front


@dataclass(frozen=True, eq=False)
class Approach:
    """The way to a fruit.

    Attributes:
        direction: `(3,)` horizontal unit vector in the world, the way that the tool moves: from the fruit's
            centre to the stem.
        stem: `(3,)` world metres, the stem's centre at the fruit's height.
    """

    direction: FloatArray
    stem: FloatArray

    def azimuth(self, pose: FloatArray) -> float:
        """Radians from a camera's optical axis to the direction, both seen from above; positive to its right.

        0 where the camera itself looks with the stem behind the fruit. For a camera that looks straight up or
        down, its upper side of the picture takes the place of the axis.
        """
        ahead = pose[:3, 2] if np.hypot(*pose[:2, 2]) > 1e-6 else -pose[:3, 1]
        cross = ahead[0] * self.direction[1] - ahead[1] * self.direction[0]
        return float(-np.arctan2(cross, ahead[:2] @ self.direction[:2]))


def tool_approach(centre: FloatArray, stem: FloatArray) -> Approach | None:
    """The way to a fruit; None where its centre lies on the stem's axis.

    Args:
        centre: `(3,)` of the fruit, world metres.
        stem: `(k, 3)` axis of the plant's main stem from the ground up.
    """
    point = _at_height(stem, centre)
    level = (point - centre) * [1.0, 1.0, 0.0]
    distance = float(np.linalg.norm(level))
    return Approach(level / distance, point) if distance > _NEAREST else None


def _at_height(line: FloatArray, centre: FloatArray) -> FloatArray:
    """`(3,)` where a line passes the height of a point, nearest to it; else the nearer end of the line."""
    low, high = line[:-1], line[1:]
    rise = high[:, 2] - low[:, 2]
    part = (centre[2] - low[:, 2]) / np.where(rise == 0.0, np.inf, rise)
    passing = np.flatnonzero((part >= 0.0) & (part <= 1.0) & (rise != 0.0))
    if not passing.size:
        ends = line[[0, -1]]
        return np.asarray(ends[np.abs(ends[:, 2] - centre[2]).argmin()])
    points = low[passing] + part[passing, None] * (high - low)[passing]
    return np.asarray(points[np.linalg.norm((points - centre)[:, :2], axis=1).argmin()])
