"""The parts of fruit whose visibility is tested: skin, peduncle and cut, as points on their surfaces."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.errors import ArgumentError
from pepperscene.geometry import Mesh
from pepperscene.geometry.surface_samples import SurfaceSamples, sample_surface
from pepperscene.render.aov.harvest import find_fruit_stalk, organ_ancestors
from pepperscene.render.arrays import LocalCoordinates
from pepperscene.render.variant import mitsuba_modules
from pepperscene.scene import Scene
from pepperscene.truth.cut_point import FruitStalk

FloatArray = NDArray[np.float64]

PEDUNCLE_SAMPLES: Final = 128
"""Chosen: a peduncle has a tenth of the pixels of a fruit, and its fraction is known to about 0.03."""
CUT_SAMPLES: Final = 64  # chosen: of a piece of the peduncle as long as it is thick
_DENSE: Final = 4096  # chosen: points on a peduncle, of which a cut has more than `CUT_SAMPLES`
_MORTON_BITS: Final = 10  # chosen: cells are a thousandth of an organ
_CUT_REACH: Final = 3.0  # chosen: radii from the cut point within which the stalk's surface belongs to it
_CELL: Final = 5.0
"""Side of the cell of an isolated part over its radius. A ray starts within three radii of the centre, so it
does not reach into the next cell."""


@dataclass(frozen=True, eq=False)
class FruitPart:
    """A fruit and the stalk that it is harvested with.

    Attributes:
        instance: index of the fruit among the scene's instances.
        stalk: the stalk, or None.
    """

    instance: int
    stalk: FruitStalk | None = None


def scene_fruit(scene: Scene) -> list[FruitPart]:
    """The fruit of a scene's labelled plants that have triangles, in the order of their instances.

    Raises:
        ArgumentError: the scene has no skeleton, or its mesh was edited since it was assembled.
    """
    skeleton = scene.skeleton
    if skeleton is None:
        raise ArgumentError("scene", "must be assembled with its plants' skeleton, which knows its fruit")
    skeleton.check_mesh(scene.mesh)
    runs = scene.mesh.face_runs
    instances = [index for index in skeleton.of_form("fruit") if runs.stop[index] > runs.first[index]]
    return [
        FruitPart(index, find_fruit_stalk(skeleton, organ_ancestors(skeleton, index))) for index in instances
    ]


@dataclass(frozen=True, eq=False)
class FruitSamples:
    """Points on the surfaces of fruit, a block of the same length for each.

    A block has first the points of the fruit's skin, then those of its peduncle, and last those around its
    cut. Points that do not exist have a normal of zero.

    Attributes:
        fruit, peduncle: `(f,)` instances; -1 for no peduncle.
        skin: number of points on each fruit.
        points, normals: `(f, b, 3)` world metres; unit normals.
        area_m2: `(f,)` of each fruit's surface.
        owner: `(f, b)` instance that each point belongs to.
    """

    fruit: NDArray[np.intp]
    peduncle: NDArray[np.intp]
    skin: int
    points: FloatArray
    normals: FloatArray
    area_m2: FloatArray
    owner: NDArray[np.uint32]

    @cached_property
    def centres(self) -> FloatArray:
        """`(f, 3)` centres of balls around each fruit with its peduncle and cut, world metres."""
        low, high = self._bounds
        return np.asarray(0.5 * (low + high))

    @cached_property
    def radii(self) -> FloatArray:
        """`(f,)` radii of these balls, metres."""
        low, high = self._bounds
        return np.asarray(0.5 * np.linalg.norm(high - low, axis=1))

    @cached_property
    def skin_centres(self) -> FloatArray:
        """`(f, 3)` centroid of each fruit's surface, world metres."""
        return np.asarray(self.points[:, : self.skin].mean(axis=1))

    @property
    def block(self) -> int:
        """Number of points of each fruit with its peduncle and cut."""
        return self.points.shape[1]

    @cached_property
    def _bounds(self) -> tuple[FloatArray, FloatArray]:
        exists = self.normals.any(axis=2, keepdims=True)
        low = np.where(exists, self.points, np.inf).min(axis=1)
        return low, np.where(exists, self.points, -np.inf).max(axis=1)


def sample_fruit(mesh: Mesh, fruit: Sequence[FruitPart], skin: int) -> FruitSamples:
    """Points on fruit, their peduncles and around their cuts.

    Raises:
        ArgumentError: there are no fruit, or one has no surface.
    """
    if not fruit:
        raise ArgumentError("scene", "has no fruit")
    count, block = len(fruit), skin + PEDUNCLE_SAMPLES + CUT_SAMPLES
    points, normals = np.zeros((2, count, block, 3))
    owner = np.zeros((count, block), np.uint32)
    peduncles, area = np.full(count, -1), np.zeros(count)
    for number, part in enumerate(fruit):
        samples = sample_surface(_in_space_order(instance_triangles(mesh, part.instance)), skin)
        if samples is None:
            raise ArgumentError("scene", f"the fruit with the instance {part.instance} has no surface")
        points[number, :skin], normals[number, :skin] = samples.points, samples.normals
        owner[number], area[number] = part.instance, samples.area_m2
        if part.stalk is None:
            continue
        triangles = _in_space_order(instance_triangles(mesh, part.stalk.instance))
        stalk, dense = sample_surface(triangles, PEDUNCLE_SAMPLES), sample_surface(triangles, _DENSE)
        if stalk is None or dense is None:
            continue
        owner[number, skin:] = peduncles[number] = part.stalk.instance
        around = _around_cut(dense, part.stalk)
        whole, cut = slice(skin, skin + PEDUNCLE_SAMPLES), slice(skin + PEDUNCLE_SAMPLES, None)
        points[number, whole], normals[number, whole] = stalk.points, stalk.normals
        points[number, cut][: len(around)] = dense.points[around]
        normals[number, cut][: len(around)] = dense.normals[around]
    instances = np.array([part.instance for part in fruit])
    return FruitSamples(instances, peduncles, skin, points, normals, area, owner)


def instance_triangles(mesh: Mesh, instance: int) -> FloatArray:
    """`(n, 3, 3)` corners of an instance's triangles, world metres."""
    return mesh.vertices[mesh.faces[mesh.face_runs.rows(instance)]].astype(float)


def _around_cut(samples: SurfaceSamples, stalk: FruitStalk) -> NDArray[np.intp]:
    """At most `CUT_SAMPLES` points of a stalk that are within its radius of the plane of the cut."""
    away = samples.points - stalk.cut
    near = np.abs(away @ stalk.tangent) <= stalk.radius_m
    near &= np.linalg.norm(away, axis=1) <= _CUT_REACH * stalk.radius_m
    rows = np.flatnonzero(near)
    if len(rows) <= CUT_SAMPLES:
        return rows
    return rows[np.linspace(0, len(rows) - 1, CUT_SAMPLES).round().astype(np.intp)]


def _in_space_order(triangles: FloatArray) -> FloatArray:
    """`(n, 3, 3)` triangles in the order of the Morton codes of their centroids: neighbours are together.

    The order of a regular mesh could repeat itself in step with the samples. And rays are traced in packets,
    of which those that face away from the camera as a whole cost nothing.
    """
    centroids = triangles.mean(axis=1)
    low, high = centroids.min(axis=0), centroids.max(axis=0)
    scale = (2**_MORTON_BITS - 1) / np.maximum(high - low, np.finfo(float).tiny)
    cell = ((centroids - low) * scale).round().astype(np.int64)
    code = np.zeros(len(cell), np.int64)
    for bit in range(_MORTON_BITS):
        for axis in range(3):
            code |= ((cell[:, axis] >> bit) & 1) << (3 * bit + axis)
    return triangles[np.argsort(code, kind="stable")]


@dataclass(frozen=True, eq=False)
class IsolatedParts:
    """Every fruit and peduncle alone in a cell of one scene, to find what hides itself.

    One scene for all, so that a kernel tests the points of any number of fruit.

    Attributes:
        scene: Mitsuba's.
        points: `(f, b, 3)` the points of `FruitSamples` in it, local units.
        reach: `(f, b)` distance from each point within which all of its part is, local units.
    """

    scene: Any
    points: FloatArray
    reach: FloatArray


def isolate_parts(mesh: Mesh, samples: FruitSamples, coordinates: LocalCoordinates) -> IsolatedParts:
    """Move fruit and peduncles apart."""
    mi, _ = mitsuba_modules()
    parts = [int(one) for one in np.concatenate([samples.fruit, samples.peduncle]) if one >= 0]
    triangles = [coordinates.from_world(instance_triangles(mesh, part)) for part in parts]
    corners = [part.reshape(-1, 3) for part in triangles]
    centres = np.array([0.5 * (part.min(axis=0) + part.max(axis=0)) for part in corners])
    radii = [
        float(np.linalg.norm(part - centre, axis=1).max())
        for part, centre in zip(corners, centres, strict=True)
    ]
    side = int(np.ceil(len(parts) ** (1 / 3)))
    cells = np.array(np.unravel_index(np.arange(len(parts)), (side, side, side))).T
    shifts = _CELL * max(radii) * cells - centres

    moved = np.concatenate([part + shift for part, shift in zip(corners, shifts, strict=True)])
    shape = mi.Mesh("parts", len(moved), len(moved) // 3)
    params = mi.traverse(shape)
    params["vertex_positions"] = np.ascontiguousarray(moved, np.float32).ravel()
    params["faces"] = np.arange(len(moved), dtype=np.uint32)
    params.update()

    number = np.zeros(len(mesh.instances), np.intp)
    number[parts] = np.arange(len(parts))
    of_point = number[samples.owner]
    points = coordinates.from_world(samples.points) + shifts[of_point]
    return IsolatedParts(
        mi.load_dict({"type": "scene", "parts": shape}), points, 2.0 * np.array(radii)[of_point]
    )
