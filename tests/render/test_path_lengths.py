"""Paths go on where few bounces would lose much light, and then lose none."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from bodies import EVEN_SKY, axis_camera, body, matt, sheet
from greenhouse import camera, greenhouse

from pepperscene.materials import lambertian_surface
from pepperscene.render import QUALITIES, Quality, Renderer
from pepperscene.render.kernel.camera import spectral_response
from pepperscene.render.transport import channel_paths
from pepperscene.render.transport.path_lengths import ROULETTE, mean_albedo, needs_long_paths
from pepperscene.scene import assemble_scene, uniform_sky
from pepperscene.spectra import sky_spectrum

NM = np.arange(400.0, 901.0, 5.0)


def plain(bounces: int, most: int, samples: int = 64) -> Quality:
    return Quality(samples, samples, samples, bounces, target=None, denoise=False, most_bounces=most)


def box_open_to_the_camera(reflectance: float):
    """A box as deep as wide under a uniform sky, seen through its open end."""
    solid = trimesh.creation.box((0.2, 0.2, 0.2))
    solid.apply_translation([0.0, 0.0, 0.5])
    solid.update_faces(solid.face_normals[:, 2] > -0.5)
    solid.unmerge_vertices()
    surfaces = {"white": lambertian_surface("white", reflectance)}
    return assemble_scene(body(solid, "white"), surfaces, EVEN_SKY)


def electrons(scene, view, quality, seed=1):
    return Renderer(scene).render(view, ["electrons"], quality, seed)["electrons"].astype(float)


def test_lossless_box_is_as_bright_as_the_sky_only_with_long_paths():
    # No light is lost in it, so that all directions have the radiance of the sky (white furnace).
    view = axis_camera(12, 8, flash=None)
    view = replace(view, sensor=replace(view.sensor, binning=20))
    sky = electrons(
        box_open_to_the_camera(1.0), replace(view, pose=view.pose @ np.diag([1.0, -1, -1, 1])), plain(2, 0)
    )
    long = electrons(box_open_to_the_camera(1.0), view, plain(2, 64, 1024))
    assert long.mean((0, 1)) / sky.mean((0, 1)) == pytest.approx([1.0] * 3, abs=0.01)
    short = electrons(box_open_to_the_camera(1.0), view, plain(2, 0, 256))
    assert short.mean() < 0.97 * sky.mean()


def test_loop_follows_the_same_paths_as_without_it(monkeypatch):
    # With the same Russian roulette, eight bounces are the same light, in a loop of the kernel or not.
    monkeypatch.setattr(channel_paths, "LONG_ROULETTE", ROULETTE)
    scene, view = greenhouse(), camera(flash=False)
    without, looped = (electrons(scene, view, plain(*lengths, 4)) for lengths in ((8, 0), (2, 8)))
    np.testing.assert_allclose(looped, without, rtol=1e-3, atol=1e-5 * without.max())


def leaf_scene(sky=None):
    """A body that is dark in the visible and bright from 705 nm on, as leaves are."""
    reflectance = np.where(NM < 705.0, 0.1, 0.9)
    return assemble_scene(sheet(1.0, 1.0, 0.5, "leaf"), {"leaf": matt("leaf", NM, reflectance)}, sky)


def needs(scene, view) -> bool:
    return needs_long_paths(scene, spectral_response(view, scene))


def test_frames_by_the_flash_have_long_paths_only_where_surfaces_are_bright():
    visible = axis_camera()
    assert not needs(leaf_scene(), visible)
    faint = uniform_sky(sky_spectrum("d65"), 5500.0)  # as in `barth2018`, next to 200,000 lx
    assert not needs(leaf_scene(faint), visible)
    white = assemble_scene(sheet(1.0, 1.0, 0.5, "white"), {"white": lambertian_surface("white", 0.9)})
    assert needs(white, visible)


def test_frames_by_daylight_have_long_paths():
    assert needs(leaf_scene(EVEN_SKY), axis_camera(flash=None))
    assert needs(leaf_scene(uniform_sky(sky_spectrum("d65"), 80_000.0)), axis_camera())


def test_mean_albedo_counts_triangles():
    scene = greenhouse()
    counts = np.bincount(scene.mesh.face_surface, minlength=len(scene.surfaces))
    at = np.array([550.0])
    albedos = [
        np.interp(at, s.wavelength_nm, s.reflectance.mean((0, 1)) + s.transmittance.mean(0))[0]
        for s in scene.surfaces
    ]
    assert mean_albedo(scene, at)[0] == pytest.approx(np.average(albedos, weights=counts))
    assert all(quality.most_bounces > quality.bounces for quality in QUALITIES.values())
