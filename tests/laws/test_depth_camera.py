"""A depth camera: light of its projector, noise against published figures, and what is too near.

The RMS of the depth of a plane is z^2 times a subpixel error over focal length and baseline, and that of a
well-textured plane 0.05 to 0.1 pixels (Grunnet-Jepsen, Sweetser & Woodfill, Intel 2018: "Best-known-methods
for tuning Intel RealSense D400 depth cameras for best performance").
"""

from dataclasses import replace

import numpy as np
import pytest
from bodies import LIGHT_SPEED, PLANCK, card
from planes import ALONG_Y, d435, disparity_errors, plane

from pepperscene.camera import Motion, Partners
from pepperscene.geometry import concatenate_meshes
from pepperscene.materials import lambertian_surface
from pepperscene.render import Renderer
from pepperscene.render.kernel.camera import spectral_response
from pepperscene.render.kernel_scene import KernelScene
from pepperscene.render.quality import QUALITIES
from pepperscene.render.transport.projection import projected_light
from pepperscene.render.transport.trace import Sampling, trace
from pepperscene.scene import assemble_scene, partly_cloudy_sky

# --- the projector ------------------------------------------------------------------------------------------


REFLECTANCE, DISTANCE_M = 0.5, 0.8


def lit_by(scene, depth_camera, samples=64):
    """Direct light of the projector in the left imager, `(h, w)`."""
    kernel, projector = KernelScene(scene), depth_camera.projector
    lit = replace(depth_camera.left, flash=projector.flood())
    response = spectral_response(lit, scene)
    light_scene = kernel.light_scene(float(response.grid_nm[0]), float(response.grid_nm[-1]))
    rays = kernel.rays(depth_camera.left)
    dots = projected_light(light_scene, rays, response, projector, samples, 1)
    flood = trace(light_scene, rays, response, lit.flash, None, Sampling(16, 1, 0), 1).flash
    return dots[..., 0], flood[..., 0]


def test_mean_light_of_the_dots_follows_from_the_power():
    depth_camera = d435(212, 120)
    dots, flood = lit_by(plane(DISTANCE_M, 0.0), depth_camera)
    right, down = depth_camera.projector.half_slopes
    # Dots are equally dense in slopes, so the plane is lit evenly: power over area.
    irradiance = 0.36 / (4.0 * right * down * DISTANCE_M**2)
    efficiency = depth_camera.left.sensor.quantum_efficiency.at([850.0])[0, 0]
    per_joule = efficiency * 850e-9 / (PLANCK * LIGHT_SPEED)
    expected = irradiance * REFLECTANCE / np.pi * per_joule
    middle = np.s_[30:90, 60:150]
    assert dots[middle].mean() == pytest.approx(expected, rel=0.02)
    # The flash that stands for light that is scattered again is as strong.
    assert flood[middle].mean() == pytest.approx(expected, rel=0.01)
    # Dots have contrast.
    assert dots[middle].std() > 1.5 * dots[middle].mean()


def test_dots_move_with_the_distance_as_the_projector_is_beside_the_imager():
    # Seen from the projector's own place, the pattern is the same at all distances.
    depth_camera = d435(212, 120)
    at_imager = replace(depth_camera.projector, offset_m=(0.0, 0.0, 0.0))
    same = [lit_by(plane(z, 0.0), replace(depth_camera, projector=at_imager))[0] * z**2 for z in (0.5, 1.0)]
    moved = [lit_by(plane(z, 0.0), depth_camera)[0] * z**2 for z in (0.5, 1.0)]
    assert np.corrcoef(same[0].ravel(), same[1].ravel())[0, 1] > 0.98
    assert np.corrcoef(moved[0].ravel(), moved[1].ravel())[0, 1] < 0.3


def test_a_card_casts_a_shadow_on_its_left_from_a_projector_on_the_right():
    depth_camera = d435(212, 120)
    square = card(0.0, 0.0, 0.1, 0.1, "matt", 0.4).moved(ALONG_Y, np.zeros(3))
    whole = concatenate_meshes([plane(0.8, 0.0).mesh, square])
    scene = assemble_scene(whole, {"matt": lambertian_surface("matt", 0.5)}, None)
    dots, _ = lit_by(scene, depth_camera)
    # Of the edge at x = -0.05 and z = 0.4, seen from the imager at 0 and the projector at 25 mm.
    f, cx = depth_camera.left.intrinsics[0, [0, 2]]
    edge, shadow = cx + f * -0.05 / 0.4, cx + f * (0.025 - 0.075 * 2.0) / 0.8
    assert not dots[55:65, int(shadow) + 2 : int(edge) - 1].any()
    assert dots[55:65, int(shadow) - 12 : int(shadow) - 1].any()


def test_imagers_of_a_moving_camera_see_the_same_dots_when_the_plane_is_across():
    # The projector moves with the imagers, so along a plane across the axis the dots stay in place.
    depth_camera = d435(212, 120, exposure_s=0.01)
    quality, scene = QUALITIES["draft"], plane(DISTANCE_M, 0.0)
    still, moving, approaching = (
        KernelScene(scene).imager_light(
            replace(depth_camera.left, motion=motion),
            depth_camera.projector,
            quality,
            np.random.SeedSequence(1),
            scene,
        )[0]
        for motion in (None, Motion(np.array([2.0, 0.0, 0.0])), Motion(np.array([0.0, 40.0, 0.0])))
    )
    assert np.corrcoef(still.ravel(), moving.ravel())[0, 1] > 0.97
    # Towards the plane the distance changes, so the dots are smeared.
    assert np.corrcoef(still.ravel(), approaching.ravel())[0, 1] < 0.9


# --- noise --------------------------------------------------------------------------------------------------


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


@pytest.mark.long
def test_sunlight_outshines_the_pattern_on_a_plane_without_texture():
    indoors, outdoors = (errors(1.0, d435(), sunny(lx)) for lx in (300.0, 100_000.0))
    assert np.isfinite(indoors).mean() > 0.95
    assert subpixel(indoors) < 0.2
    # Nothing is left to match, as without the projector.
    assert (np.abs(outdoors) < 1.0).mean() < 0.02
    assert np.isnan(outdoors).mean() > 0.9


@pytest.mark.long
def test_without_a_projector_a_plane_without_texture_is_a_hole():
    assert np.isnan(errors(0.5, d435(projector=False), sunny(1000.0))).mean() > 0.9


# --- too near -----------------------------------------------------------------------------------------------


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
