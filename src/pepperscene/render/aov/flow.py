"""Where the surface behind each pixel lies for another camera, and whether it is visible there.

Both views are of one scene, in which nothing moves: the next frame of a path, or a stereo partner. Where a
point appears follows from the lens formula in double precision; whether something hides it there, from one
ray per pixel out of the other projection centre.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.camera import Camera
from pepperscene.render.aov.labels import Hits, points, world_rays
from pepperscene.render.kernel.arrays import LocalCoordinates, device_number, device_table
from pepperscene.render.variant import mitsuba_modules

CLEARANCE: Final = 1e-4
"""Chosen, of the distance: what hides a point stands nearer by more than this. At 40 cm it is 0.04 mm, less
than a leaf is thick. Single precision misplaces hits by a thousandth of that, and by as much as that where a
ray meets a surface at 0.03 degrees."""


def optical_flow(
    scene: Any, region: LocalCoordinates, hits: Hits, camera: Camera, other: Camera
) -> NDArray[np.float32]:
    """`(h, w, 3)` pixels right and down from each pixel's centre to where the same point lies in another
    camera's picture, and 1 where it is visible there, else 0.

    Visible is what lies inside the picture and not behind something else. The sky is infinitely far away. A
    point behind the other camera lies nowhere: nan.

    Args:
        scene: the kernel's.
        region: whose coordinates it has.
        hits: behind the camera's pixels.
        camera: that looks.
        other: camera that looks at the same scene.
    """
    shape = hits.face.shape
    place = other.pose[:3, 3]
    sky = hits.face < 0
    # Towards the points as seen from the other camera; of the sky only the direction counts.
    towards = points(hits, camera) - place
    towards[sky] = world_rays(camera)[sky]
    where = other.project(place + towards.reshape(-1, 3)).reshape(*shape, 2)
    inside = (where >= 0.0).all(axis=-1) & (where < [other.width, other.height]).all(axis=-1)

    found = np.empty((*shape, 3), np.float32)
    row, column = np.mgrid[: shape[0], : shape[1]] + 0.5
    found[..., 0] = where[..., 0] - column
    found[..., 1] = where[..., 1] - row
    found[..., 2] = 0.0
    if inside.any():
        start = region.places(place)
        found[inside, 2] = reached(scene, start, towards[inside] / region.unit, hits.face[inside])
    return found


def nowhere(hits: Hits) -> NDArray[np.float32]:
    """`(h, w, 3)` what `optical_flow` gives where there is no other camera: nan, and not visible."""
    found = np.full((*hits.face.shape, 3), np.nan, np.float32)
    found[..., 2] = 0.0
    return found


def reached(
    scene: Any, start: NDArray[np.float64], towards: NDArray[np.float64], face: NDArray[np.int64]
) -> NDArray[np.bool_]:
    """`(n,)` whether nothing stands between a place and what lies at vectors `(n, 3)` from it.

    Args:
        scene: the kernel's.
        start: the place.
        towards: in the unit of the scene's region; of the sky only the directions.
        face: `(n,)` that the points lie on, -1 for the sky.
    """
    mi, dr = mitsuba_modules()
    origin = mi.Point3f(*(float(x) for x in start))
    dr.make_opaque(origin)
    vector = mi.Vector3f(*(device_table(axis) for axis in towards.T))
    # As whole numbers without a sign: the sky's is one that no face has.
    own = device_table(face.astype(np.uint32), np.uint32)
    distance = dr.norm(vector)
    hit = scene.ray_intersect_preliminary(mi.Ray3f(origin, vector / distance), coherent=True)
    sky = own == 0xFFFFFFFF
    nearer = hit.t < distance * device_number(1.0 - CLEARANCE)
    # A point never hides itself, however flat the ray falls on its triangle.
    hidden = hit.is_valid() & (sky | (nearer & (hit.prim_index != own)))
    return ~np.array(hidden)[: len(face)]
