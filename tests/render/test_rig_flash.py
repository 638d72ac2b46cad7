"""The flash of a rig: at the main camera, for all cameras and both integrators."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from bodies import axis_camera, even_lamp, matt, sheet
from scipy.spatial.transform import Rotation

from pepperscene.camera import AngularProfile, Camera, load_flash, load_lens, load_sensor, look_at
from pepperscene.recipe.camera_tables import RigCamera
from pepperscene.recipe.resolve.camera_views import _with_flash_of_rig
from pepperscene.render import Quality, Renderer
from pepperscene.render.kernel.camera import RayPose, camera_rays
from pepperscene.render.transport.lights import FlashSampler
from pepperscene.render.variant import mitsuba_modules
from pepperscene.scene import assemble_scene
from pepperscene.spectra import Spectrum

FLASH = load_flash("led_matrix_200klx")
MAIN = Camera(
    load_lens("lensagon_cmfa0420nd"),
    load_sensor("ueye_ui5250re"),
    look_at((0.1, -0.5, 1.2), (0.0, 0.3, 1.4)),
    flash=FLASH,
)


def points_and_falloffs(camera, targets, samples):
    mi, _ = mitsuba_modules()
    rays = camera_rays(camera)
    sampler = FlashSampler(camera.flash, rays)
    pose = RayPose(rays.rotation, rays.origin)
    points, falloffs = sampler.sample_point(mi.Point3f(targets.T), mi.Point2f(samples.T), pose)
    return np.array(points).T, np.array(falloffs)


def test_points_that_are_not_numbers_get_no_light_of_the_flash():
    """Rays without a hit leave such points behind, or any bits; no table may be read outside its ends.

    Without AVX-512 the number of their entry is -2^31, and reading it ends the process.
    """
    targets = np.repeat([[np.nan] * 3, [np.inf] * 3, [0.0, np.nan, 1.0], [1e38, -1e38, 1e38]], 64, axis=0)
    samples = np.random.default_rng(1).random((len(targets), 2))
    _, falloffs = points_and_falloffs(MAIN, targets, samples)
    np.testing.assert_array_equal(falloffs, 0.0)


@pytest.mark.parametrize("rotation_deg", [(0, 0, 0), (-20, 30, 45)])
def test_flash_stays_at_the_main_camera_for_all_cameras_of_a_rig(rotation_deg):
    rig = RigCamera(name="side", position_mm=(60, -20, 10), rotation_deg=rotation_deg)
    other = _with_flash_of_rig(MAIN.at_pose(MAIN.pose @ rig.extrinsics), rig.extrinsics)
    world = [
        camera.flash.emitter_positions() @ camera.pose[:3, :3].T + camera.pose[:3, 3]
        for camera in (MAIN, other)
    ]
    np.testing.assert_allclose(world[1], world[0], atol=1e-12)

    rng = np.random.default_rng(3)
    targets = rng.uniform(-0.3, 0.3, (200, 3)) + np.array([0.0, 0.2, 1.4])
    samples = rng.random((200, 2))
    expected, actual = (points_and_falloffs(camera, targets, samples) for camera in (MAIN, other))
    np.testing.assert_allclose(actual[0], expected[0], atol=2e-6)
    np.testing.assert_allclose(actual[1], expected[1], rtol=2e-4, atol=1e-6)
    assert expected[1].max() > 0


def test_rig_cameras_turn_right_up_and_clockwise():
    forward = [RigCamera(name="a", rotation_deg=turn).extrinsics[:3, 2] for turn in ((30, 0, 0), (0, 30, 0))]
    half, root = 0.5, np.sqrt(0.75)
    np.testing.assert_allclose(forward, [[half, 0, root], [0, -half, root]], atol=1e-12)
    right = RigCamera(name="a", rotation_deg=(0, 0, 90)).extrinsics[:3, 0]
    np.testing.assert_allclose(right, [0, 1, 0], atol=1e-12)


@pytest.mark.parametrize("integrator", ["flash", "path"])
def test_a_turned_flash_lights_a_plane_as_its_profile_says(integrator):
    # A point lamp beside the camera, turned to the left and up: E = I p(theta) cos(incidence) / d^2.
    rotation = Rotation.from_euler("YXZ", [-15.0, 10.0, 40.0], degrees=True).as_matrix()
    offset = np.array([0.06, -0.03, 0.02])
    angle = np.radians(np.arange(0.0, 90.1, 0.5))
    profile = AngularProfile(angle, np.cos(np.minimum(angle, np.pi / 2)) ** 4)
    nm = np.array([300.0, 1100.0])
    lamp = replace(even_lamp(Spectrum(nm, np.ones(2))), profile=profile, offset_m=tuple(offset))
    view = axis_camera(24, 16, flash=replace(lamp, rotation=rotation))
    sensor = replace(view.sensor, binning=20 * view.sensor.binning)
    view = replace(view, sensor=sensor, developing=replace(view.developing, falloff=False))
    scene = assemble_scene(sheet(4.0, 4.0, 0.5, "white"), {"white": matt("white", nm, np.full(2, 0.8))})
    quality = Quality(1024, 1024, 1024, 0, None, False, integrator)
    electrons = Renderer(scene).render(view, ["electrons"], quality)["electrons"][..., 1]

    directions = view.pixel_directions()
    from_lamp = directions * (0.5 / directions[..., 2:]) - offset
    distance = np.linalg.norm(from_lamp, axis=-1)
    cosine = from_lamp @ rotation[:, 2] / distance
    expected = np.clip(cosine, 0.0, None) ** 4 * from_lamp[..., 2] / distance**3
    np.testing.assert_allclose(electrons / electrons.mean(), expected / expected.mean(), atol=0.01)
    # The turn matters.
    straight = (from_lamp[..., 2] / distance) ** 4 * from_lamp[..., 2] / distance**3
    assert np.abs(straight / straight.mean() - expected / expected.mean()).max() > 0.2
