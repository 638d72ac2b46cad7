"""The cord that is wound round a stem and leads up to the wire above the crop."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pepperscene.classes import OrganClass
from pepperscene.geometry.body import Bodies, solids
from pepperscene.geometry.mesh import Mesh
from pepperscene.geometry.single import single
from pepperscene.geometry.spine import spines

_STEPS_PER_TURN = 16  # chosen: a turn looks round
_SIDES = 6  # chosen: a cord is a few pixels wide
_LIFT_OFF = 0.05  # chosen: metres over which the cord leaves the stem's side for the line above it


def twine(
    stem_axis: NDArray[np.float64],
    stem_radius_m: ArrayLike,
    twine_radius_m: float,
    turns_per_m: float,
    phase_rad: float = 0.0,
    above_m: float = 0.5,
) -> Mesh:
    """A helix that touches the stem all the way and goes on straight up above it.

    Args:
        stem_axis: `(k, 3)` metres, from the ground up, k >= 2.
        stem_radius_m: metres, one number or `(k,)`.
        twine_radius_m: of the cord, metres.
        turns_per_m: windings per metre of stem; negative winds the other way.
        phase_rad: where the winding starts, from the -y side.
        above_m: metres that the cord goes on above the stem's top; 0 ends it there.

    Returns:
        A closed tube of class WIRE and surface "twine", one instance; u runs around, v along.

    Raises:
        ValueError: a radius is not above zero, or the axis is not a line.
    """
    axis = np.asarray(stem_axis, dtype=float)
    stem_radius = np.broadcast_to(np.asarray(stem_radius_m, dtype=float), (len(axis),))
    if not twine_radius_m > 0.0 or not np.all(stem_radius >= 0.0) or above_m < 0.0:
        raise ValueError("twine needs a radius above zero, a stem radius of at least zero and a length above")
    # The helix, in the frame that follows the stem without turning; the stem's -y side is where it starts.
    knots = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(axis, axis=0), axis=1))])
    steps = max(len(axis), int(np.ceil(knots[-1] * max(abs(turns_per_m) * _STEPS_PER_TURN, 20.0))))
    stem = spines([axis], [np.array([0.0, -1.0, 0.0])], steps)
    along = np.linspace(0.0, stem.lengths[0], steps + 1)
    reach = np.interp(along, knots, stem_radius) + twine_radius_m
    angle = 2.0 * np.pi * turns_per_m * along + phase_rad
    line = stem.place(along[None], (reach * np.sin(angle))[None], (reach * np.cos(angle))[None])[0]
    if above_m > 0.0:
        # The cord swings in over the stem's top and goes on straight up.
        height = np.unique(np.append(np.linspace(0.0, min(_LIFT_OFF, above_m), 5)[1:], above_m))
        out = (1.0 - np.clip(height / _LIFT_OFF, 0.0, 1.0))[:, None] ** 2 * (line[-1] - axis[-1])
        line = np.concatenate([line, axis[-1] + out + height[:, None] * [0.0, 0.0, 1.0]])
    return single(_cord(line, twine_radius_m), OrganClass.WIRE, "twine", "twine")


def _cord(line: NDArray[np.float64], radius: float) -> Bodies:
    """A round tube along a polyline that is already fine enough: one ring at each of its points."""
    steps = len(line) - 1
    length = float(np.linalg.norm(np.diff(line, axis=0), axis=1).sum())
    # Rings at the given points, not at equal distances: the straight part needs few.
    part = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1))]) / length
    spine = spines([line], [np.array([1.0, 0.0, 0.0])], 4 * steps)
    along = np.broadcast_to((part * spine.lengths[0])[None, :, None], (1, steps + 1, _SIDES))
    rings = np.full_like(along, radius)
    ends = (np.array([-0.5 * radius]), spine.lengths + 0.5 * radius)
    return solids(spine, along, rings, ends, np.full((1, 2 + along.size), 0.5))
