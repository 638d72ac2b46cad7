"""The twine that is wound around a stem and leads up to the wire above the crop."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from pepperscene.classes import OrganClass
from pepperscene.geometry.batch import hash_uniform
from pepperscene.geometry.mesh import FloatArray, Mesh, single_instance_mesh
from pepperscene.geometry.spine import normalize
from pepperscene.geometry.tubes.tube import ring_angles, skin_rings
from pepperscene.grammar.frames import cross

_SIDES: Final = 6  # chosen: twine is a few pixels wide
_STEP_M: Final = 2.5e-4  # chosen: sampling step along the stem
_MOST_STEPS: Final = 40000
_PRESSED_M: Final = 1e-4  # chosen: depth by which taut twine presses into the stem's ridges
_DEVIATION_M: Final = 1.8e-4  # chosen: distance by which the straight pieces may leave the twine's curve
_LONGEST_M: Final = 0.04  # chosen: length of pieces; longer ones along a curve would show
_LIFT_OFF_M: Final = 0.05  # chosen: distance over which twine moves from the stem's side to the line above it
_WAVE_RAD: Final = 0.12  # chosen: amplitude of each of the waves by which the pitch is uneven
_WAVES_M: Final = np.array([0.13, 0.21, 0.34])  # chosen: their lengths; two or three nodes
_CLEARANCE_M: Final = 6e-4  # chosen: gap between the twine and organs that grow out of the stem
_SHIFTS: Final = np.linspace(-np.pi, np.pi, 145)  # chosen: shifts tried to avoid it, 2.5 degrees apart
_PLY_STEPS: Final = 4  # rings to half a turn of two plies, the fewest that show them
_PLY_SIDES: Final = 8
_WAIST: Final = 0.45  # chosen: square of the thinnest half-width of two plies over the widest


def twine_mesh(
    stem_axis: FloatArray,
    stem_radius_m: ArrayLike,
    twine_radius_m: float,
    turns_per_m: float,
    phase_rad: float = 0.0,
    above_m: float = 0.5,
    *,
    branches: FloatArray | None = None,
    seed: float | None = None,
    lay_m: float | None = None,
) -> Mesh:
    """Build a helix of twine that touches the stem all the way and continues straight up above it.

    Its line is that of a ball of the twine's radius that rolls on the outline of the stem, so that it neither
    runs through swollen nodes nor hangs off them.

    Args:
        stem_axis: `(k, 3)` metres, from the ground up, k >= 2; see `stem_profile`.
        stem_radius_m: metres, one number or `(k,)`, linear between the points.
        twine_radius_m: metres.
        turns_per_m: windings per metre of stem; negative winds the other way.
        phase_rad: where the winding starts, from the -y side.
        above_m: metres that the twine continues above the stem's top; 0 ends it there.
        branches: `(j, 4)` metres, centre and radius of organs on the stem's side, from
            `stem_branches`; the twine shifts aside to pass it, as a grower winds it.
        seed: in [0, 1), makes the pitch uneven, differently for each; None keeps it even.
        lay_m: length of twine in which its two plies turn once about each other; each ply is round, at eight
            rings a turn. None makes round twine.

    Returns:
        A closed tube of class WIRE and surface "twine", one instance; u runs around, v along.

    Raises:
        ValueError: a radius is not above zero, or the axis has no length.
    """
    axis = np.asarray(stem_axis, dtype=float)
    stem_radius = np.broadcast_to(np.asarray(stem_radius_m, dtype=float), (len(axis),))
    if not twine_radius_m > 0.0 or not np.all(stem_radius >= 0.0) or above_m < 0.0:
        raise ValueError("the twine radius must be above zero, stem radius and above_m at least zero")
    if lay_m is not None and not lay_m > 0.0:
        raise ValueError(f"lay_m, the length of one turn of the plies, must be above zero, not {lay_m}")
    stem = _Stem(axis, stem_radius, twine_radius_m)
    # Angle around the stem: evenly, then with an uneven pitch, then past the branches.
    angle = 2.0 * np.pi * turns_per_m * stem.along + phase_rad
    if seed is not None:
        angle = angle + _uneven_pitch(stem.along, seed)
    if branches is not None and len(branches):
        angle = angle + stem.avoidance(np.asarray(branches, dtype=float), angle)
    line, outward = stem.twine_line(angle)
    if above_m > 0.0:
        # Above the stem's top the twine moves to the line of the stem and continues straight up.
        height = np.unique(np.append(np.linspace(0.0, min(_LIFT_OFF_M, above_m), 5)[1:], above_m))
        out = (1.0 - np.clip(height / _LIFT_OFF_M, 0.0, 1.0))[:, None] ** 2 * (line[-1] - axis[-1])
        line = np.concatenate([line, axis[-1] + out + height[:, None] * [0.0, 0.0, 1.0]])
        outward = np.concatenate([outward, np.repeat(outward[-1:], len(height), axis=0)])
    return _sweep_twine(line, outward, twine_radius_m, lay_m)


class _Stem:
    """The outline of a stem for a ball as thick as the twine, sampled in short steps.

    Attributes:
        along: `(k,)` metres from the base of the stem, evenly spaced.
        ball: radius of the twine, metres.
        distance: `(k,)` metres from the stem's axis to the centre of the ball.
        axis: `(k, 3)` points of the stem's axis.
        up, right: `(k, 3)` unit vectors across it: to the -y side, and to the right of that.
    """

    def __init__(self, axis: FloatArray, radius: FloatArray, ball: float) -> None:
        knots = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(axis, axis=0), axis=1))])
        if len(axis) < 2 or not knots[-1] > 0.0:
            raise ValueError("a stem's axis needs at least two distinct points")
        step = max(_STEP_M, knots[-1] / _MOST_STEPS)
        self.along = np.linspace(0.0, knots[-1], int(np.ceil(knots[-1] / step)) + 1)
        self.ball = ball
        step = float(self.along[1])
        # The ball is held as far out as any point of the outline below it requires.
        outline = np.maximum(np.interp(self.along, knots, radius) - _PRESSED_M, 0.0)
        width = int(ball / step)
        padded = np.pad(outline, width, constant_values=-np.inf)
        self.distance = np.max(
            [
                padded[width + offset : width + offset + len(outline)]
                + np.sqrt(max(ball**2 - (offset * step) ** 2, 0.0))
                for offset in range(-width, width + 1)
            ],
            axis=0,
        )
        # The -y side, across the direction of the stem, and the side to the right of it.
        direction = normalize(axis[-1] - axis[0])
        side = np.array([0.0, -1.0, 0.0]) - (-direction[1]) * direction
        if np.linalg.norm(side) < 1e-6:
            side = np.eye(3)[int(np.argmin(np.abs(direction)))]
        tangents = np.repeat(normalize(np.diff(axis, axis=0)), 2, axis=0)
        tangents = normalize(np.concatenate([tangents[:1], tangents[1:-1:2] + tangents[2::2], tangents[-1:]]))
        self.axis = _interpolate(self.along, knots, axis)
        tangent = normalize(_interpolate(self.along, knots, tangents))
        self.up = normalize(side - (tangent @ side)[:, None] * tangent)
        self.right = cross(tangent, self.up)

    def twine_line(self, angle: FloatArray) -> tuple[FloatArray, FloatArray]:
        """The twine's centreline `(k, 3)`, with as few points as it needs, and outward unit vectors there."""
        outward = np.cos(angle)[:, None] * self.up + np.sin(angle)[:, None] * self.right
        line = self.axis + self.distance[:, None] * outward
        # Pieces are as long as the curvature allows: a chord of length h deviates by curvature * h^2 / 8.
        step = float(self.along[1])
        curvature = np.zeros(len(line))
        curvature[1:-1] = np.linalg.norm(line[2:] - 2.0 * line[1:-1] + line[:-2], axis=1) / step**2
        width = max(1, round(0.001 / step))
        window = np.ones(2 * width + 1) / (2 * width + 1)
        curvature = np.convolve(np.pad(curvature, width, mode="edge"), window, "valid")
        pieces = np.cumsum(step * np.maximum(np.sqrt(curvature / (8.0 * _DEVIATION_M)), 1.0 / _LONGEST_M))
        targets = np.linspace(0.0, pieces[-1], int(np.ceil(pieces[-1])) + 1)
        selected = np.unique(np.searchsorted(pieces, targets).clip(0, len(line) - 1))
        selected[0], selected[-1] = 0, len(line) - 1
        return line[selected], outward[selected]

    def avoidance(self, branches: FloatArray, angle: FloatArray) -> FloatArray:
        """`(k,)` radians by which the twine must shift to pass branches `(j, 4)`."""
        centre, radius = branches[:, :3], branches[:, 3]
        # Position of each branch along the stem; those beyond the ends are ignored.
        direction = normalize(self.axis[-1] - self.axis[0])
        position = np.searchsorted(self.axis @ direction, centre @ direction)
        inside = (position > 0) & (position < len(self.along))
        order = np.argsort(position[inside], kind="stable")
        position, centre, radius = position[inside][order], centre[inside][order], radius[inside][order]
        if not len(position):
            return np.zeros(len(self.along))
        offset = centre - self.axis[position]
        side = np.arctan2(
            np.einsum("ji,ji->j", offset, self.right[position]),
            np.einsum("ji,ji->j", offset, self.up[position]),
        )
        # A steep stalk stays close to the stem for a while, where the stem may be thinner.
        wide, high = radius + self.ball + _CLEARANCE_M, 2.0 * radius + self.ball + _CLEARANCE_M
        span = position[:, None] + np.round(high / self.along[1])[:, None] * [-1, 0, 1]
        span = np.clip(span, 0, len(self.along) - 1).astype(np.intp)
        half_angle = wide / np.maximum(self.distance[span].min(axis=1), self.ball)
        # The branches of one node are passed together, by the smallest shift that clears them all.
        splits = np.flatnonzero(np.diff(self.along[position]) > 2.0 * high.max()) + 1
        knots, shifts, last = [], [], 0.0
        for group in np.split(np.arange(len(position)), splits):
            relative = angle[position[group]] - side[group]
            gap = np.abs((_SHIFTS[:, None] + relative + np.pi) % (2.0 * np.pi) - np.pi)
            overlap = np.clip(half_angle[group] - gap, 0.0, None).max(axis=1)
            last = _SHIFTS[np.argmin(100.0 * overlap + np.abs(_SHIFTS) + 0.3 * np.abs(_SHIFTS - last))]
            at = self.along[position[group]]
            knots += [at.min() - high.max(), at.max() + high.max()]
            shifts += [last, last]
        return np.interp(self.along, np.maximum.accumulate(knots), shifts)


def _interpolate(along: FloatArray, knots: FloatArray, values: FloatArray) -> FloatArray:
    """`(k, 3)` vectors, linear between those at the knots."""
    return np.stack([np.interp(along, knots, values[:, axis]) for axis in range(3)], axis=1)


def _uneven_pitch(along: FloatArray, seed: float) -> FloatArray:
    """`(k,)` radians by which the twine is ahead or behind, 0 at its start."""
    phase = 2.0 * np.pi * hash_uniform(np.array([seed]), 141, len(_WAVES_M))[0]
    wave = np.sin(2.0 * np.pi * along[:, None] / _WAVES_M + phase) - np.sin(phase)
    return np.asarray(_WAVE_RAD * wave.sum(axis=1))


def _sweep_twine(line: FloatArray, outward: FloatArray, radius: float, lay: float | None) -> Mesh:
    """A tube along a polyline: one ring at each of its points, closer if plies must show."""
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1))])
    if lay is not None:
        extra = np.arange(1, int(along[-1] * 2 * _PLY_STEPS / lay)) * lay / (2 * _PLY_STEPS)
        stations = np.unique(np.concatenate([along, extra]))
        line, outward = _interpolate(stations, along, line), normalize(_interpolate(stations, along, outward))
        along = stations
    tangent = normalize(np.gradient(line, along, axis=0, edge_order=1))
    normal = normalize(outward - np.einsum("ki,ki->k", outward, tangent)[:, None] * tangent)
    binormal = cross(tangent, normal)
    angle = np.tile(ring_angles(_SIDES if lay is None else _PLY_SIDES), (len(line), 1))
    reach = np.full(angle.shape, radius)
    if lay is not None:
        # Two plies pressed together: a waisted section that turns with them.
        reach = radius * np.sqrt(
            _WAIST + (1.0 - _WAIST) * np.cos(angle - 2.0 * np.pi * along[:, None] / lay) ** 2
        )
    offset = reach[..., None] * (
        np.sin(angle)[..., None] * binormal[:, None] + np.cos(angle)[..., None] * normal[:, None]
    )
    # Smaller rings and points close the ends.
    line = np.concatenate(
        [line[:1] - 0.35 * radius * tangent[:1], line, line[-1:] + 0.35 * radius * tangent[-1:]]
    )
    offset = np.concatenate([0.75 * offset[:1], offset, 0.75 * offset[-1:]])
    tangent = np.concatenate([tangent[:1], tangent, tangent[-1:]])
    ends = line[[0, -1]] + 0.2 * radius * tangent[[0, -1]] * np.array([[-1.0], [1.0]])
    state = np.full((1, *angle.shape), 0.5)
    batch = skin_rings(
        (line[:, None] + offset)[None], ends[None], tangent[None], along / along[-1], state, (False, False)
    )
    return single_instance_mesh(
        batch.vertices[0], batch.normals[0], batch.uv[0], batch.state[0], batch.faces,
        OrganClass.WIRE, "twine", "twine",
    )  # fmt: skip
