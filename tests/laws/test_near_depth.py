"""Depth of what is nearer than a depth camera can measure: holes, except where alignment looks past it.

The nearest depth is focal length times baseline over the disparities that are compared. A card is nearer, in
front of a plane. In the pixels of the left imager the card is a hole. From a camera beside it, the imager
sees the plane past the card's edge, and alignment, which knows nothing of the card, puts that depth onto the
card, as librealsense does: https://github.com/IntelRealSense/librealsense/issues/2445.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from bodies import card
from planes import ALONG_Y, d435, plane

from pepperscene.camera import Partners
from pepperscene.geometry import concatenate_meshes
from pepperscene.materials import lambertian_surface
from pepperscene.render import Renderer
from pepperscene.scene import assemble_scene

PLANE_M = 0.6


def test_the_depth_of_a_near_card_is_a_hole():
    depth_camera, card_m = d435(), 0.1
    nearest = depth_camera.disparity_m / depth_camera.matching.disparities
    assert card_m < nearest
    square = card(0.0, 0.0, 0.6 * card_m, 0.6 * card_m, "matt", card_m).moved(ALONG_Y, np.zeros(3))
    whole = concatenate_meshes([plane(PLANE_M, 0.0).mesh, square])
    renderer = Renderer(assemble_scene(whole, {"matt": lambertian_surface("matt", 0.5)}, None))
    left = depth_camera.left

    # The pixels of the imager.
    frame = renderer.render(
        left, ("depth_sensor", "depth_z"), "draft", 5, partners=Partners(depth=depth_camera)
    )
    near = frame["depth_z"] < nearest
    assert near.mean() > 0.05
    assert np.isfinite(frame["depth_sensor"][near]).mean() < 0.05

    # A camera 15 mm to its left sees the card that much farther to the right than the plane.
    offset = 0.015
    pose = left.pose.copy()
    pose[:3, 3] -= offset * pose[:3, 0]
    frame = renderer.render(
        replace(left, pose=pose),
        ("depth_sensor", "depth_z"),
        "draft",
        5,
        partners=Partners(depth=depth_camera),
    )
    near = frame["depth_z"] < nearest
    known = near & np.isfinite(frame["depth_sensor"])
    parallax = left.intrinsics[0, 0] * offset * (1.0 / card_m - 1.0 / PLANE_M)
    columns = np.flatnonzero(near.any(axis=0))
    # It is the plane's, in a band along the card's edge.
    error = np.abs(frame["depth_sensor"][known] / PLANE_M - 1.0)
    assert np.median(error) < 0.02
    assert (error < 0.1).mean() > 0.7
    inner = known[:, columns[0] : columns[-1] + 1 - int(np.ceil(parallax)) - 10]
    assert inner.mean() < 0.05
