"""The lamps inside the kernel: which of them a sample takes, and points on their shapes.

A sample takes one lamp of many, with a probability in proportion to what it can give at the surface point:
its power times a bound of its beam, over the squared distance, times a bound of what the surface scatters.
Only whether something is in between, and the place on the shape, is left to chance.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.camera.lamps.beam import Beam
from pepperscene.render.arrays import LocalCoordinates, device_array, device_float, device_uint
from pepperscene.render.kernel.camera import RayPose
from pepperscene.render.kernel.lamps import FrameLamps
from pepperscene.render.variant import mitsuba_modules

_MIN_DISTANCE: Final = 1e-4  # local units; chosen, as of the flash
_ANGLES: Final = 361  # chosen: of a beam's table, every half degree
_PLANES: Final = 145  # chosen: of a beam's table, every 2.5 degrees
_BOUNDS: Final = 64
"""Chosen: entries of a beam's bound, evenly spaced over the cosine of the angle to the axis."""
_NEIGHBOURS: Final = 4
"""Chosen: the bound is the maximum over as many entries on both sides, for shapes seen from nearby."""
_LEAST_BOUND: Final = 1e-3
"""Of an even beam: chosen, so that no lamp that can give light has the probability 0."""
_LEAST_FACING: Final = 0.05
"""Of a lamp straight above: chosen, for gloss, and for shapes of which a part is above the horizon."""
_RECORD: Final = 7  # vectors of four numbers for each lamp


class LampSampler:
    """Points on the lamps of a frame.

    Attributes:
        groups: first lamp of each spectrum, and the end.

    Args:
        light: the lamps.
        powers: `(k,)` light of each that the camera detects, in any unit.
        coordinates: of the scene in the kernel.
    """

    def __init__(self, light: FrameLamps, powers: NDArray[np.float64], coordinates: LocalCoordinates) -> None:
        _, dr = mitsuba_modules()
        self.groups = np.searchsorted(light.group, np.arange(len(light.spectra) + 1)).tolist()
        self._unit_m = coordinates.unit_m
        beams = list({id(lamp.beam): lamp.beam for lamp in light.lamps}.values())
        numbers = {id(beam): number for number, beam in enumerate(beams)}
        tables = [_beam_table(beam) for beam in beams]
        starts = np.cumsum([0, *(table.size for table in tables)])
        # A point's light falls with the squared distance in local units.
        self._beams = device_array(np.concatenate([table.ravel() for table in tables]) / self._unit_m**2)
        self._bounds = device_array(np.concatenate([_bounds(beam) for beam in beams]))
        records = np.zeros((len(light.lamps), _RECORD, 4))
        for record, lamp, moves, flux, group, power in zip(
            records, light.lamps, light.at_camera, light.flux_W, light.group, powers, strict=True
        ):
            shape, number = lamp.shape, numbers[id(lamp.beam)]
            place = lamp.position_m / self._unit_m if moves else coordinates.from_world(lamp.position_m)
            lengths = np.array([*shape.pitch_m, *shape.size_m]) / self._unit_m
            if shape.is_round:
                lengths[2:] = np.square(lengths[2:])  # area is even in the squared radius
            x, y, z = lamp.rotation.T
            step = _ANGLES if lamp.beam.plane_rad.size > 1 else 0
            record[0] = *place, power / max(float(np.max(powers)), 1e-300)
            record[1] = *z, (shape.extent_m / self._unit_m) ** 2
            record[2] = number * _BOUNDS, float(moves), float(group), flux
            record[3], record[4] = (*x, shape.columns), (*y, shape.rows)
            record[5] = lengths
            record[6] = float(shape.is_round), float(starts[number]), step, 0.0
        self._records = device_array(records)
        self._moves = bool(light.at_camera.any())
        self._min_square = device_float(_MIN_DISTANCE**2)
        dr.make_opaque(self._min_square)

    def choose(
        self,
        si: Any,
        point: Any,
        active: Any,
        pose: RayPose,
        positions: list[Any],
        lamps: tuple[int, int] | None = None,
    ) -> list[tuple[Any, Any]]:
        """Numbers of lamps and the probabilities with which they are chosen.

        Args:
            si: surface interactions.
            point: their optical states.
            active: which are active.
            pose: of the camera.
            positions: in [0, 1), one for each choice.
            lamps: the first to choose from, and the end; None for all.
        """
        mi, dr = mitsuba_modules()
        lamps = lamps or (0, self.groups[-1])
        first, end = (device_uint(number) for number in lamps)
        if lamps[1] - lamps[0] == 1:
            return [(first, mi.Float(1.0)) for _ in positions]
        reflects, transmits = (dr.detach(dr.mean(part)) for part in (point.reflectance, point.transmittance))
        normal = dr.detach(dr.select(si.wi.z > 0.0, si.sh_frame.n, -si.sh_frame.n))
        seen = dr.detach(si.p), normal, reflects, transmits

        def is_inside(number: Any, *_: Any) -> Any:
            return active & (number < end)

        def add(number: Any, total: Any) -> Any:
            return number + 1, total + self._weight(number, *seen, pose)

        start = dr.zeros(mi.UInt32, dr.width(normal)) + first
        nothing = dr.zeros(mi.Float, dr.width(normal))
        _, total = dr.while_loop((start, nothing), is_inside, add, label="sum of lamps")
        goals = [dr.detach(position) * total for position in positions]

        def pass_by(number: Any, before: Any, chosen: Any, weights: Any) -> Any:
            weight = self._weight(number, *seen, pose)
            for k, goal in enumerate(goals):
                # The last lamp that begins below the goal.
                takes = (weight > 0.0) & (before <= goal)
                chosen[k] = dr.select(takes, number, chosen[k])
                weights[k] = dr.select(takes, weight, weights[k])
            return number + 1, before + weight, chosen, weights

        state = start, nothing, [start + 0 for _ in goals], [nothing + 0.0 for _ in goals]
        _, _, chosen, weights = dr.while_loop(state, is_inside, pass_by, label="choice of lamps")
        share = dr.select(total > 0.0, dr.rcp(total), 0.0)
        return [(number, weight * share) for number, weight in zip(chosen, weights, strict=True)]

    def point(self, number: Any, p: Any, sample: Any, pose: RayPose) -> tuple[Any, Any, Any]:
        """A point on the shape of a lamp, its light at `p` over the spectrum of 1 W, m-2, and its spectrum.

        The light is that of a plane that faces it.
        """
        mi, dr = mitsuba_modules()
        at, axis, x, y = (self._vector(number, row) for row in (0, 1, 3, 4))
        lengths, table, kind = (self._vector(number, row) for row in (5, 6, 2))
        columns, rows = x.w, y.w
        # One element, and a place in it.
        across, down = sample.x * columns, sample.y * rows
        column, row = dr.minimum(dr.floor(across), columns - 1.0), dr.minimum(dr.floor(down), rows - 1.0)
        u, v = dr.clip(across - column, 0.0, 1.0), dr.clip(down - row, 0.0, 1.0)
        radius = dr.sqrt(dr.lerp(lengths.z, lengths.w, u))
        sine, cosine = dr.sincos(dr.two_pi * v)
        is_round = table.x > 0.5
        right = dr.select(is_round, radius * cosine, (u - 0.5) * lengths.z)
        along = dr.select(is_round, radius * sine, (v - 0.5) * lengths.w)
        right += (column - 0.5 * (columns - 1.0)) * lengths.x
        along += (row - 0.5 * (rows - 1.0)) * lengths.y
        centre, x, y, z = (
            self._placed(pose, kind.y, vector, is_point=vector is at) for vector in (at, x, y, axis)
        )
        target = centre + right * x + along * y
        ray = p - target
        square = dr.maximum(dr.squared_norm(ray), self._min_square)
        direction = ray * dr.rsqrt(square)
        local = mi.Vector3f(dr.dot(direction, x), dr.dot(direction, y), dr.dot(direction, z))
        light = self._intensity(local, table) * kind.w / square
        return target, light, mi.UInt32(kind.z)

    def _weight(self, number: Any, p: Any, normal: Any, reflects: Any, transmits: Any, pose: RayPose) -> Any:
        """About what a lamp can give at a point, in any unit; above 0 where it can give light."""
        mi, dr = mitsuba_modules()
        at, axis, kind = (self._vector(number, row) for row in range(3))
        ray = p - self._placed(pose, kind.y, at, is_point=True)
        square = dr.maximum(dr.squared_norm(ray) + axis.w, self._min_square)
        scale = dr.rsqrt(square)
        cosine = dr.dot(ray, self._placed(pose, kind.y, axis, is_point=False)) * scale
        entry = (cosine + 1.0) * (0.5 * _BOUNDS)
        # Written like this, the NaN of an inactive lane reads entry 0, not an address outside the table.
        entry = kind.x + dr.select(entry > 0.0, dr.minimum(dr.floor(entry), _BOUNDS - 1.0), 0.0)
        facing = -dr.dot(ray, normal) * scale
        scattered = dr.select(facing > 0.0, facing * reflects, -facing * transmits)
        scattered = scattered + _LEAST_FACING * (reflects + transmits + _LEAST_FACING)
        weight = at.w * dr.gather(mi.Float, self._bounds, mi.UInt32(entry)) * scattered / square
        return dr.select(weight > 0.0, weight, 0.0)

    def _vector(self, number: Any, row: int) -> Any:
        """Four numbers of the record of a lamp."""
        mi, dr = mitsuba_modules()
        return dr.gather(mi.Vector4f, self._records, number * _RECORD + row)

    def _placed(self, pose: RayPose, moves: Any, values: Any, *, is_point: bool) -> Any:
        """A point or a direction of a lamp in world axes; those of lamps at the camera move with it."""
        mi, dr = mitsuba_modules()
        vector = mi.Vector3f(values.x, values.y, values.z)
        if self._moves:
            moved = pose.to_world(vector)
            if is_point:
                moved = mi.Vector3f(pose.centre) + moved
            vector = dr.select(moves > 0.5, moved, vector)
        return mi.Point3f(vector) if is_point else vector

    def _intensity(self, direction: Any, table: Any) -> Any:
        """The beam in unit directions of the lamp's axes, over squared local units."""
        mi, dr = mitsuba_modules()
        angle = dr.safe_acos(direction.z) * ((_ANGLES - 1) / np.pi)
        angle = dr.select(angle > 0.0, dr.minimum(angle, _ANGLES - 1.001), 0.0)
        turn = dr.atan2(direction.y, direction.x) * dr.inv_two_pi
        plane = (turn - dr.floor(turn)) * (_PLANES - 1)
        plane = dr.select((plane > 0.0) & (table.z > 0.0), dr.minimum(plane, _PLANES - 1.001), 0.0)
        row, column = dr.floor(plane), dr.floor(angle)
        first = mi.UInt32(table.y) + mi.UInt32(row * table.z + column)
        after = first + mi.UInt32(table.z)
        low, high = (
            dr.lerp(
                dr.gather(mi.Float, self._beams, index),
                dr.gather(mi.Float, self._beams, index + 1),
                angle - column,
            )
            for index in (first, after)
        )
        return dr.lerp(low, high, plane - row)


def _beam_table(beam: Beam) -> NDArray[np.float64]:
    """`(planes, _ANGLES)` intensity over the flux, sr-1; one plane if all are the same."""
    planes = np.zeros(1) if beam.plane_rad.size == 1 else np.linspace(0.0, 2.0 * np.pi, _PLANES)
    angles = np.linspace(0.0, np.pi, _ANGLES)
    sine = np.sin(angles)
    # In the directions to the poles, the plane is kept.
    sine[[0, -1]] = 1e-9
    x, y = np.cos(planes)[:, None] * sine, np.sin(planes)[:, None] * sine
    directions = np.stack([x, y, np.broadcast_to(np.cos(angles), x.shape)], axis=-1)
    return beam.at(directions)


def _bounds(beam: Beam) -> NDArray[np.float64]:
    """`(_BOUNDS,)` about the highest intensity over the flux, by the cosine of the angle to the axis."""
    table = _beam_table(beam).max(axis=0)
    cosines = np.cos(np.linspace(0.0, np.pi, _ANGLES))
    entry = np.minimum(((cosines + 1.0) * (0.5 * _BOUNDS)).astype(int), _BOUNDS - 1)
    highest = np.zeros(_BOUNDS)
    np.maximum.at(highest, entry, table)
    padded = np.pad(highest, _NEIGHBOURS)
    windows = np.lib.stride_tricks.sliding_window_view(padded, 2 * _NEIGHBOURS + 1)
    return np.maximum(windows.max(axis=1), _LEAST_BOUND / (4.0 * np.pi))
