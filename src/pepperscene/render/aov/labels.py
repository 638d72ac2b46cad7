"""Ground truth from one ray through each pixel's centre: exact, and nearly free."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.camera import Camera
from pepperscene.classes import IGNORE_CLASS, OrganClass
from pepperscene.geometry import Mesh
from pepperscene.render.arrays import device_uint
from pepperscene.render.kernel.camera import CameraRays
from pepperscene.render.variant import mitsuba_modules

_TILE: Final = 4
"""Pixels along the sides of a tile. Embree traces rays in packets of 16: those of a square stay together
longer than those of a line (800x600, 2.9 million triangles: 33 ms of CPU time against 44)."""

_UV_PIXELS: Final = 1 << 20
"""Chosen: pixels whose points in triangles are computed at a time; each takes 0.6 KB meanwhile."""


@dataclass(frozen=True, eq=False)
class Hits:
    """The first hit behind each pixel's centre, in h rows of an image."""

    face: NDArray[np.int64]  # `(h, w)` int64, index of the triangle hit, -1 for the background
    distance: NDArray[np.float32]  # `(h, w)` float32, metres along the ray, inf for the background
    top: int = 0  # number of the first row

    @property
    def rows(self) -> slice:
        """The rows of the image."""
        return slice(self.top, self.top + len(self.face))


def first_hits(scene: Any, rays: CameraRays, in_rows: slice = slice(None)) -> Hits:
    """Trace one ray per pixel, of all rows or of some; no material, light or mesh attribute is read."""
    mi, dr = mitsuba_modules()
    top, bottom, _ = in_rows.indices(rays.height)
    height = bottom - top
    across, down = -(-rays.width // _TILE), -(-height // _TILE)
    lane = dr.arange(mi.UInt32, across * down * _TILE**2)
    tile, in_tile = lane // _TILE**2, lane % _TILE**2
    # The sizes are kernel data, so that another image size compiles nothing.
    columns, rows, tiles, first = (device_uint(n) for n in (rays.width, height, across, top))
    tile_row = tile // tiles
    # Tiles that reach over the border repeat its last pixels.
    row = dr.minimum(tile_row * _TILE + in_tile // _TILE, rows - 1)
    column = dr.minimum((tile - tile_row * tiles) * _TILE + in_tile % _TILE, columns - 1)
    origin, direction = rays.centre_rays(column, row + first, mi.Float(0.5), mi.Float(0.5))
    hit = scene.ray_intersect_preliminary(mi.Ray3f(origin, direction), coherent=True)
    is_hit = hit.is_valid()
    shape = (height, rays.width)
    distance, face = (dr.empty(kind, shape[0] * shape[1]) for kind in (mi.Float, mi.Int32))
    dr.scatter(distance, dr.select(is_hit, hit.t, dr.inf), row * columns + column)
    dr.scatter(face, dr.select(is_hit, mi.Int32(hit.prim_index), -1), row * columns + column)
    dr.eval(distance, face)
    # Copies: frames can outlive the kernel's memory, or be read by another thread.
    metres = np.array(distance).reshape(shape) * np.float32(rays.unit_m)
    return Hits(np.asarray(face).reshape(shape).astype(np.int64), metres, top)


def visible_instances(mesh: Mesh, instance: NDArray[np.uint16]) -> dict[str, dict[str, Any]]:
    """Describe each instance that has a pixel, by its value in the instance image.

    The `box` [x0, y0, x1, y1] contains all its pixels: columns x0 to x1 - 1, rows y0 to y1 - 1. Only those of
    coarse plants of far rows have the key `far`, which is True.
    """
    described: dict[str, dict[str, Any]] = {}
    for value, pixels, *box in _pixel_extents(instance).tolist():
        item = mesh.instances[value - 1]
        described[str(value)] = {
            "class": item.class_id,
            "kind": item.kind,
            "plant": item.plant,
            "phytomer": item.phytomer,
            "parent": item.parent + 1,
            "pixels": pixels,
            "box": box,
        }
        if item.far_row >= 0 and not item.full:
            described[str(value)]["far"] = True
    return described


def visible_organs(described: Mapping[str, Mapping[str, Any]]) -> list[int]:
    """Indices of the organs among `visible_instances`, ascending: all of a class that is no background."""
    no_organ = (OrganClass.BACKGROUND, IGNORE_CLASS)
    return [int(value) - 1 for value, item in described.items() if item["class"] not in no_organ]


def _pixel_extents(instance: NDArray[np.uint16]) -> NDArray[np.int64]:
    """`(n, 6)` each value above 0, ascending, its number of pixels, and its box x0, y0, x1, y1.

    `scipy.ndimage.find_objects` visits every pixel: 4.2 ms instead of 1.9, a tenth of a label frame.
    """
    # Runs of equal values along the rows: an image has ten times fewer of them than pixels.
    width, values = instance.shape[1], instance.ravel()
    begins = np.ones(values.size, dtype=bool)
    np.not_equal(values[1:], values[:-1], out=begins[1:])
    begins[::width] = True
    first = np.flatnonzero(begins)
    length = np.diff(first, append=values.size)
    is_organ = values[first] > 0
    first, length = first[is_organ], length[is_organ]
    if not first.size:
        return np.empty((0, 6), dtype=np.int64)

    # Sort the runs by value; those of a value stay in the order of their rows.
    order = np.argsort(values[first], kind="stable")
    first, length = first[order], length[order]
    value, row, column = values[first], first // width, first % width
    start = np.flatnonzero(np.diff(value, prepend=0))
    end = np.append(start[1:], len(value)) - 1
    left, right = np.minimum.reduceat(column, start), np.maximum.reduceat(column + length, start)
    pixels = np.add.reduceat(length, start)
    return np.stack([value[start].astype(np.int64), pixels, left, row[start], right, row[end] + 1], axis=1)


def class_ids(mesh: Mesh, instance: NDArray[np.uint16]) -> NDArray[np.uint8]:
    """`(h, w)` the `OrganClass` or `IGNORE_CLASS` at each pixel of an instance image; 0 in the background."""
    return np.take(np.insert(mesh.instance_class, 0, OrganClass.BACKGROUND), instance)


def instance_ids(mesh: Mesh, hits: Hits) -> NDArray[np.uint16]:
    """`(h, w)` index into the mesh's instances plus 1; 0 in the background.

    Raises:
        ValueError: there are too many instances for 16 bits.
    """
    if len(mesh.instances) > np.iinfo(np.uint16).max:
        raise ValueError(f"{len(mesh.instances)} instances do not fit into a 16-bit image")
    # The background looks up the last face, and is overwritten.
    ids = mesh.face_instance[hits.face].astype(np.uint16)
    ids += 1
    ids[hits.face < 0] = 0
    return ids


def normals(mesh: Mesh, hits: Hits, camera: Camera) -> NDArray[np.float32]:
    """`(h, w, 3)` unit geometric normals in world axes, on the side that the camera sees; 0 without a hit.

    In double precision, because differences of products of needle-like edges lose digits; and once for each
    visible triangle, which takes 6 ms instead of 40. Each axis is contiguous in memory.
    """
    faces, index = _visible_faces(hits.face, len(mesh.faces))
    first, second, third = (
        mesh.vertices[mesh.faces[faces, corner]].astype(np.float64) for corner in range(3)
    )
    normal = np.cross((second - first).T, (third - first).T, axis=0)
    # The camera sees a triangle from its own side of the triangle's plane.
    normal *= np.where(np.sum(normal * (camera.pose[:3, 3] - first).T, axis=0) < 0.0, -1.0, 1.0)
    normal /= np.maximum(np.sqrt(np.sum(normal * normal, axis=0)), 1e-300)
    # The entry after the last face is the background's.
    table = np.zeros((3, len(faces) + 1), np.float32)
    table[:, :-1] = normal
    image = np.moveaxis(np.stack([np.take(axis, index) for axis in table]), 0, -1)
    if camera.rows_move:
        # A row can see another side of a triangle than the row before.
        away = np.sum(image * world_directions(camera, hits.rows), axis=-1) > 0.0
        image[away] *= np.float32(-1.0)
    return image


def depth_z(hits: Hits, camera: Camera) -> NDArray[np.float32]:
    """`(h, w)` metres along the optical axis that each ray's camera has; inf in the background."""
    return (hits.distance * camera.pixel_directions(hits.rows)[..., 2]).astype(np.float32)


def positions(hits: Hits, camera: Camera) -> NDArray[np.float64]:
    """`(h, w, 3)` hit points in world coordinates, metres; inf in the background."""
    is_hit = hits.face >= 0
    # Infinity times 0 would be NaN.
    centre = centres(camera, hits.rows)
    points = np.where(is_hit, hits.distance, 0.0)[..., None] * world_directions(camera, hits.rows) + centre
    points[~is_hit] = np.inf
    return points


def world_directions(camera: Camera, rows: slice) -> NDArray[np.float64]:
    """`(h, w, 3)` unit world directions of the rays through the pixels' centres of some rows."""
    x, y, z = np.moveaxis(camera.pixel_directions(rows), -1, 0)
    directions = np.empty((3, *x.shape))
    rotation = camera.pose[:3, :3]
    if camera.rows_move:
        # One rotation for each row, `(3, 3, h, 1)`.
        poses = camera.label_poses(np.arange(camera.height)[rows] + 0.5)
        rotation = np.moveaxis(poses[:, :3, :3], 0, -1)[..., None]
    # Axis by axis: BLAS splits such products between threads, and its last bits depend on their number.
    for axis, (along_x, along_y, along_z) in enumerate(rotation):
        directions[axis] = along_x * x + along_y * y + along_z * z
    return np.moveaxis(directions, 0, -1)


def centres(camera: Camera, rows: slice) -> NDArray[np.float64]:
    """Projection centres of the rays through pixels of some rows, world metres: `(3,)`, or `(h, 1, 3)`."""
    if not camera.rows_move:
        return camera.pose[:3, 3]
    return camera.label_centres(np.arange(camera.height)[rows] + 0.5)[:, None]


def surface_coordinates(mesh: Mesh, hits: Hits, camera: Camera) -> NDArray[np.float32]:
    """`(h, w, 2)` surface coordinates in [0, 1], linear over each triangle; -1 in the background."""
    uv = np.full((hits.face.size, 2), -1.0, np.float32)
    for points in surface_points(mesh, hits, camera, np.flatnonzero(hits.face >= 0)):
        uv[points.pixels] = points.interpolate(mesh.uv)
    return uv.reshape(*hits.face.shape, 2)


@dataclass(frozen=True, eq=False)
class SurfacePoints:
    """Where the rays of some pixels meet their triangles."""

    pixels: NDArray[np.intp]  # `(n,)` index of each pixel in the rows of the hits, row by row
    face: NDArray[np.int64]  # `(n,)` index of the triangle hit
    corners: NDArray[np.uint32]  # `(n, 3)` its vertices
    u: NDArray[np.float64]  # `(n,)` weight of the second corner
    v: NDArray[np.float64]  # `(n,)` weight of the third

    def interpolate(self, values: NDArray[np.float32]) -> NDArray[np.float64]:
        """`(n, ...)` values of the vertices `(v, ...)`, linear over each triangle."""
        u, v = self.u, self.v
        first, second, third = (values[self.corners[:, corner]].T for corner in range(3))
        result: NDArray[np.float64] = ((1.0 - u - v) * first + u * second + v * third).T
        return result


def surface_points(
    mesh: Mesh, hits: Hits, camera: Camera, pixels: NDArray[np.intp]
) -> Iterator[SurfacePoints]:
    """Yield the points behind pixels that hit a surface, at most `_UV_PIXELS` at a time.

    The position in the triangle is computed in double precision, as in `normals`: single precision loses the
    aspect ratio of a needle-like triangle.

    Args:
        mesh: of the hits.
        hits: of the image.
        camera: of the image.
        pixels: `(n,)` their indices in the rows of the hits, row by row.

    Method: T. Moeller and B. Trumbore, "Fast, minimum storage ray-triangle intersection", Journal of Graphics
    Tools 2 (1997) 21.
    """
    if not pixels.size:
        return
    face, rays = hits.face.ravel(), world_directions(camera, hits.rows).reshape(-1, 3)
    centre = centres(camera, hits.rows)
    of_pixels = np.broadcast_to(centre, (*hits.face.shape, 3)).reshape(-1, 3) if centre.ndim > 1 else None
    for start in range(0, pixels.size, _UV_PIXELS):
        part = pixels[start : start + _UV_PIXELS]
        origins = centre[:, None] if of_pixels is None else of_pixels[part].T
        yield _points_of_hits(mesh, part, face[part], rays[part].T, origins)


def _points_of_hits(
    mesh: Mesh,
    pixels: NDArray[np.intp],
    face: NDArray[np.int64],
    ray: NDArray[np.float64],
    start: NDArray[np.float64],
) -> SurfacePoints:
    """The points where rays `(3, n)` from points `(3, n)` or `(3, 1)` meet triangles."""
    corners = mesh.faces[face]
    first, second, third = (mesh.vertices[corners[:, corner]].astype(np.float64).T for corner in range(3))
    edge1, edge2 = second - first, third - first
    origin = start - first
    p, q = np.cross(ray, edge2, axis=0), np.cross(origin, edge1, axis=0)
    determinant = (edge1 * p).sum(axis=0)
    # Rounding can put a ray next to its triangle, and in a degenerate triangle it has no position.
    with np.errstate(divide="ignore", invalid="ignore"):
        u = np.nan_to_num(np.clip((origin * p).sum(axis=0) / determinant, 0.0, 1.0))
        v = np.nan_to_num(np.clip((ray * q).sum(axis=0) / determinant, 0.0, 1.0 - u))
    return SurfacePoints(pixels, face, corners, u, v)


def _visible_faces(face: NDArray[np.int64], count: int) -> tuple[NDArray[np.intp], NDArray[np.uint32]]:
    """The faces in view, ascending, and each pixel's index into them; the background's is the last."""
    # One entry more than there are faces: the one that index -1 finds.
    is_visible = np.zeros(count + 1, dtype=bool)
    is_visible[face] = True
    is_visible[-1] = False
    faces = np.flatnonzero(is_visible)
    # Entries without a value are never read, so memory is touched only where faces are in view.
    index = np.empty(count + 1, dtype=np.uint32)
    index[faces] = np.arange(len(faces), dtype=np.uint32)
    index[-1] = len(faces)
    return faces, index[face]
