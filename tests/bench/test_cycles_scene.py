"""Export of scenes to Cycles (benchmarks/cycles): colours, lights and camera against closed forms."""

from __future__ import annotations

import dataclasses
import sys
from pathlib import Path

import numpy as np
import pytest

from pepperscene.camera import Camera, Distortion, Lens, load_flash, load_sensor
from pepperscene.classes import Appearance, Instance, OrganClass
from pepperscene.geometry import Mesh, concatenate_meshes
from pepperscene.materials import Surface, lambertian_surface
from pepperscene.materials.gloss import cuticle_transmittance
from pepperscene.scene import Scene, Sky, Sun, assemble_scene
from pepperscene.spectra import Spectrum, photons_per_joule

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "benchmarks" / "cycles"))

from cycles_scene import export_scene, undistorted

WIDE_NM = np.array([300.0, 1100.0])
WHITE = lambertian_surface("plate", 1.0)
SLOPED = Surface(
    "plate",
    np.array([300.0, 400.0, 700.0, 1100.0]),
    np.tile([0.0, 0.0, 0.6, 0.6], (1, 2, 1)),
    np.zeros((1, 4)),
)
"""Reflectance that rises from 0 at 400 nm to 0.6 at 700 nm, on both sides."""


def square(surface="plate", z=0.5, state=0.5):
    """A square of 1 m across the z axis that faces -z, towards the camera."""
    h = 0.5
    return Mesh(
        vertices=np.array([[-h, -h, z], [-h, h, z], [h, h, z], [h, -h, z]], np.float32),
        normals=np.tile(np.float32([0, 0, -1]), (4, 1)),
        uv=np.float32([[0, 0], [0, 1], [1, 1], [1, 0]]),
        state=np.full(4, state, np.float32),
        faces=np.array([[0, 1, 2], [0, 2, 3]], np.uint32),
        face_instance=np.zeros(2, np.uint32),
        face_surface=np.zeros(2, np.uint8),
        face_appearance=np.zeros(2, np.uint32),
        surfaces=(surface,),
        instances=(Instance(OrganClass.LEAF, "plate"),),
        appearances=(Appearance(),),
    )


def make_camera(columns=40, rows=30, *, flash=True, **lens):
    """The recipe's sensor with a few large pixels, at the origin, looking along +z."""
    sensor = load_sensor("ueye_ui5250re")
    pitch = sensor.pitch_m * 800 / columns
    sensor = dataclasses.replace(sensor, columns=columns, rows=rows, pitch_m=pitch)
    lamp = load_flash("led_matrix_200klx") if flash else None
    return Camera(Lens("lens", 4e-3, 2.0, **lens), sensor, np.eye(4), 50e-6, lamp)


CAMERA = make_camera()


def export(surface, camera=CAMERA, state=0.5):
    """Export a square with this surface."""
    return export_scene(assemble_scene(square(state=state), {"plate": surface}), camera)


def test_surfaces_have_the_reflectance_at_the_wavelength_of_the_light():
    for reflectance in (0.0, 0.18, 1.0):
        front = export(lambertian_surface("plate", reflectance)).arrays["front"]
        np.testing.assert_allclose(front, reflectance, rtol=1e-6, atol=1e-9)
    for nm in (450.0, 640.0):
        line = Spectrum(np.array([nm - 2.0, nm, nm + 2.0]), np.array([0.0, 1.0, 0.0]))
        camera = dataclasses.replace(CAMERA, flash=dataclasses.replace(CAMERA.flash, spectrum=line))
        front = export(SLOPED, camera).arrays["front"]
        np.testing.assert_allclose(front, 0.6 * (nm - 400.0) / 300.0, rtol=1e-3)  # the line is 2 nm wide


def test_channel_means_are_weighted_by_photons():
    front = export(SLOPED).arrays["front"][0]
    assert front[0] > front[1] > front[2]
    # The same integrals by the trapezoidal rule on another grid.
    nm = np.linspace(350.0, 1000.0, 40_001)
    light = CAMERA.flash.spectrum.at(nm) * photons_per_joule(nm)
    weight = CAMERA.sensor.quantum_efficiency.at(nm) * light
    reflectance = np.interp(nm, [400.0, 700.0], [0.0, 0.6])
    expected = np.trapezoid(weight * reflectance, nm) / np.trapezoid(weight, nm)
    np.testing.assert_allclose(front, expected, rtol=2e-3)


def test_vertices_have_the_colours_of_state_pattern_and_side():
    # Three states; the front follows the square of the state, tabulated at 0, 1/2 and 1.
    front, back = np.array([0.0, 0.25, 1.0]) * 0.8, np.array([0.1, 0.1, 0.1])
    body = np.stack([np.tile(front, (2, 1)).T, np.tile(back, (2, 1)).T], axis=1)
    leaf = Surface("plate", WIDE_NM, body, np.full((3, 2), 0.2))
    arrays = export(leaf, state=0.25).arrays
    np.testing.assert_allclose(arrays["front"], 0.8 * 0.125, rtol=1e-5)  # half way between two rows
    np.testing.assert_allclose(arrays["back"], 0.1, rtol=1e-5)
    np.testing.assert_allclose(arrays["through"], 0.2, rtol=1e-5)
    # A pattern shifts the state, which is clipped to its range.
    for shift, expected in ((0.25, 0.8 * 0.25), (9.0, 0.8)):
        patterned = dataclasses.replace(leaf, pattern=np.full((1, 2, 2), shift, np.float32))
        np.testing.assert_allclose(export(patterned, state=0.25).arrays["front"], expected, rtol=1e-5)


def test_reflectance_and_transmittance_conserve_energy():
    body, transmittance = np.full((1, 2, 2), 0.3), np.full((1, 2), 0.6)
    exported = export(Surface("plate", WIDE_NM, body, transmittance, ior=1.45, roughness=(0.2, 0.7)))
    (material,) = exported.facts["materials"]
    means = [cuticle_transmittance(1.45, alpha)[1] for alpha in (0.2, 0.7)]
    for side, fraction, mean in zip(("front", "back"), material["exit_fraction"], means, strict=True):
        # Reciprocity: the transmittance is the same from both sides.
        assert fraction * mean == pytest.approx(min(means))
        total = exported.arrays[side] + fraction * exported.arrays["through"]
        np.testing.assert_allclose(total, 0.9, rtol=1e-5)


def test_surfaces_of_one_cuticle_share_a_material_but_no_vertex():
    both = concatenate_meshes([square("near", 0.4), square("far", 0.6)])
    # The far square uses the vertices of the near one.
    shared = dataclasses.replace(both, faces=both.faces % np.uint32(4))
    surfaces = {"near": lambertian_surface("near", 0.2), "far": lambertian_surface("far", 0.7)}
    exported = export_scene(assemble_scene(shared, surfaces), CAMERA)
    assert len(exported.facts["materials"]) == 1
    assert len(exported.arrays["vertices"]) == 8
    faces = exported.arrays["faces"]
    corners = exported.arrays["front"][faces].mean(axis=(1, 2))
    np.testing.assert_allclose(corners, [0.2, 0.2, 0.7, 0.7], rtol=1e-5)
    np.testing.assert_array_equal(exported.arrays["vertices"][faces], shared.vertices[shared.faces])


def test_flash_is_white_full_scale_is_one_and_pulses_scale():
    exported = export(WHITE)
    intensity = np.array(exported.facts["flash"]["intensity"])
    np.testing.assert_allclose(intensity, intensity[0], rtol=1e-6)
    # A picture of ones fills the wells of the strongest channel in the centre.
    ones = exported.electrons(np.ones((30, 40, 3)), CAMERA)
    assert ones.max() == pytest.approx(CAMERA.sensor.full_well_e, rel=1e-3)
    lamp = dataclasses.replace(CAMERA.flash, pulse_s=CAMERA.exposure_s / 4)
    dim = export(WHITE, dataclasses.replace(CAMERA, flash=lamp))
    ratio = np.array(dim.facts["flash"]["intensity"]) * dim.unit / (intensity * exported.unit)
    np.testing.assert_allclose(ratio, 0.25, rtol=1e-6)


def test_flash_rectangle_has_the_variance_and_centre_of_the_discs():
    flash, lamp = export(WHITE).facts["flash"], CAMERA.flash
    matrix = np.array(flash["matrix_world"])
    np.testing.assert_allclose(matrix[:3, 3], [0.0, -0.04, 0.0], atol=1e-12)
    np.testing.assert_allclose(matrix[:3, 2], [0.0, 0.0, -1.0])  # shines along its own -z
    # Points on the discs have the same variance as points on the rectangle.
    rng = np.random.default_rng(1)
    radius = lamp.radius_m * np.sqrt(rng.random(200_000))
    angle = 2 * np.pi * rng.random(radius.size)
    centres = lamp.emitters_m[rng.integers(len(lamp.emitters_m), size=radius.size)]
    x = centres[:, 0] + radius * np.cos(angle)
    assert flash["sides_m"][0] ** 2 / 12.0 == pytest.approx(x.var(), rel=0.01)


def test_sky_and_sun_are_in_electrons():
    sun = Sun(np.array([0.0, 0.6, 0.8]), Spectrum(WIDE_NM, np.array([2.0, 2.0])))
    weights = np.arange(8, dtype=np.float32).reshape(1, 2, 4)
    sky = Sky(weights, Spectrum(WIDE_NM, np.array([[0.5, 0.5]])), sun)
    exported = export_scene(Scene(square(), (WHITE,), sky), make_camera(flash=False))
    nm = np.linspace(300.0, 1100.0, 80_001)
    per_unit = np.trapezoid(CAMERA.sensor.electrons_per_joule(nm), nm, axis=-1)
    irradiance = np.array(exported.facts["sun"]["irradiance"]) * exported.unit
    np.testing.assert_allclose(irradiance, 2 * per_unit, rtol=2e-3)
    expected = 0.5 * weights[0][..., None] * per_unit
    np.testing.assert_allclose(exported.arrays["sky"] * exported.unit, expected, rtol=2e-3)
    assert "flash" not in exported.facts


def test_blender_camera_projects_points_like_ours():
    pose = np.eye(4)
    pose[:3, :3] = [[0.0, 0.6, 0.8], [-1.0, 0.0, 0.0], [0.0, -0.8, 0.6]]
    pose[:3, 3] = [0.3, -0.2, 1.1]
    camera = make_camera(80, 60, principal_offset_m=(1e-4, -2e-4)).at_pose(pose)
    facts = export(WHITE, camera).facts["camera"]
    points = np.random.default_rng(2).uniform([-0.3, -0.2, 0.5], [0.3, 0.2, 2.0], (50, 3))
    world = points @ pose[:3, :3].T + pose[:3, 3]
    # Blender manual, "Cameras": a shift of 1 moves the picture by its larger side.
    x, y, z = (np.linalg.inv(np.array(facts["matrix_world"])) @ np.column_stack([world, np.ones(50)]).T)[:3]
    scale = facts["lens_mm"] / facts["sensor_width_mm"]
    u = (x / -z * scale - facts["shift_x"]) * facts["width"] + facts["width"] / 2
    v = facts["height"] / 2 - (y / -z * scale - facts["shift_y"]) * facts["width"]
    np.testing.assert_allclose(np.column_stack([u, v]), camera.project(world), atol=1e-8)


def test_undistorted_camera_differs_in_distortion_only():
    distorted = make_camera(distortion=Distortion(k1=-0.1), transmittance=0.8)
    straight = undistorted(distorted)
    assert straight.lens.distortion.is_zero
    assert straight.lens == dataclasses.replace(distorted.lens, distortion=Distortion())
    np.testing.assert_array_equal(straight.pose, distorted.pose)


def test_rejects_scenes_that_cycles_cannot_render():
    with pytest.raises(ValueError, match="no surfaces"):
        export_scene(Scene(square()), CAMERA)
    with pytest.raises(ValueError, match="flash or a sky"):
        export(WHITE, make_camera(flash=False))
    efficiency = CAMERA.sensor.quantum_efficiency
    green = Spectrum(efficiency.wavelength_nm, efficiency.values[1:2])
    sensor = dataclasses.replace(CAMERA.sensor, quantum_efficiency=green, pattern="mono")
    with pytest.raises(ValueError, match="channels"):
        export(WHITE, dataclasses.replace(CAMERA, sensor=sensor))
