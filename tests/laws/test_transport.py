"""Our integrator against Mitsuba's own path tracer and emitters, over the same BSDF, rays and wavelengths."""

from __future__ import annotations

import numpy as np
import pytest
from bodies import bench_camera, sheet, sphere

from pepperscene.camera import AngularProfile
from pepperscene.geometry import concatenate_meshes
from pepperscene.materials import Surface, lambertian_surface
from pepperscene.render.kernel.camera import camera_rays, spectral_response
from pepperscene.render.kernel.scene import light_scene, sky_tables
from pepperscene.render.reference.path_tracer import path_scene, path_traced
from pepperscene.render.transport.trace import Sampling, trace
from pepperscene.render.variant import mitsuba_modules
from pepperscene.scene import Sun, assemble_scene, uniform_sky
from pepperscene.scene.sky import Sky
from pepperscene.spectra import Spectrum

NM = np.arange(380.0, 781.0, 5.0)


def glossy_leaf() -> Surface:
    red_edge = 0.05 + 0.4 / (1.0 + np.exp(-(NM - 600.0) / 15.0))
    both = np.stack([red_edge, red_edge * 1.1])[None].repeat(3, axis=0)
    return Surface("leaf", NM, both, 0.8 * red_edge[None].repeat(3, axis=0), 1.45, (0.25, 0.4))


def scene_with(sky):
    mesh = concatenate_meshes(
        [
            sphere((0.03, 0.02, 0.45), 0.06, "matt", subdivisions=3),
            sheet(0.15, 0.4, 0.4, "leaf").moved(np.eye(3), np.array([-0.12, 0.0, 0.0])),
            sheet(2.0, 2.0, 0.6, "matt"),
        ]
    )
    return assemble_scene(mesh, {"matt": lambertian_surface("matt", 0.6), "leaf": glossy_leaf()}, sky)


def theirs_traced(scene, camera, emitters, spp: int, bounces: int) -> np.ndarray:
    """`(batches, h, w, 3)`: Mitsuba's `path` along our rays, with its own emitters and its own sampling."""
    built = path_scene(scene, camera, emitters=emitters)
    return np.array(
        [
            path_traced(scene, camera, spp=spp, bounces=bounces, seed=100 + batch, kernel_scene=built)
            for batch in range(8)
        ]
    )


def ours_traced(scene, camera, spp: int, bounces: int) -> np.ndarray:
    spectral = spectral_response(camera, scene)
    built = light_scene(scene, float(spectral.grid_nm[0]), float(spectral.grid_nm[-1]))
    sky = sky_tables(scene, spectral.grid_nm)
    view = camera_rays(camera)
    batches = []
    for batch in range(8):
        light = trace(built, view, spectral, camera.flash, sky, Sampling(spp, spp, bounces), seed=batch)
        batches.append(light.total())
    return np.array(batches)


def spectrum_entry(nm, values):
    return {
        "type": "irregular",
        "wavelengths": ", ".join(map(str, nm)),
        "values": ", ".join(f"{v:.9g}" for v in values),
    }


def assert_agree(ours: np.ndarray, theirs: np.ndarray) -> None:
    """Two-sample t-tests over 8 + 8 batches on 8x8 blocks; the smallest p-value, Bonferroni-corrected, must
    exceed 0.001. A bias of 1 % of the mean in a tenth of the blocks fails it."""
    from scipy.stats import ttest_ind

    def blocks(batches):
        n, h, w, c = batches.shape
        return batches.astype(float).reshape(n, h // 8, 8, w // 8, 8, c).mean((2, 4)).reshape(n, -1)

    a, b = blocks(ours), blocks(theirs)
    p = ttest_ind(a, b, equal_var=False).pvalue
    p = p[np.isfinite(p)]
    assert p.size > 100
    assert p.min() * p.size > 1e-3, (p.min(), p.size, a.mean() / b.mean())
    assert a.mean() == pytest.approx(b.mean(), rel=0.01)


def spot_camera():
    """A camera with a point flash beside it, and that flash as Mitsuba's own emitter."""
    beam, cutoff = np.radians(15.0), np.radians(30.0)
    profile = AngularProfile(np.array([0.0, beam, cutoff]), np.array([1.0, 1.0, 0.0]))
    camera = bench_camera(
        columns=80,
        rows=64,
        radius_m=0.0,
        emitters_m=np.zeros((1, 2)),
        offset_m=(0.01, -0.02, 0.0),
        profile=profile,
    )
    # The cut-out keeps the full lens: 80 columns are its middle, so spread the view by moving back a little.
    pose = np.eye(4)
    pose[2, 3] = -0.6
    camera = camera.at_pose(pose)
    mi, _ = mitsuba_modules()
    origin = pose[:3, 3] + np.array(camera.flash.offset_m)
    intensity = camera.flash.radiant_intensity(NM) * camera.flash_duty
    spot = {
        "type": "spot",
        "to_world": mi.ScalarTransform4f().look_at(
            origin.tolist(), (origin + np.array([0, 0, 1])).tolist(), [0, 1, 0]
        ),
        "beam_width": 15.0,
        "cutoff_angle": 30.0,
        "intensity": spectrum_entry(NM, intensity),
    }
    return camera, spot


def sun_alone(irradiance: float):
    """A sun without a sky, as ours and as Mitsuba's."""
    towards = np.array([0.4, -0.5, -1.0]) / np.linalg.norm([0.4, -0.5, -1.0])
    spectrum = np.full(NM.size, irradiance)
    sun = Sun(towards, Spectrum(NM, spectrum), angular_radius=1e-4)
    sky = Sky(np.full((1, 2, 4), 1e-9, np.float32), Spectrum(NM, np.ones((1, NM.size))), sun)
    theirs = {
        "type": "directional",
        "direction": (-towards).tolist(),
        "irradiance": spectrum_entry(NM, spectrum),
    }
    return sky, theirs


def test_spot_and_sky_agree_with_the_path_tracer():
    camera, spot = spot_camera()
    scene = scene_with(uniform_sky(Spectrum(NM, 1.0 + 0.001 * (NM - 550.0)), 60_000.0))
    sky = {"type": "constant", "radiance": spectrum_entry(NM, scene.sky.radiance.values[0])}
    emitters = {"flash": spot, "sky": sky}
    assert_agree(ours_traced(scene, camera, 64, 2), theirs_traced(scene, camera, emitters, 256, 2))


def test_sun_agrees_with_the_path_tracer():
    camera = bench_camera(columns=80, rows=64, flash=False)
    pose = np.eye(4)
    pose[2, 3] = -0.6
    camera = camera.at_pose(pose)
    sky, sun = sun_alone(2.0)
    scene = scene_with(sky)
    assert_agree(ours_traced(scene, camera, 64, 2), theirs_traced(scene, camera, {"sun": sun}, 256, 2))


@pytest.mark.parametrize("irradiance", [0.03, 1.0])
def test_spot_and_sun_agree_with_the_path_tracer(irradiance):
    # Later hits send one shadow ray for both; the first hits' sun is soft light where it is weak.
    camera, spot = spot_camera()
    sky, sun = sun_alone(irradiance)
    scene = scene_with(sky)
    emitters = {"flash": spot, "sun": sun}
    assert_agree(ours_traced(scene, camera, 64, 2), theirs_traced(scene, camera, emitters, 256, 2))
