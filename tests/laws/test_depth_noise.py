"""The noise of a depth camera's depth, against published figures of the RealSense D435.

The RMS of the depth of a plane is z^2 times a subpixel error over focal length and baseline, and the subpixel
error of a well-textured plane is 0.05 to 0.1 pixels (Grunnet-Jepsen, Sweetser & Woodfill, Intel 2018:
"Best-known-methods for tuning Intel RealSense D400 depth cameras for best performance").
"""

from __future__ import annotations

import numpy as np
import pytest
from planes import d435, disparity_errors, plane

from pepperscene.camera import Partners
from pepperscene.render import Renderer
from pepperscene.scene import partly_cloudy_sky

OUTPUTS = ("depth_sensor", "depth_z")
MODE = 848, 480  # the mode that Intel recommends


def errors(distance_m: float, depth_camera, sky=None):
    frame = Renderer(plane(distance_m, sky=sky)).render(
        depth_camera.left, OUTPUTS, "draft", 5, partners=Partners(depth=depth_camera)
    )
    return disparity_errors(depth_camera, frame["depth_sensor"], frame["depth_z"])


def sunny(illuminance_lx: float):
    """Most of it from a sun behind the camera, at half height."""
    return partly_cloudy_sky(
        np.random.default_rng(0),
        illuminance_lx=illuminance_lx,
        sun_azimuth_rad=np.radians(-90.0),
        sun_elevation_rad=np.radians(45.0),
        sun_fraction=0.8,
        cloud_cover=0.2,
    )


def subpixel(error: np.ndarray) -> float:
    return float(np.sqrt(np.nanmean(error**2)))


@pytest.mark.long
def test_depth_noise_at_many_distances():
    depth_camera = d435(*MODE)
    distances = np.array([0.5, 0.75, 1.0, 1.25, 1.5, 2.0])
    found = np.array([subpixel(errors(z, depth_camera)) for z in distances])
    np.testing.assert_allclose(found / found.mean(), 1.0, atol=0.15)
    power = np.polyfit(np.log(distances), np.log(distances**2 * found), 1)[0]
    assert power == pytest.approx(2.0, abs=0.15)
    assert 0.05 / 1.15 < found.mean() < 0.1 * 1.15


def test_sunlight_outshines_the_pattern_on_a_plane_without_texture():
    indoors, outdoors = (errors(1.0, d435(), sunny(lx)) for lx in (300.0, 100_000.0))
    assert np.isfinite(indoors).mean() > 0.95
    assert subpixel(indoors) < 0.2
    # Nothing is left to match, as without the projector.
    assert (np.abs(outdoors) < 1.0).mean() < 0.02
    assert np.isnan(outdoors).mean() > 0.9


def test_without_a_projector_a_plane_without_texture_is_a_hole():
    assert np.isnan(errors(0.5, d435(projector=False), sunny(1000.0))).mean() > 0.9
