"""Ground truth by one ray through each pixel's centre: exact, and nearly free."""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.camera import Camera
from pepperscene.geometry import Mesh
from pepperscene.render.kernel.arrays import device_number
from pepperscene.render.kernel.camera import CameraRays
from pepperscene.render.variant import mitsuba_modules
from pepperscene.truth import class_colour, distance_code

_TILE: Final = 4
"""Pixels along a tile's sides. Rays are handed to Embree in packets of 16: those of a square stay together
longer than those of a line (800x600, 2.9 million triangles: 33 ms of processor time against 44)."""


@dataclass(frozen=True, eq=False)
class Hits:
    """The first hit behind each pixel's centre.

    Attributes:
        face: `(h, w)` int64, index of the triangle hit, -1 for the background.
        distance: `(h, w)` float32, metres along the ray, inf for the background.
    """

    face: NDArray[np.int64]
    distance: NDArray[np.float32]


def first_hits(scene: Any, view: CameraRays) -> Hits:
    """One ray per pixel against the scene; no material, light or attribute is touched."""
    mi, dr = mitsuba_modules()
    across, down = -(-view.width // _TILE), -(-view.height // _TILE)
    lane = dr.arange(mi.UInt32, across * down * _TILE**2)
    tile, place = lane // _TILE**2, lane % _TILE**2
    # The sizes are numbers that the kernel reads, so that another picture compiles nothing anew.
    columns, rows, tiles = (device_number(n, whole=True) for n in (view.width, view.height, across))
    tile_row = tile // tiles
    # Tiles that reach over the edge see its last pixels again.
    row = dr.minimum(tile_row * _TILE + place // _TILE, rows - 1)
    column = dr.minimum((tile - tile_row * tiles) * _TILE + place % _TILE, columns - 1)
    towards = view.directions(column, row, mi.Float(0.5), mi.Float(0.5))
    found = scene.ray_intersect_preliminary(mi.Ray3f(view.origin, towards), coherent=True)
    hit = found.is_valid()
    pixels = view.width * view.height
    distance, face = dr.empty(mi.Float, pixels), dr.empty(mi.Int32, pixels)
    dr.scatter(distance, dr.select(hit, found.t, dr.inf), row * columns + column)
    dr.scatter(face, dr.select(hit, mi.Int32(found.prim_index), -1), row * columns + column)
    dr.eval(distance, face)
    # Copies: a frame may be kept, or read by another thread, while the kernel's memory goes on to the next.
    shape = (view.height, view.width)
    metres = np.array(distance).reshape(shape) * np.float32(view.unit)
    return Hits(np.asarray(face).reshape(shape).astype(np.int64), metres)


def label_outputs(
    mesh: Mesh, hits: Hits, instance: NDArray[np.uint16], camera: Camera, wanted: Sequence[str]
) -> dict[str, NDArray[Any]]:
    """Images by output name: those of `wanted` that need no light.

    Args:
        mesh: that was hit.
        hits: behind the camera's pixels.
        instance: what `instance_ids` makes of them.
        camera: that looks.
        wanted: names of outputs.
    """
    classes = functools.cache(lambda: class_ids(mesh, hits, instance))
    makers: dict[str, Callable[[], NDArray[Any]]] = {
        "class": classes,
        "class_colour": lambda: class_colour(classes()),
        "instance": lambda: instance,
        "distance": lambda: hits.distance,
        "distance_code": lambda: distance_code(hits.distance),
        "depth_z": lambda: depth_z(hits, camera),
        "normal": lambda: normals(mesh, hits, camera),
        "position": lambda: points(hits, camera).astype(np.float32),
        "uv": lambda: surface_coordinates(mesh, hits, camera),
    }
    return {name: make() for name, make in makers.items() if name in wanted}


def instances_in_view(mesh: Mesh, instance: NDArray[np.uint16]) -> dict[str, dict[str, Any]]:
    """What there is to say of each instance that has a pixel, by pixel value.

    Class, kind, plant, phytomer and parent, the number of its pixels, and the `box` [x0, y0, x1, y1] that
    holds them: columns x0 to x1 - 1, rows y0 to y1 - 1.
    """
    told: dict[str, dict[str, Any]] = {}
    for value, pixels, *box in _extents(instance).tolist():
        one = mesh.instances[value - 1]
        told[str(value)] = {
            "class": int(one.organ_class),
            "kind": one.kind,
            "plant": one.plant,
            "phytomer": one.phytomer,
            "parent": one.parent + 1,
            "pixels": pixels,
            "box": box,
        }
    return told


def _extents(instance: NDArray[np.uint16]) -> NDArray[np.int64]:
    """`(n, 6)` each value but 0, ascending, its pixels, and x0, y0, x1, y1 of its half-open box."""
    # Runs of equal values along the rows: an image has ten times fewer of them than pixels.
    width, flat = instance.shape[1], instance.ravel()
    begins = np.ones(flat.size, dtype=bool)
    np.not_equal(flat[1:], flat[:-1], out=begins[1:])
    begins[::width] = True
    first = np.flatnonzero(begins)
    length = np.diff(first, append=flat.size)
    organs = flat[first] > 0
    first, length = first[organs], length[organs]
    if not first.size:
        return np.empty((0, 6), dtype=np.int64)
    # The runs of each value lie together, and stay in the order of their rows.
    order = np.argsort(flat[first], kind="stable")
    first, length = first[order], length[order]
    value, row, column = flat[first], first // width, first % width
    start = np.flatnonzero(np.diff(value, prepend=0))
    end = np.append(start[1:], len(value)) - 1
    return np.stack(
        [
            value[start].astype(np.int64),
            np.add.reduceat(length, start),
            np.minimum.reduceat(column, start),
            row[start],
            np.maximum.reduceat(column + length, start),
            row[end] + 1,
        ],
        axis=1,
    )


def class_ids(mesh: Mesh, hits: Hits, instance: NDArray[np.uint16] | None = None) -> NDArray[np.uint8]:
    """`(h, w)` the `OrganClass` at each pixel; 0 in the background.

    Args:
        mesh: that was hit.
        hits: behind the camera's pixels.
        instance: what `instance_ids` makes of them, where it is there already.
    """
    # A table of thousands of instances is looked up faster than one of millions of faces.
    table = np.array([0, *(one.organ_class for one in mesh.instances)], dtype=np.uint8)
    return np.take(table, instance_ids(mesh, hits) if instance is None else instance)


def instance_ids(mesh: Mesh, hits: Hits) -> NDArray[np.uint16]:
    """`(h, w)` index into the mesh's instances plus 1; 0 in the background.

    Raises:
        ValueError: there are more instances than 16 bits can tell apart.
    """
    if len(mesh.instances) > np.iinfo(np.uint16).max:
        raise ValueError(f"{len(mesh.instances)} instances do not fit into a 16-bit image")
    # The background looks up the last face, and is overwritten.
    found = mesh.face_instance[hits.face].astype(np.uint16)
    found += 1
    found[hits.face < 0] = 0
    return found


def normals(mesh: Mesh, hits: Hits, camera: Camera) -> NDArray[np.float32]:
    """`(h, w, 3)` unit geometric normals in the world, on the side that the camera sees; 0 without a hit.

    In double precision, because the difference of two products of needle-like edges loses digits; and once
    per triangle, because a triangle in view covers several pixels. Each axis lies in one piece in memory.
    """
    faces, place = _seen(hits.face, len(mesh.faces))
    first, second, third = (
        mesh.vertices[mesh.faces[faces, corner]].astype(np.float64) for corner in range(3)
    )
    normal = _cross((second - first).T, (third - first).T)
    # The camera sees a triangle from the side of its plane that it is on itself.
    normal *= np.where(np.sum(normal * (camera.pose[:3, 3] - first).T, axis=0) < 0.0, -1.0, 1.0)
    normal /= np.maximum(np.sqrt(np.sum(normal * normal, axis=0)), 1e-300)
    # The background is told by the entry behind the last face.
    table = np.zeros((3, len(faces) + 1), np.float32)
    table[:, :-1] = normal
    return np.moveaxis(np.stack([np.take(axis, place) for axis in table]), 0, -1)


def depth_z(hits: Hits, camera: Camera) -> NDArray[np.float32]:
    """`(h, w)` metres along the optical axis; inf in the background."""
    return (hits.distance * camera.pixel_directions()[..., 2]).astype(np.float32)


def points(hits: Hits, camera: Camera) -> NDArray[np.float64]:
    """`(h, w, 3)` what is hit, in world coordinates, metres; inf in the background."""
    rays = world_rays(camera)
    seen = hits.face >= 0
    # Infinity times 0 is no number.
    found = np.where(seen, hits.distance, 0.0)[..., None] * rays + camera.pose[:3, 3]
    found[~seen] = np.inf
    return found


def world_rays(camera: Camera) -> NDArray[np.float64]:
    """`(h, w, 3)` unit directions in the world of the rays through the pixels' centres."""
    x, y, z = np.moveaxis(camera.pixel_directions(), -1, 0)
    found = np.empty((3, *x.shape))
    # Coordinate by coordinate: the matrix library shares such products out to threads, and its last bits
    # depend on them.
    for axis, (one, other, third) in enumerate(camera.pose[:3, :3]):
        found[axis] = one * x + other * y + third * z
    return np.moveaxis(found, 0, -1)


def surface_coordinates(mesh: Mesh, hits: Hits, camera: Camera) -> NDArray[np.float32]:
    """`(h, w, 2)` surface coordinates in [0, 1], linear over each triangle; -1 in the background.

    Where on its triangle a ray falls is told in double precision, as `normals` are: single precision loses
    what a needle-like triangle is narrower by than it is long.

    Method: T. Moeller and B. Trumbore, "Fast, minimum storage ray-triangle intersection", Journal of Graphics
    Tools 2 (1997) 21.
    """
    found = np.full((*hits.face.shape, 2), -1.0, np.float32)
    seen = hits.face >= 0
    corners = mesh.faces[hits.face[seen]]
    first, second, third = (mesh.vertices[corners[:, corner]].astype(np.float64).T for corner in range(3))
    ray = world_rays(camera)[seen].T
    along, across = second - first, third - first
    back = camera.pose[:3, 3][:, None] - first
    ray_across, back_along = _cross(ray, across), _cross(back, along)
    volume = (along * ray_across).sum(axis=0)
    # A ray may fall beside its triangle by rounding, and on one of no width anywhere.
    with np.errstate(divide="ignore", invalid="ignore"):
        u = np.nan_to_num(np.clip((back * ray_across).sum(axis=0) / volume, 0.0, 1.0))
        v = np.nan_to_num(np.clip((ray * back_along).sum(axis=0) / volume, 0.0, 1.0 - u))
    one, two, three = (mesh.uv[corners[:, corner]].T for corner in range(3))
    found[seen] = ((1.0 - u - v) * one + u * two + v * three).T
    return found


def _seen(face: NDArray[np.int64], count: int) -> tuple[NDArray[np.intp], NDArray[np.uint32]]:
    """The faces in view, ascending, and each pixel's place among them; the background's is the last."""
    # One entry more than there are faces: the one that index -1 finds.
    seen = np.zeros(count + 1, dtype=bool)
    seen[face] = True
    seen[-1] = False
    faces = np.flatnonzero(seen)
    # What is not written here is not read, so that memory is touched only where faces are in view.
    place = np.empty(count + 1, dtype=np.uint32)
    place[faces] = np.arange(len(faces), dtype=np.uint32)
    place[-1] = len(faces)
    return faces, place[face]


def _cross(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    """Cross products of `(3, n)` vectors."""
    return np.stack([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])
