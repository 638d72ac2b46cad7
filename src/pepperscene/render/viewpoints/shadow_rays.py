"""Rays from many cameras to points on fruit, traced together.

`ImageMap` has the pixel coordinates of a camera as a table for the kernel.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import IntFlag
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.camera import Camera
from pepperscene.geometry import Mesh
from pepperscene.render.aov.flow import CLEARANCE
from pepperscene.render.arrays import LocalCoordinates, device_array, device_float, device_uint
from pepperscene.render.variant import mitsuba_modules
from pepperscene.render.viewpoints.fruit_parts import FruitSamples, IsolatedParts, isolate_parts

_NODES: Final = 257
"""Along each side. Chosen: between the nodes, the pixel coordinates of a lens of 90 degrees are right to a
few thousandths of a pixel."""
_MARGIN: Final = (
    0.02  # chosen: of the table beyond the image's extreme slopes, so that no border is at its rim
)
_OUTSIDE: Final = -1e9  # pixel coordinates where the lens has none


@dataclass(frozen=True, eq=False)
class ImageMap:
    """Pixel coordinates of a camera at a regular grid of undistorted slopes (x/z, y/z).

    Attributes:
        table: `(n * n * 3,)` at each node u, v, and pixels per unit of area in the plane of slopes.
        low, scale: the first node's slopes, and nodes per unit, of x and y each.
        size: width and height of the image.
        nodes: along each side.
    """

    table: Any
    low: tuple[Any, Any]
    scale: tuple[Any, Any]
    size: tuple[Any, Any]
    nodes: Any

    def lookup(self, x: Any, y: Any, active: Any) -> tuple[Any, Any]:
        """Whether slopes are in the image, and the pixels per unit of area there; linear between nodes."""
        mi, dr = mitsuba_modules()
        column, row = (x - self.low[0]) * self.scale[0], (y - self.low[1]) * self.scale[1]
        last = mi.Float(self.nodes - 1)
        in_table = active & (column >= 0.0) & (row >= 0.0) & (column < last) & (row < last)
        left, top = mi.UInt32(dr.select(in_table, column, 0.0)), mi.UInt32(dr.select(in_table, row, 0.0))
        across, down = column - mi.Float(left), row - mi.Float(top)
        first = top * self.nodes + left
        a, b, c, d = (
            dr.gather(mi.Vector3f, self.table, first + offset, in_table)
            for offset in (0, 1, self.nodes, self.nodes + 1)
        )
        found = dr.lerp(dr.lerp(a, b, across), dr.lerp(c, d, across), down)
        inside = in_table & (found.x >= 0.0) & (found.y >= 0.0)
        inside &= (found.x < self.size[0]) & (found.y < self.size[1])
        return inside, found.z


def image_map(camera: Camera) -> ImageMap:
    """The table of a camera; its pose and motion do not matter."""
    lowest, highest = camera.slope_limits()
    size = highest - lowest
    low, high = lowest - _MARGIN * size, highest + _MARGIN * size
    x, y = (np.linspace(low[axis], high[axis], _NODES) for axis in (0, 1))
    points = np.stack([*np.meshgrid(x, y), np.ones((_NODES, _NODES))], axis=-1)
    still = replace(camera, pose=np.eye(4), motion=None)
    pixels = still.project(points.reshape(-1, 3)).reshape(_NODES, _NODES, 2)
    du_dy, du_dx = np.gradient(pixels[..., 0], y, x)
    dv_dy, dv_dx = np.gradient(pixels[..., 1], y, x)
    area = np.asarray(du_dx * dv_dy - du_dy * dv_dx)
    table = np.concatenate([pixels, area[..., None]], axis=-1)
    # Beyond the field of the lens, and beside it where there is no derivative.
    table[..., :2] = np.nan_to_num(table[..., :2], nan=_OUTSIDE)
    scale = (_NODES - 1) / (high - low)
    return ImageMap(
        table=device_array(np.nan_to_num(table)),
        low=(device_float(low[0]), device_float(low[1])),
        scale=(device_float(scale[0]), device_float(scale[1])),
        size=(device_float(camera.width), device_float(camera.height)),
        nodes=device_uint(_NODES),
    )


class PointState(IntFlag):
    """What is known of a point seen from a camera; the bits above hold the occluder, its instance plus 1."""

    FACING = 1  # its surface faces the camera
    VISIBLE = 2  # in the image, and not hidden
    ALONE = 4  # in the image, and not hidden if only its fruit or peduncle were there


OCCLUDER_SHIFT = 3


@dataclass(frozen=True, eq=False)
class TracedPoints:
    """The points of some pairs of a pose and a fruit.

    Attributes:
        state: `(p, b)` uint32, see `PointState`.
        weight: `(p, b)` float32, pixels per square metre of surface; 0 outside the image.
    """

    state: NDArray[np.uint32]
    weight: NDArray[np.float32]

    def has(self, flag: PointState) -> NDArray[np.bool_]:
        """`(p, b)` whether the points have a flag."""
        return (self.state & flag) != 0

    @property
    def occluder(self) -> NDArray[np.uint32]:
        """`(p, b)` instance plus 1 of what hides each point, 0 for none; not of what its own organ hides."""
        return self.state >> np.uint32(OCCLUDER_SHIFT)


class PointTracer:
    """Points on fruit in the kernel, and the scene around them.

    Args:
        scene: Mitsuba's scene of the mesh.
        mesh: of the scene.
        coordinates: of the Mitsuba scene.
        samples: points on the fruit.
    """

    def __init__(self, scene: Any, mesh: Mesh, coordinates: LocalCoordinates, samples: FruitSamples) -> None:
        isolated: IsolatedParts = isolate_parts(mesh, samples, coordinates)
        self._scene, self._isolated = scene, isolated.scene
        self._unit_m, self.block = coordinates.unit_m, samples.block
        self._points = device_array(coordinates.from_world(samples.points))
        self._normals = device_array(samples.normals)
        self._owner = device_array(samples.owner, np.uint32)
        self._isolated_points, self._reach = device_array(isolated.points), device_array(isolated.reach)
        self._face_instance = device_array(mesh.face_instance, np.uint32)
        self._coordinates = coordinates

    def device_poses(self, poses: NDArray[np.float64]) -> Any:
        """`(n * 3 * 4,)` rows of the world-to-camera rotations, each with a coordinate of the position."""
        rows = np.empty((len(poses), 3, 4))
        rows[:, :, :3] = np.swapaxes(poses[:, :3, :3], 1, 2)
        rows[:, :, 3] = self._coordinates.from_world(poses[:, :3, 3])
        return device_array(rows)

    def trace(
        self, image: ImageMap, poses: Any, pose_index: NDArray[np.intp], fruit_index: NDArray[np.intp]
    ) -> TracedPoints:
        """Trace a ray from the camera to each point of each pair that faces it and is in its image.

        Args:
            image: of the camera.
            poses: of `device_poses`.
            pose_index: `(p,)` pose of each pair.
            fruit_index: `(p,)` fruit of each pair.
        """
        mi, dr = mitsuba_modules()
        count, block = len(pose_index), device_uint(self.block)
        lane = dr.arange(mi.UInt32, count * self.block)
        pair = lane // block
        pose = dr.gather(mi.UInt32, device_array(pose_index.astype(np.uint32), np.uint32), pair)
        fruit = dr.gather(mi.UInt32, device_array(fruit_index.astype(np.uint32), np.uint32), pair)
        point_row = fruit * block + (lane - pair * block)

        # The points in camera axes.
        row_x, row_y, row_z = (dr.gather(mi.Vector4f, poses, pose * 3 + axis) for axis in range(3))
        centre = mi.Point3f(row_x.w, row_y.w, row_z.w)
        to_point = dr.gather(mi.Point3f, self._points, point_row) - centre
        x, y, z = (dr.dot(mi.Vector3f(row.x, row.y, row.z), to_point) for row in (row_x, row_y, row_z))
        cosine = -dr.dot(dr.gather(mi.Normal3f, self._normals, point_row), to_point)
        facing = cosine > 0.0
        candidate, pixels = image.lookup(x / z, y / z, facing & (z > 0.0))

        # The first surface from the camera.
        distance = dr.norm(to_point)
        direction = to_point / distance
        hit = self._scene.ray_intersect_preliminary(
            mi.Ray3f(centre, direction), coherent=True, active=candidate
        )
        clearance = distance * device_float(CLEARANCE)
        hidden = candidate & hit.is_valid() & (hit.t < distance - clearance)
        occluder = dr.gather(mi.UInt32, self._face_instance, hit.prim_index, hidden)
        by_other = hidden & (occluder != dr.gather(mi.UInt32, self._owner, point_row, hidden))

        # A kernel of OptiX traces rays in one scene only.
        if dr.backend_v(mi.Float) == dr.JitBackend.CUDA:
            dr.eval(point_row, candidate, facing, hidden, occluder, by_other, distance, direction, clearance)
            dr.eval(cosine, z, pixels)

        # Of points that another organ hides, whether their own organ hides them as well.
        reach = dr.minimum(distance, dr.gather(mi.Float, self._reach, point_row, by_other))
        start = dr.gather(mi.Point3f, self._isolated_points, point_row, by_other) - direction * reach
        ray = mi.Ray3f(start, direction)
        ray.maxt = reach - clearance
        by_other &= ~self._isolated.ray_test(ray, active=by_other)

        visible = candidate & ~hidden
        state = dr.select(facing, mi.UInt32(PointState.FACING.value), mi.UInt32(0))
        state |= dr.select(visible, mi.UInt32((PointState.VISIBLE | PointState.ALONE).value), mi.UInt32(0))
        of_occluder = ((occluder + 1) << OCCLUDER_SHIFT) | mi.UInt32(PointState.ALONE.value)
        state |= dr.select(by_other, of_occluder, mi.UInt32(0))
        per_m2 = device_float(1.0 / self._unit_m**2)
        weight = dr.select(candidate, cosine / (z * z * z) * pixels * per_m2, mi.Float(0.0))
        dr.eval(state, weight)
        shape = (count, self.block)
        return TracedPoints(np.array(state).reshape(shape), np.array(weight).reshape(shape))
