"""Light of a depth camera's projector on a plane, against its closed form and against a flash."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from bodies import LIGHT_SPEED, PLANCK, card
from planes import ALONG_Y, d435, plane

from pepperscene.camera import Motion
from pepperscene.geometry import concatenate_meshes
from pepperscene.materials import lambertian_surface
from pepperscene.render.kernel.camera import spectral_response
from pepperscene.render.kernel_scene import KernelScene
from pepperscene.render.quality import QUALITIES
from pepperscene.render.transport.projection import projected_light
from pepperscene.render.transport.trace import Sampling, trace
from pepperscene.scene import assemble_scene

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
