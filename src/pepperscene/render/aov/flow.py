"""Optical flow: displacement and visibility, in another camera, of the surface behind each pixel.

Both cameras see one scene in which nothing moves: the next frame of a path, or a stereo partner. The position
of a point in the other image follows from the lens formula in double precision; whether it is hidden there,
from one ray per pixel out of the other projection centre. If the rows of an image have their own poses,
the pose of the pixel's row is used, and that of the row in which the point is in the other image.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.camera import Camera
from pepperscene.render.aov.labels import Hits, positions, world_directions
from pepperscene.render.arrays import LocalCoordinates, device_array, device_float
from pepperscene.render.variant import mitsuba_modules

CLEARANCE: Final = 1e-4
"""Chosen, relative to the distance: an occluder is closer than the point by more than this. At 40 cm it is
0.04 mm, less than the thickness of a leaf. Single precision misplaces hits by a thousandth of that, and by as
much as that where a ray meets a surface at 0.03 degrees."""

_SKY_M: Final = 1e9
"""Chosen: distance of the sky from a camera that moves during the readout; a metre shifts it by 1e-9 rad."""


def optical_flow(
    scene: Any, coordinates: LocalCoordinates, hits: Hits, camera: Camera, other: Camera | None
) -> NDArray[np.float32]:
    """Compute the flow from a camera, in the rows of some hits, to another camera of the same scene.

    Returns:
        `(h, w, 3)` displacement from each pixel's centre to the same point in the other image, pixels right
        and down, and its visibility there: 1 if it is inside the image and not hidden, else 0. The sky is
        infinitely far away. Behind the other camera, or without one, a point has no position: nan.
    """
    shape = hits.face.shape
    flow = np.full((*shape, 3), np.nan, np.float32)
    flow[..., 2] = 0.0
    if other is None:
        return flow
    sky = hits.face < 0
    points, directions = positions(hits, camera), world_directions(camera, hits.rows)
    # The points as vectors from the other camera; for the sky only the direction matters.
    centre = other.pose[:3, 3]
    vectors = points - centre
    vectors[sky] = directions[sky] * (_SKY_M if other.rows_move else 1.0)
    pixels = other.project(centre + vectors.reshape(-1, 3)).reshape(*shape, 2)
    inside = (pixels >= 0.0).all(axis=-1) & (pixels < [other.width, other.height]).all(axis=-1)

    row, column = np.mgrid[: shape[0], : shape[1]] + 0.5
    flow[..., 0] = pixels[..., 0] - column
    flow[..., 1] = pixels[..., 1] - (row + hits.top)
    if inside.any():
        seen_from, towards = centre, vectors[inside]
        if other.rows_move:
            # Each point is seen from where its row in the other image is exposed.
            seen_from = other.label_centres(pixels[inside][:, 1])
            towards = np.where(sky[inside][:, None], directions[inside], points[inside] - seen_from)
        start = coordinates.from_world(seen_from)
        flow[inside, 2] = is_unoccluded(scene, start, towards / coordinates.unit_m, hits.face[inside])
    return flow


def is_unoccluded(
    scene: Any, start: NDArray[np.float64], vectors: NDArray[np.float64], face: NDArray[np.int64]
) -> NDArray[np.bool_]:
    """`(n,)` whether nothing is between a start point and the points at `vectors` from it.

    Args:
        scene: Mitsuba's.
        start: `(3,)` in local coordinates, or `(n, 3)`.
        vectors: `(n, 3)` in local units; for the sky only the directions matter.
        face: `(n,)` triangle of each point, -1 for the sky.
    """
    mi, dr = mitsuba_modules()
    origin = mi.Point3f(*((float(x) if start.ndim == 1 else device_array(x)) for x in start.T))
    dr.make_opaque(origin)
    vector = mi.Vector3f(*(device_array(axis) for axis in vectors.T))
    # As unsigned integers: the sky's number belongs to no face.
    own_face = device_array(face.astype(np.uint32), np.uint32)
    distance = dr.norm(vector)
    hit = scene.ray_intersect_preliminary(mi.Ray3f(origin, vector / distance), coherent=True)
    sky = own_face == 0xFFFFFFFF
    closer = hit.t < distance * device_float(1.0 - CLEARANCE)
    # A point is never hidden by its own triangle, however grazing the ray.
    hidden = hit.is_valid() & (sky | (closer & (hit.prim_index != own_face)))
    return ~np.array(hidden)[: len(face)]
