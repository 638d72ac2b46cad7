"""Matt planes in front of a depth camera, by the pattern of its projector or by daylight."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import trimesh
from bodies import body

from pepperscene.camera import (
    Camera,
    DepthCamera,
    Developing,
    ExposureControl,
    StereoMatching,
    load_lens,
    load_projector,
    load_sensor,
)
from pepperscene.materials import lambertian_surface
from pepperscene.scene import Scene, Sky, assemble_scene

ALONG_Y = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
"""From camera axes to a world in which the camera looks along +y, and z is up."""


def plane(z: float, tilt_deg: float = 8.0, reflectance: float = 0.5, sky: Sky | None = None) -> Scene:
    """A plane of 8 m at the distance z in front of `d435`, that is nearer on its left."""
    slope = np.tan(np.radians(tilt_deg))
    corners = np.array([[x, y, z + slope * x] for x, y in ((-4, -4), (4, -4), (4, 4), (-4, 4))])
    flat = trimesh.Trimesh(corners, [[0, 1, 2], [0, 2, 3]], process=False)
    mesh = body(flat, "matt").moved(ALONG_Y, np.zeros(3))
    return assemble_scene(mesh, {"matt": lambertian_surface("matt", reflectance)}, sky)


def d435(
    columns: int = 424,
    rows: int = 240,
    *,
    projector: bool = True,
    exposure_s: float | None = None,
    **matching: object,
) -> DepthCamera:
    """A RealSense D435 at the origin, with automatic exposure unless a time is given."""
    pose = np.eye(4)
    pose[:3, :3] = ALONG_Y
    left = Camera(
        load_lens("realsense_d435_infrared"),
        load_sensor("realsense_d435_infrared").with_size(columns, rows),
        pose,
        exposure_s or 1e-3,
        developing=Developing(white_balance="daylight"),
    )
    return DepthCamera(
        left,
        0.05,
        load_projector("realsense_d435") if projector else None,
        replace(StereoMatching(disparities=64), **matching),  # type: ignore[arg-type]
        None if exposure_s else ExposureControl(longest_s=0.033, most_gain=15.5),
    )


def disparity_errors(depth_camera: DepthCamera, measured: np.ndarray, exact: np.ndarray) -> np.ndarray:
    """Errors in pixels of disparity in the middle of an image, a quarter of its area; nan in holes."""
    rows, columns = measured.shape
    middle = slice(rows // 4, -rows // 4), slice(columns // 4, -columns // 4)
    return depth_camera.disparity_m * (1.0 / measured[middle].astype(float) - 1.0 / exact[middle])
