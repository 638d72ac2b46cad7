"""Colours of scans in the kernel: spectra, colours of sensor channels, and the same in both integrators."""

from __future__ import annotations

from dataclasses import replace

import colour
import numpy as np
import pytest
from bodies import axis_camera, sphere

from pepperscene.errors import ArgumentError
from pepperscene.geometry import concatenate_meshes
from pepperscene.geometry.mesh import PIGMENTS
from pepperscene.materials import Surface
from pepperscene.render import Quality, Renderer
from pepperscene.render.gradients.renderer import DifferentiableRenderer
from pepperscene.render.kernel.scene import light_scene, mitsuba_mesh, organ_table
from pepperscene.render.reference.path_tracer import surface_bsdf
from pepperscene.render.surface.scanned_colours import ScannedColours, srgb_basis
from pepperscene.render.variant import mitsuba_modules
from pepperscene.scene import assemble_scene

GRID = np.arange(380.0, 780.5, 0.5)
RGB = np.array([[0.0, 0.0, 0.0], [1.0, 1.0, 1.0], [0.7, 0.02, 0.01], [0.1, 0.3, 0.05], [0.2, 0.2, 0.9]])
QUALITIES = (
    Quality(samples=64, soft=16, most=64, bounces=2, target=None, denoise=False),
    Quality(256, 256, 256, bounces=2, target=None, denoise=False, integrator="path"),
)
NM = np.array([300.0, 1100.0])
SKIN = Surface("skin", NM, np.array([[[0.1, 0.9]] * 2, [[0.6, 0.2]] * 2]), np.zeros((2, 2)), 1.4, (0.3, 0.3))


def scanned_and_pigmented():
    """Two balls side by side: one with colours that vary from point to point, one with pigments."""
    ball = sphere((-0.02, 0.0, 0.3), 0.018, "skin")
    place = (ball.vertices - ball.bounds[0]) / np.ptp(ball.bounds, axis=0)
    scanned = replace(ball, colour=place.astype(np.float32))
    return concatenate_meshes([scanned, sphere((0.02, 0.0, 0.3), 0.018, "skin")])


@pytest.fixture(scope="module")
def scene():
    return assemble_scene(scanned_and_pigmented(), {"skin": SKIN})


def test_spectra_are_those_of_colour_science_and_conserve_energy():
    basis = srgb_basis(GRID)
    assert basis.min() >= 0.0
    np.testing.assert_allclose(basis.sum(axis=0), 1.0, atol=1e-12)
    for rgb in RGB[1:]:
        spectrum = colour.recovery.RGB_to_sd_Mallett2019(rgb)
        np.testing.assert_allclose(rgb @ srgb_basis(spectrum.wavelengths), spectrum.values, atol=2e-5)
    # The observer sees the colour in D65.
    observer, light = colour.MSDS_CMFS["CIE 1931 2 Degree Standard Observer"], colour.SDS_ILLUMINANTS["D65"]
    matching = [np.interp(GRID, observer.wavelengths, column) for column in observer.values.T]
    weights = np.stack(matching, axis=1) * np.interp(GRID, light.wavelengths, light.values)[:, None]
    xyz = RGB @ basis @ weights / weights[:, 1].sum()
    seen = colour.XYZ_to_RGB(xyz, "sRGB", apply_cctf_encoding=False)
    np.testing.assert_allclose(seen, RGB, atol=2e-3)
    # Nothing is known beyond.
    np.testing.assert_array_equal(
        srgb_basis([300.0, 380.0, 780.0, 1000.0])[:, [0, 3]], srgb_basis([380.0, 780.0])
    )


def test_channels_see_the_mean_and_the_variance_of_the_spectrum():
    mi, _ = mitsuba_modules()
    rng = np.random.default_rng(1)
    fractions = rng.random((GRID.size, 3))
    fractions /= fractions.sum(axis=0)
    packed = ScannedColours.pack(GRID).by_channel(fractions)
    rgb = mi.Vector3f(RGB.T.astype(np.float32))
    mean, variance = packed.body(range(3), rgb, mi.Bool(True))
    spectra = RGB @ srgb_basis(GRID)
    expected = spectra @ fractions
    np.testing.assert_allclose(np.asarray(mean).T, expected, atol=1e-6)
    np.testing.assert_allclose(np.asarray(variance).T, spectra**2 @ fractions - expected**2, atol=1e-6)


def test_colours_at_hits_equal_mesh_attributes(scene):
    mi, dr = mitsuba_modules()
    kernel_scene = light_scene(scene, 400.0, 700.0)
    _, face_organ = organ_table(scene)
    shape = mitsuba_mesh(scene.mesh, surface_bsdf().of(kernel_scene.optics), face_organ=face_organ)
    count, rng = 5000, np.random.default_rng(2)
    target = scene.mesh.vertices[rng.integers(0, len(scene.mesh.vertices), count)]
    ray = mi.Ray3f(mi.Point3f(0.0), dr.normalize(mi.Vector3f(target.T)))
    ray.wavelengths = mi.Spectrum(450.0, 500.0, 600.0, 690.0)
    hit = mi.load_dict({"type": "scene", "mesh": shape}).ray_intersect_preliminary(ray)
    active = hit.is_valid()
    si = hit.compute_surface_interaction(ray, mi.RayFlags.All, active)
    state = shape.eval_attribute_1("vertex_state", si, active)
    seen = shape.eval_attribute_3("vertex_colour", si, active)
    organ = mi.UInt32(shape.eval_attribute_1("face_organ", si, active) + 0.5)
    expected = kernel_scene.optics.point(si, organ, state, active, colour=seen).reflectance
    found = kernel_scene.surface_point(si, hit, active).reflectance
    mask = np.asarray(active)
    np.testing.assert_allclose(np.asarray(found)[:, mask], np.asarray(expected)[:, mask], atol=1e-5)
    # By hand: the colour of a scanned ball is its place, the other has the pigments of the state 0.5.
    rgb, is_scanned = np.asarray(seen)[:, mask], np.asarray(seen)[0, mask] > PIGMENTS / 2
    by_hand = srgb_basis([450.0, 500.0, 600.0, 690.0]).T @ rgb
    pigments = np.interp([450.0, 500.0, 600.0, 690.0], NM, [0.35, 0.55])
    assert 0.3 < is_scanned.mean() < 0.7
    np.testing.assert_allclose(np.asarray(found)[:, mask][:, is_scanned], by_hand[:, is_scanned], atol=2e-3)
    np.testing.assert_allclose(
        np.asarray(found)[:, mask][:, ~is_scanned],
        np.broadcast_to(pigments[:, None], (4, np.count_nonzero(~is_scanned))),
        atol=2e-3,
    )


def test_scene_without_colours_has_no_table(scene):
    plain = assemble_scene(sphere((0.0, 0.0, 0.3), 0.018, "skin"), {"skin": SKIN})
    kernel_scene = light_scene(plain, 400.0, 700.0)
    assert kernel_scene.colours is None
    assert kernel_scene.optics.scanned is None
    assert light_scene(scene, 400.0, 700.0).colours is not None


def test_both_integrators_see_the_same_colours(scene):
    # By the flash; a view of 24 x 18 pixels over both balls.
    camera = axis_camera(24, 18)
    camera = replace(camera, sensor=replace(camera.sensor, binning=16), exposure_s=1e-5)
    ours, reference = (
        Renderer(scene).render(camera, ["electrons"], quality)["electrons"] for quality in QUALITIES
    )
    left, right = (slice(None), slice(0, 12)), (slice(None), slice(12, 24))
    for half in (left, right):
        np.testing.assert_allclose(ours[half].mean((0, 1)), reference[half].mean((0, 1)), rtol=0.02)
    # The scanned ball is not the other one.
    assert not np.allclose(ours[left].mean((0, 1)), ours[right].mean((0, 1)), rtol=0.1)


def test_colours_have_no_parameters_to_fit(scene):
    with pytest.raises(ArgumentError, match="no pigments to fit: set scan_colour = false"):
        DifferentiableRenderer(scene, axis_camera(8, 6))
