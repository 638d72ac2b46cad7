"""The cord that is wound round a stem and leads up to the wire above the crop."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pepperscene.classes import OrganClass
from pepperscene.geometry.bodies import single
from pepperscene.geometry.mesh import Mesh
from pepperscene.geometry.organ_arrays import hashed
from pepperscene.geometry.spine import unit
from pepperscene.geometry.tubes.tube import circle, skin

_SIDES: Final = 6  # chosen: a cord is a few pixels wide
_FINE: Final = 2.5e-4  # chosen: metres between the points at which the stem's outline is felt
_PRESSED: Final = 1e-4  # chosen: metres by which a taut cord presses into the stem's ridges
_STRAY: Final = 1.8e-4  # chosen: metres by which the cord's straight pieces may leave its curve
_LONGEST: Final = 0.04  # chosen: metres; longer pieces along a curve would show
_LIFT_OFF: Final = 0.05  # chosen: metres over which the cord leaves the stem's side for the line above it
_WANDER: Final = 0.12  # chosen: radians of each of the waves by which the pitch is uneven
_WAVES_M: Final = np.array([0.13, 0.21, 0.34])  # chosen: their lengths; two or three nodes
_CLEAR: Final = 6e-4  # chosen: metres between the cord and what grows out of the stem beside it
_TRIES: Final = np.linspace(-np.pi, np.pi, 145)  # chosen: shifts tried to pass it, 2.5 degrees apart
_PLY_STEPS: Final = 4  # rings to half a turn of two plies, the fewest that show them
_PLY_SIDES: Final = 8
_WAIST: Final = 0.45  # chosen: square of the thinnest half-width of two plies over the widest


def twine_mesh(
    stem_axis: NDArray[np.float64],
    stem_radius_m: ArrayLike,
    twine_radius_m: float,
    turns_per_m: float,
    phase_rad: float = 0.0,
    above_m: float = 0.5,
    *,
    branches: NDArray[np.float64] | None = None,
    seed: float | None = None,
    lay_m: float | None = None,
) -> Mesh:
    """A helix that touches the stem all the way and goes on straight up above it.

    The cord lies on the stem's outline as a ball of its radius would roll on it, so that it neither runs
    through swollen nodes nor hangs off them.

    Args:
        stem_axis: `(k, 3)` metres, from the ground up, k >= 2; see `stem_profile`.
        stem_radius_m: metres, one number or `(k,)`, straight between the points.
        twine_radius_m: of the cord, metres.
        turns_per_m: windings per metre of stem; negative winds the other way.
        phase_rad: where the winding starts, from the -y side.
        above_m: metres that the cord goes on above the stem's top; 0 ends it there.
        branches: `(j, 4)` metres, centre and radius of what grows out of the stem's side, as
            `stem_branches` finds it; the cord shifts aside to pass it, as a grower winds it.
        seed: in [0, 1), makes the pitch uneven, differently for each; None leaves it even.
        lay_m: metres of cord in which its two plies turn once about each other; they are round each, and
            cost eight rings a turn. None is a round cord.

    Returns:
        A closed tube of class WIRE and surface "twine", one instance; u runs around, v along.

    Raises:
        ValueError: a radius is not above zero, or the axis is not a line.
    """
    axis = np.asarray(stem_axis, dtype=float)
    stem_radius = np.broadcast_to(np.asarray(stem_radius_m, dtype=float), (len(axis),))
    if not twine_radius_m > 0.0 or not np.all(stem_radius >= 0.0) or above_m < 0.0:
        raise ValueError("twine needs a radius above zero, a stem radius of at least zero and a length above")
    if lay_m is not None and not lay_m > 0.0:
        raise ValueError(f"a cord's plies need a length above zero to turn once, not {lay_m}")
    stem = _Stem(axis, stem_radius, twine_radius_m)
    # Where the cord is around the stem: evenly, then unevenly, then past what is in its way.
    angle = 2.0 * np.pi * turns_per_m * stem.along + phase_rad
    if seed is not None:
        angle = angle + _wander(stem.along, seed)
    if branches is not None and len(branches):
        angle = angle + stem.past(np.asarray(branches, dtype=float), angle)
    line, outward = stem.points(angle)
    if above_m > 0.0:
        # The cord swings in over the stem's top and goes on straight up.
        height = np.unique(np.append(np.linspace(0.0, min(_LIFT_OFF, above_m), 5)[1:], above_m))
        out = (1.0 - np.clip(height / _LIFT_OFF, 0.0, 1.0))[:, None] ** 2 * (line[-1] - axis[-1])
        line = np.concatenate([line, axis[-1] + out + height[:, None] * [0.0, 0.0, 1.0]])
        outward = np.concatenate([outward, np.repeat(outward[-1:], len(height), axis=0)])
    return _cord(line, outward, twine_radius_m, lay_m)


class _Stem:
    """A stem's outline, felt at close steps with a ball as thick as the cord."""

    def __init__(self, axis: NDArray[np.float64], radius: NDArray[np.float64], ball: float) -> None:
        knots = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(axis, axis=0), axis=1))])
        if len(axis) < 2 or not knots[-1] > 0.0:
            raise ValueError("a stem's axis needs at least two distinct points")
        step = max(_FINE, knots[-1] / 40000.0)
        self.along = np.linspace(0.0, knots[-1], int(np.ceil(knots[-1] / step)) + 1)
        self.ball = ball
        step = float(self.along[1])
        # The ball's centre is as far out as the outline anywhere below it holds it.
        outline = np.maximum(np.interp(self.along, knots, radius) - _PRESSED, 0.0)
        reach = int(ball / step)
        padded = np.pad(outline, reach, constant_values=-np.inf)
        self.reach = np.max(
            [
                padded[reach + by : reach + by + len(outline)] + np.sqrt(max(ball**2 - (by * step) ** 2, 0.0))
                for by in range(-reach, reach + 1)
            ],
            axis=0,
        )
        # Sides of the stem: the -y side, across the stem's course, and the side to the right of it.
        course = unit(axis[-1] - axis[0])
        side = np.array([0.0, -1.0, 0.0]) - (-course[1]) * course
        if np.linalg.norm(side) < 1e-6:
            side = np.eye(3)[int(np.argmin(np.abs(course)))]
        at = np.repeat(unit(np.diff(axis, axis=0)), 2, axis=0)
        at = unit(np.concatenate([at[:1], at[1:-1:2] + at[2::2], at[-1:]]))
        self.axis = _between(self.along, knots, axis)
        tangent = unit(_between(self.along, knots, at))
        self.up = unit(side - (tangent @ side)[:, None] * tangent)
        self.right = np.cross(tangent, self.up)

    def points(self, angle: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """The cord's line `(k, 3)`, in as few points as do, and unit vectors there that point outwards."""
        outward = np.cos(angle)[:, None] * self.up + np.sin(angle)[:, None] * self.right
        line = self.axis + self.reach[:, None] * outward
        # Pieces are as long as the curvature allows: the middle of a chord h is h^2 / 8 times it off.
        step = float(self.along[1])
        bend = np.zeros(len(line))
        bend[1:-1] = np.linalg.norm(line[2:] - 2.0 * line[1:-1] + line[:-2], axis=1) / step**2
        wide = max(1, round(0.001 / step))
        bend = np.convolve(np.pad(bend, wide, mode="edge"), np.ones(2 * wide + 1) / (2 * wide + 1), "valid")
        pieces = np.cumsum(step * np.maximum(np.sqrt(bend / (8.0 * _STRAY)), 1.0 / _LONGEST))
        wanted = np.linspace(0.0, pieces[-1], int(np.ceil(pieces[-1])) + 1)
        chosen = np.unique(np.searchsorted(pieces, wanted).clip(0, len(line) - 1))
        chosen[0], chosen[-1] = 0, len(line) - 1
        return line[chosen], outward[chosen]

    def past(self, branches: NDArray[np.float64], angle: NDArray[np.float64]) -> NDArray[np.float64]:
        """`(k,)` radians by which the cord shifts to pass branches `(j, 4)`."""
        centre, radius = branches[:, :3], branches[:, 3]
        # Where along the stem they are and to which side; those beyond the ends are in nobody's way.
        course = unit(self.axis[-1] - self.axis[0])
        place = np.searchsorted(self.axis @ course, centre @ course)
        inside = (place > 0) & (place < len(self.along))
        order = np.argsort(place[inside], kind="stable")
        place, centre, radius = place[inside][order], centre[inside][order], radius[inside][order]
        if not len(place):
            return np.zeros(len(self.along))
        off = centre - self.axis[place]
        side = np.arctan2(
            np.einsum("ji,ji->j", off, self.right[place]), np.einsum("ji,ji->j", off, self.up[place])
        )
        # A stalk that rises steeply stays beside the stem for a while, where that may be thinner.
        wide, high = radius + self.ball + _CLEAR, 2.0 * radius + self.ball + _CLEAR
        beside = np.clip(
            place[:, None] + np.round(high / self.along[1])[:, None] * [-1, 0, 1], 0, len(self.along) - 1
        )
        half = wide / np.maximum(self.reach[beside.astype(np.intp)].min(axis=1), self.ball)
        # Those of one node are passed together, by the smallest shift that clears them all.
        apart = np.flatnonzero(np.diff(self.along[place]) > 2.0 * high.max()) + 1
        knots, shifts, last = [], [], 0.0
        for group in np.split(np.arange(len(place)), apart):
            here = angle[place[group]] - side[group]
            away = np.abs((_TRIES[:, None] + here + np.pi) % (2.0 * np.pi) - np.pi)
            short = np.clip(half[group] - away, 0.0, None).max(axis=1)
            shift = _TRIES[np.argmin(100.0 * short + np.abs(_TRIES) + 0.3 * np.abs(_TRIES - last))]
            knots += [
                self.along[place[group]].min() - high.max(),
                self.along[place[group]].max() + high.max(),
            ]
            shifts += [shift, shift]
            last = shift
        return np.interp(self.along, np.maximum.accumulate(knots), shifts)


def _between(
    along: NDArray[np.float64], knots: NDArray[np.float64], values: NDArray[np.float64]
) -> NDArray[np.float64]:
    """`(k, 3)` vectors between those at the knots."""
    return np.stack([np.interp(along, knots, values[:, axis]) for axis in range(3)], axis=1)


def _wander(along: NDArray[np.float64], seed: float) -> NDArray[np.float64]:
    """`(k,)` radians by which a cord is ahead or behind, 0 at its start."""
    phase = 2.0 * np.pi * hashed(np.array([seed]), 141, len(_WAVES_M))[0]
    wave = np.sin(2.0 * np.pi * along[:, None] / _WAVES_M + phase) - np.sin(phase)
    return np.asarray(_WANDER * wave.sum(axis=1))


def _cord(line: NDArray[np.float64], outward: NDArray[np.float64], radius: float, lay: float | None) -> Mesh:
    """A tube along a polyline: one ring at each of its points, closer where plies must show."""
    walked = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1))])
    if lay is not None:
        extra = np.arange(1, int(walked[-1] * 2 * _PLY_STEPS / lay)) * lay / (2 * _PLY_STEPS)
        places = np.unique(np.concatenate([walked, extra]))
        line, outward = _between(places, walked, line), unit(_between(places, walked, outward))
        walked = places
    tangent = unit(np.gradient(line, walked, axis=0, edge_order=1))
    normal = unit(outward - np.einsum("ki,ki->k", outward, tangent)[:, None] * tangent)
    across = np.cross(tangent, normal)
    angle = np.tile(circle(_SIDES if lay is None else _PLY_SIDES), (len(line), 1))
    reach = np.full(angle.shape, radius)
    if lay is not None:
        # Two plies side by side, pressed together: a waisted section that turns with them.
        reach = radius * np.sqrt(
            _WAIST + (1.0 - _WAIST) * np.cos(angle - 2.0 * np.pi * walked[:, None] / lay) ** 2
        )
    offset = reach[..., None] * (
        np.sin(angle)[..., None] * across[:, None] + np.cos(angle)[..., None] * normal[:, None]
    )
    # Smaller rings and points close the ends.
    line = np.concatenate(
        [line[:1] - 0.35 * radius * tangent[:1], line, line[-1:] + 0.35 * radius * tangent[-1:]]
    )
    offset = np.concatenate([0.75 * offset[:1], offset, 0.75 * offset[-1:]])
    tangent = np.concatenate([tangent[:1], tangent, tangent[-1:]])
    ends = line[[0, -1]] + 0.2 * radius * tangent[[0, -1]] * np.array([[-1.0], [1.0]])
    bodies = skin(
        (line[:, None] + offset)[None],
        ends[None],
        tangent[None],
        walked / walked[-1],
        np.full((1, *angle.shape), 0.5),
        (False, False),
    )
    return single(bodies, OrganClass.WIRE, "twine", "twine")
