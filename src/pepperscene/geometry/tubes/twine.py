"""The twine that is wound around a stem and leads up to the wire above the crop."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pepperscene.classes import OrganClass
from pepperscene.geometry.batch import hash_uniform, ring_faces, ring_uv
from pepperscene.geometry.mesh import FloatArray, IndexArray, Mesh, single_instance_mesh
from pepperscene.geometry.spine import normalize
from pepperscene.geometry.tubes.tube import ring_angles, skin_rings
from pepperscene.grammar.frames import cross

_SIDES: Final = 6  # chosen: twine is a few pixels wide
_STEP_M: Final = 2.5e-4  # chosen: sampling step along the stem
_MAX_STEPS: Final = 40000
_PRESSED_M: Final = 1e-4  # chosen: depth by which taut twine presses into the stem's ridges
_DEVIATION_M: Final = 1.8e-4  # chosen: distance by which the straight pieces may leave the twine's curve
_LONGEST_M: Final = 0.04  # chosen: length of pieces; longer ones along a curve would show
_LIFT_OFF_M: Final = 0.05  # chosen: distance over which twine moves from the stem's side to the line above it
_WAVE_RAD: Final = 0.12  # chosen: amplitude of each of the waves by which the pitch is uneven
_WAVES_M: Final = np.array([0.13, 0.21, 0.34])  # chosen: their lengths; two or three nodes
_CLEARANCE_M: Final = 6e-4  # chosen: gap between the twine and organs that grow out of the stem
_SHIFTS: Final = np.linspace(-np.pi, np.pi, 145)  # chosen: shifts tried to avoid it, 2.5 degrees apart
TEXTURE_DIAMETERS: Final = 15.0
"""Length of twine, in its diameters, after which its texture repeats: v runs from 0 to 1 over it again and
again. Chosen: three turns of strands that are laid with a pitch of five diameters."""


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

    Returns:
        A closed, round tube of class WIRE and surface "twine", one instance. u runs around, and v along, from
        0 to 1 in every `TEXTURE_DIAMETERS`; there, points with v = 1 are repeated with v = 0. The strands
        that the twine is laid of are part of the surface's texture.

    Raises:
        ValueError: a radius is not above zero, or the axis has no length.
    """
    axis = np.asarray(stem_axis, dtype=float)
    stem_radius = np.broadcast_to(np.asarray(stem_radius_m, dtype=float), (len(axis),))
    if not twine_radius_m > 0.0 or not np.all(stem_radius >= 0.0) or above_m < 0.0:
        raise ValueError("the twine radius must be above zero, stem radius and above_m at least zero")
    stem = _Stem(axis, stem_radius, twine_radius_m)
    # Angle around the stem: evenly, then with an uneven pitch, then past the branches.
    angle = 2.0 * np.pi * turns_per_m * stem.along + phase_rad
    if seed is not None:
        angle = angle + _uneven_pitch(stem.along, seed)
    if branches is not None and len(branches):
        angle = angle + stem.avoidance(np.asarray(branches, dtype=float), angle)
    period = 2.0 * twine_radius_m * TEXTURE_DIAMETERS
    line, outward, turn = stem.twine_line(angle, period)
    if above_m > 0.0:
        # Above the stem's top the twine moves to the line of the stem and continues straight up.
        height = np.unique(np.append(np.linspace(0.0, min(_LIFT_OFF_M, above_m), 5)[1:], above_m))
        out = (1.0 - np.clip(height / _LIFT_OFF_M, 0.0, 1.0))[:, None] ** 2 * (line[-1] - axis[-1])
        above = axis[-1] + out + height[:, None] * [0.0, 0.0, 1.0]
        steps = np.linalg.norm(np.diff(above, axis=0, prepend=line[-1:]), axis=1)
        line, turn = np.concatenate([line, above]), np.append(turn, turn[-1] + np.cumsum(steps) / period)
        outward = np.concatenate([outward, np.repeat(outward[-1:], len(height), axis=0)])
    return _sweep_twine(line, outward, turn, twine_radius_m)


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
        step = max(_STEP_M, knots[-1] / _MAX_STEPS)
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

    def twine_line(self, angle: FloatArray, period: float) -> tuple[FloatArray, FloatArray, FloatArray]:
        """The twine's centreline `(k, 3)`, with as few points as it needs, and outward unit vectors there.

        And `(k,)` the length of twine up to each point over `period`. It has a point at every whole number.
        """
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
        length = np.linalg.norm(np.diff(line, axis=0), axis=1)
        turn = np.concatenate([[0.0], np.cumsum(length)]) / period
        whole = np.arange(1.0, np.ceil(turn[-1]))
        nearest = np.searchsorted(turn, whole)
        turn[nearest] = whole
        selected = np.union1d(selected, nearest)
        return line[selected], outward[selected], turn[selected]

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


def _sweep_twine(line: FloatArray, outward: FloatArray, turn: FloatArray, radius: float) -> Mesh:
    """A tube along a polyline: one ring at each of its points, and two where the texture repeats.

    Args:
        line: `(k, 3)` metres.
        outward: `(k, 3)` unit vectors.
        turn: `(k,)` number of repeats of the texture up to each point, ascending.
        radius: of the twine, metres.
    """
    repeats = np.arange(1.0, np.ceil(turn[-1]))
    stations = np.union1d(turn, repeats)
    line, outward = _interpolate(stations, turn, line), normalize(_interpolate(stations, turn, outward))
    tangent = normalize(np.gradient(line, stations, axis=0, edge_order=1))
    normal = normalize(outward - np.einsum("ki,ki->k", outward, tangent)[:, None] * tangent)
    binormal = cross(tangent, normal)
    angle = ring_angles(_SIDES)
    offset = radius * (np.sin(angle)[:, None] * binormal[:, None] + np.cos(angle)[:, None] * normal[:, None])
    # Smaller rings and points close the ends.
    line = np.concatenate(
        [line[:1] - 0.35 * radius * tangent[:1], line, line[-1:] + 0.35 * radius * tangent[-1:]]
    )
    offset = np.concatenate([0.75 * offset[:1], offset, 0.75 * offset[-1:]])
    tangent = np.concatenate([tangent[:1], tangent, tangent[-1:]])
    ends = line[[0, -1]] + 0.2 * radius * tangent[[0, -1]] * np.array([[-1.0], [1.0]])
    state = np.full((1, len(stations), _SIDES), 0.5)
    batch = skin_rings(
        (line[:, None] + offset)[None],
        ends[None],
        tangent[None],
        stations / stations[-1],
        state,
        (False, False),
    )
    ring, v = _repeat_rings(np.pad(stations, 1, mode="edge"), np.pad(np.isin(stations, repeats), 1))
    rows = (1 + (_SIDES + 1) * ring[:, None] + np.arange(_SIDES + 1)).ravel()
    vertex = np.concatenate([[0], rows, [batch.vertices.shape[1] - 1]])
    # Rings at the same place are not joined.
    strip = np.concatenate([[True], np.diff(ring) > 0, [True]])
    between = np.repeat(strip[1:-1], _SIDES)
    faces = ring_faces(len(ring), _SIDES)
    joined = np.concatenate([np.full(_SIDES, True), between, between, np.full(_SIDES, True)])
    return single_instance_mesh(
        batch.vertices[0, vertex], batch.normals[0, vertex], ring_uv(v, _SIDES), batch.state[0, vertex],
        faces[joined], OrganClass.WIRE, "twine", "twine",
    )  # fmt: skip


def _repeat_rings(turn: FloatArray, at_repeat: NDArray[np.bool_]) -> tuple[IndexArray, FloatArray]:
    """Indices of rings `(m,)`, with those at the texture's repeats twice, and v of each.

    Args:
        turn: `(k,)` number of repeats of the texture from the start to each ring.
        at_repeat: `(k,)` whether a ring is at the end of a repeat.
    """
    ring = np.repeat(np.arange(len(turn)), 1 + at_repeat)
    first = np.concatenate([np.diff(ring) == 0, [False]]) & at_repeat[ring]
    second = np.concatenate([[False], np.diff(ring) == 0])
    v = np.where(first, 1.0, np.where(second, 0.0, np.mod(turn[ring], 1.0)))
    return ring, v
