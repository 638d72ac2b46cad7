"""Cycles gets our scene: colours, lights, camera as closed forms say, and, where bpy is, the same picture."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest

from pepperscene.bench import cycles_table
from pepperscene.bench.cycles import PYTHON_VARIABLE, CyclesRun, available, bpy_python, render_cycles
from pepperscene.bench.cycles_scene import exported, pinhole
from pepperscene.bench.cycles_settings import REFERENCE, STANDARD_SETTINGS, CyclesSetting
from pepperscene.camera import Camera, Distortion, Lens, Sensor, expected_electrons, load_flash, load_sensor
from pepperscene.classes import Instance, OrganClass
from pepperscene.errors import InputError, SetupError
from pepperscene.geometry import Mesh, concatenate_meshes
from pepperscene.materials import Surface, lambertian_surface
from pepperscene.materials.gloss import cuticle_transmittance
from pepperscene.scene import Scene, Sky, Sun, assemble_scene, partly_cloudy_sky, uniform_sky
from pepperscene.spectra import Spectrum, photons_per_joule, sky_spectrum

WITH_BPY = pytest.mark.skipif(
    not available(), reason=f"{bpy_python()} has no bpy; {PYTHON_VARIABLE} can name a Python that has"
)


def flat(
    surface: str, z: float = 0.5, side: float = 1.0, state: float = 0.5, centre: tuple[float, float] = (0, 0)
) -> Mesh:
    """A square across the z axis that faces -z, where the camera is."""
    h = side / 2
    corners = np.array([[-h, -h, z], [-h, h, z], [h, h, z], [h, -h, z]], np.float32)
    corners[:, :2] += np.asarray(centre, np.float32)
    return Mesh(
        vertices=corners,
        normals=np.tile(np.float32([0, 0, -1]), (4, 1)),
        uv=np.float32([[0, 0], [0, 1], [1, 1], [1, 0]]),
        state=np.full(4, state, np.float32),
        faces=np.array([[0, 1, 2], [0, 2, 3]], np.uint32),
        face_instance=np.zeros(2, np.uint32),
        face_surface=np.zeros(2, np.uint8),
        surfaces=(surface,),
        instances=(Instance(OrganClass.LEAF, "plate"),),
    )


def camera(columns: int = 40, rows: int = 30, *, flash: bool = True, **lens: object) -> Camera:
    """The recipe's sensor with a few large pixels at the world's origin, looking along +z."""
    sensor = load_sensor("ueye_ui5250re")
    pitch = sensor.pitch_m * 800 / columns
    sensor = dataclasses.replace(sensor, columns=columns, rows=rows, pitch_m=pitch)
    lamp = load_flash("led_matrix_200klx") if flash else None
    return Camera(Lens("lens", 4e-3, 2.0, **lens), sensor, np.eye(4), 50e-6, lamp)  # type: ignore[arg-type]


def narrow(camera: Camera, nm: float, width: float = 2.0) -> Camera:
    """The same camera under a flash of (nearly) one wavelength."""
    line = Spectrum(np.array([nm - width, nm, nm + width]), np.array([0.0, 1.0, 0.0]))
    return dataclasses.replace(camera, flash=dataclasses.replace(camera.flash, spectrum=line))


def sloped(name: str = "plate", **changes: object) -> Surface:
    """Reflectance that rises from 0 at 400 nm to 0.6 at 700 nm, on both sides."""
    nm = np.array([300.0, 400.0, 700.0, 1100.0])
    values = np.array([0.0, 0.0, 0.6, 0.6])
    plain = Surface(name, nm, np.tile(values, (1, 2, 1)), np.zeros((1, 4)))
    return dataclasses.replace(plain, **changes)  # type: ignore[arg-type]


# --- colours ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("reflectance", [0.0, 0.18, 1.0])
def test_grey_is_grey_in_every_channel(reflectance: float) -> None:
    scene = assemble_scene(flat("plate"), {"plate": lambertian_surface("plate", reflectance)})
    np.testing.assert_allclose(exported(scene, camera()).arrays["front"], reflectance, rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize("nm", [450.0, 550.0, 640.0])
def test_under_one_wavelength_all_channels_see_that_wavelength(nm: float) -> None:
    scene = assemble_scene(flat("plate"), {"plate": sloped()})
    front = exported(scene, narrow(camera(), nm)).arrays["front"]
    np.testing.assert_allclose(front, 0.6 * (nm - 400.0) / 300.0, rtol=1e-3)  # the line is 2 nm wide


def test_a_reddish_body_is_brightest_in_red_and_weighted_by_photons() -> None:
    lens_camera = camera()
    front = exported(assemble_scene(flat("plate"), {"plate": sloped()}), lens_camera).arrays["front"][0]
    assert front[0] > front[1] > front[2]
    # The same integrals by the trapezium rule on a grid of another spacing.
    nm = np.linspace(350.0, 1000.0, 40_001)
    light = lens_camera.flash.spectrum.at(nm) * photons_per_joule(nm)
    weight = lens_camera.sensor.quantum_efficiency.at(nm) * light
    reflectance = np.interp(nm, [400.0, 700.0], [0.0, 0.6])
    wanted = np.trapezoid(weight * reflectance, nm) / np.trapezoid(weight, nm)
    np.testing.assert_allclose(front, wanted, rtol=2e-3)


def test_states_patterns_and_sides_end_up_at_the_vertices() -> None:
    nm = np.array([300.0, 1100.0])
    # Three states; the front follows the square of the state, which the rows hold at 0, 1/2 and 1.
    front, back = np.array([0.0, 0.25, 1.0]) * 0.8, np.array([0.1, 0.1, 0.1])
    body = np.stack([np.tile(front, (2, 1)).T, np.tile(back, (2, 1)).T], axis=1)
    leaf = Surface("plate", nm, body, np.full((3, 2), 0.2))
    at = exported(assemble_scene(flat("plate", state=0.25), {"plate": leaf}), camera()).arrays
    np.testing.assert_allclose(at["front"], 0.8 * 0.125, rtol=1e-5)  # half way between two rows
    np.testing.assert_allclose(at["back"], 0.1, rtol=1e-5)
    np.testing.assert_allclose(at["through"], 0.2, rtol=1e-5)
    # A pattern shifts the state, and what it shifts beyond the end stays there.
    shifted = dataclasses.replace(leaf, pattern=np.full((2, 2), 0.25, np.float32))
    moved = exported(assemble_scene(flat("plate", state=0.25), {"plate": shifted}), camera()).arrays["front"]
    np.testing.assert_allclose(moved, 0.8 * 0.25, rtol=1e-5)
    far = dataclasses.replace(leaf, pattern=np.full((2, 2), 9.0, np.float32))
    end = exported(assemble_scene(flat("plate", state=0.25), {"plate": far}), camera()).arrays["front"]
    np.testing.assert_allclose(end, 0.8, rtol=1e-5)


def test_no_side_sends_out_more_than_the_body_does() -> None:
    nm = np.array([300.0, 1100.0])
    glossy = Surface(
        "plate", nm, np.full((1, 2, 2), 0.3), np.full((1, 2), 0.6), ior=1.45, roughness=(0.2, 0.7)
    )
    peer = exported(assemble_scene(flat("plate"), {"plate": glossy}), camera())
    (material,) = peer.facts["materials"]
    means = [cuticle_transmittance(1.45, alpha)[1] for alpha in (0.2, 0.7)]
    for side, share, mean in zip(("front", "back"), material["let_out"], means, strict=True):
        # Helmholtz: what goes through is let out equally, whichever side it comes from.
        assert share * mean == pytest.approx(min(means))
        np.testing.assert_allclose(peer.arrays[side] + share * peer.arrays["through"], 0.9, rtol=1e-5)


def test_surfaces_of_one_cuticle_share_a_material_and_no_vertex() -> None:
    near, far = flat("near", 0.4), flat("far", 0.6)
    both = concatenate_meshes([near, far])
    # Let the far plate use the near one's vertices as well.
    shared = dataclasses.replace(both, faces=both.faces % np.uint32(4))
    scene = assemble_scene(
        shared, {"near": lambertian_surface("near", 0.2), "far": lambertian_surface("far", 0.7)}
    )
    peer = exported(scene, camera())
    assert len(peer.facts["materials"]) == 1
    assert len(peer.arrays["vertices"]) == 8
    corners = peer.arrays["front"][peer.arrays["faces"]].mean(axis=(1, 2))
    np.testing.assert_allclose(corners, [0.2, 0.2, 0.7, 0.7], rtol=1e-5)
    positions = peer.arrays["vertices"][peer.arrays["faces"]]
    np.testing.assert_array_equal(positions, shared.vertices[shared.faces])


# --- lights -------------------------------------------------------------------------------------------------


def test_white_under_the_flash_is_neutral_and_full_scale_is_one() -> None:
    lens_camera = camera()
    peer = exported(assemble_scene(flat("plate"), {"plate": lambertian_surface("plate", 1.0)}), lens_camera)
    intensity = np.array(peer.facts["flash"]["intensity"])
    np.testing.assert_allclose(intensity, intensity[0], rtol=1e-6)
    # The strongest channel of a picture of ones fills the well in the middle of the picture.
    ones = peer.electrons(np.ones((30, 40, 3)), lens_camera)
    assert ones.max() == pytest.approx(lens_camera.sensor.full_well_e, rel=1e-3)


def test_the_rectangle_has_the_discs_extent_and_place() -> None:
    lens_camera = camera()
    flash = exported(
        assemble_scene(flat("plate"), {"plate": lambertian_surface("plate", 1.0)}), lens_camera
    ).facts["flash"]
    matrix = np.array(flash["matrix_world"])
    np.testing.assert_allclose(matrix[:3, 3], [0.0, -0.04, 0.0], atol=1e-12)
    np.testing.assert_allclose(matrix[:3, 2], [0.0, 0.0, -1.0])  # shines along its own -z
    # Points drawn on the discs vary as points on the rectangle do.
    rng = np.random.default_rng(1)
    lamp = lens_camera.flash
    radius = lamp.radius_m * np.sqrt(rng.random(200_000))
    angle = 2 * np.pi * rng.random(radius.size)
    places = lamp.emitters_m[rng.integers(len(lamp.emitters_m), size=radius.size)]
    x = places[:, 0] + radius * np.cos(angle)
    assert flash["sides_m"][0] ** 2 / 12.0 == pytest.approx(x.var(), rel=0.01)


def test_a_shorter_pulse_gives_less_light() -> None:
    whole = camera()
    lamp = dataclasses.replace(whole.flash, pulse_s=whole.exposure_s / 4)
    short = dataclasses.replace(whole, flash=lamp)
    scene = assemble_scene(flat("plate"), {"plate": lambertian_surface("plate", 1.0)})
    a, b = (exported(scene, one) for one in (whole, short))
    lit, dimmed = (np.array(one.facts["flash"]["intensity"]) * one.unit for one in (a, b))
    np.testing.assert_allclose(dimmed / lit, 0.25, rtol=1e-6)


def test_sky_and_sun_in_electrons() -> None:
    nm = np.array([300.0, 1100.0])
    sun = Sun(np.array([0.0, 0.6, 0.8]), Spectrum(nm, np.array([2.0, 2.0])))
    weights = np.arange(8, dtype=np.float32).reshape(1, 2, 4)
    sky = Sky(weights, Spectrum(nm, np.array([[0.5, 0.5]])), sun)
    lens_camera = camera(flash=False)
    peer = exported(Scene(flat("plate"), (lambertian_surface("plate", 0.5),), sky), lens_camera)
    fine = np.linspace(300.0, 1100.0, 80_001)
    per_unit = np.trapezoid(lens_camera.sensor.electrons_per_joule(fine), fine, axis=-1)
    np.testing.assert_allclose(np.array(peer.facts["sun"]["irradiance"]) * peer.unit, 2 * per_unit, rtol=2e-3)
    wanted = 0.5 * weights[0][..., None] * per_unit
    np.testing.assert_allclose(peer.arrays["sky"] * peer.unit, wanted, rtol=2e-3)
    assert "flash" not in peer.facts


# --- camera -------------------------------------------------------------------------------------------------


def test_blender_camera_sees_points_where_ours_does() -> None:
    turn = np.array([[0.0, 0.6, 0.8], [-1.0, 0.0, 0.0], [0.0, -0.8, 0.6]])
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = turn, [0.3, -0.2, 1.1]
    lens_camera = camera(80, 60, principal_offset_m=(1e-4, -2e-4)).at_pose(pose)
    facts = exported(
        assemble_scene(flat("plate"), {"plate": lambertian_surface("plate", 1.0)}), lens_camera
    ).facts["camera"]
    points = np.random.default_rng(2).uniform([-0.3, -0.2, 0.5], [0.3, 0.2, 2.0], (50, 3))
    world = points @ pose[:3, :3].T + pose[:3, 3]
    # Blender's own rule (manual, "Cameras"): a shift of 1 moves the picture by its larger side.
    x, y, z = (np.linalg.inv(np.array(facts["matrix_world"])) @ np.column_stack([world, np.ones(50)]).T)[:3]
    scale = facts["lens_mm"] / facts["sensor_width_mm"]
    u = (x / -z * scale - facts["shift_x"]) * facts["width"] + facts["width"] / 2
    v = facts["height"] / 2 - (y / -z * scale - facts["shift_y"]) * facts["width"]
    np.testing.assert_allclose(np.column_stack([u, v]), lens_camera.project(world), atol=1e-8)


def test_distortion_is_left_out_and_nothing_else() -> None:
    bent = camera(distortion=Distortion(k1=-0.1), transmittance=0.8)
    straight = pinhole(bent)
    assert straight.lens.distortion.is_none
    assert straight.lens == dataclasses.replace(bent.lens, distortion=Distortion())
    np.testing.assert_array_equal(straight.pose, bent.pose)


def test_what_cycles_cannot_show_is_refused() -> None:
    plate = assemble_scene(flat("plate"), {"plate": lambertian_surface("plate", 1.0)})
    with pytest.raises(ValueError, match="no surfaces"):
        exported(Scene(flat("plate")), camera())
    with pytest.raises(ValueError, match="flash or a sky"):
        exported(plate, camera(flash=False))
    grey = dataclasses.replace(camera(), sensor=_mono(camera().sensor))
    with pytest.raises(ValueError, match="channels"):
        exported(plate, grey)


def _mono(sensor: Sensor) -> Sensor:
    one = Spectrum(sensor.quantum_efficiency.wavelength_nm, sensor.quantum_efficiency.values[1:2])
    return dataclasses.replace(sensor, quantum_efficiency=one, pattern="mono")


# --- settings and tables ------------------------------------------------------------------------------------


def test_the_standard_settings_hold_the_fair_ones() -> None:
    by_name = {one.name: one for one in STANDARD_SETTINGS}
    assert len(by_name) == len(STANDARD_SETTINGS)
    assert {one.spp for one in STANDARD_SETTINGS if one.name.startswith("raw")} == {1, 4, 16, 64, 256}
    assert all(one.clamp == 0.0 and one.adaptive is None for one in STANDARD_SETTINGS[:9])
    defaults = by_name["Blender's defaults"]
    assert (defaults.spp, defaults.bounces, defaults.adaptive) == (4096, 12, 0.01)
    assert REFERENCE.spp * (REFERENCE.frames or 1) >= 2048
    assert not REFERENCE.denoise
    assert REFERENCE.clamp == 0.0


def test_settings_are_checked() -> None:
    with pytest.raises(ValueError, match="spp"):
        CyclesSetting("none", 0, denoise=False)
    with pytest.raises(ValueError, match="negative"):
        CyclesSetting("below", 1, denoise=False, clamp=-1.0)
    with pytest.raises(InputError, match="unknown setting 'raw 3'"):
        cycles_table.chosen_settings("raw 3", 1.0)
    chosen = cycles_table.chosen_settings("raw 16, denoised 4", 9.0)
    assert [one.name for one in chosen] == ["raw 16", "denoised 4", "reference"]
    assert chosen[-1].limit_s == 9.0


def test_errors_are_those_of_one_frame_with_the_reference_taken_off() -> None:
    lens_camera, rng = camera(60, 40), np.random.default_rng(5)
    true = np.full((40, 60, 3), 0.3 * lens_camera.sensor.full_well_e)

    def run(setting: CyclesSetting, spread: float, frames: int) -> CyclesRun:
        images = true + rng.normal(0.0, spread, (frames, *true.shape))
        return CyclesRun(setting, 2.0, 1.0, 300.0, images.astype(np.float32), "test")

    fine = 0.01 * lens_camera.sensor.full_well_e
    reference, noisy = run(REFERENCE, fine, 4), run(STANDARD_SETTINGS[0], 2 * fine, 3)
    measured, own = cycles_table.rows([noisy, reference], reference, lens_camera)
    # One frame of the reference errs by half of the noisy one's, the mean of four by a quarter of it.
    assert own.codes == pytest.approx(measured.codes / 4, rel=0.05)
    assert measured.energy == pytest.approx(1.0, abs=0.01)
    alone = run(REFERENCE, fine, 1)
    assert np.isnan(cycles_table.reference_error(alone, lens_camera))
    table = cycles_table.markdown([measured, own], reference, "a test")
    assert table.count("\n|") == 4
    assert "raw 1 | 2.0 |" in table


# --- Blender ------------------------------------------------------------------------------------------------


def test_without_bpy_it_is_said_what_to_install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    scene = assemble_scene(flat("plate"), {"plate": lambertian_surface("plate", 0.5)})
    for missing in (str(tmp_path / "python"), "false"):
        monkeypatch.setenv(PYTHON_VARIABLE, missing)
        assert not available()
        with pytest.raises(SetupError, match=PYTHON_VARIABLE):
            render_cycles(scene, camera(), STANDARD_SETTINGS[:1], tmp_path)


def test_a_failed_blender_is_told_with_its_last_words(tmp_path: Path) -> None:
    scene = assemble_scene(flat("plate"), {"plate": lambertian_surface("plate", 0.5)})
    python = tmp_path / "python"
    python.write_text('#!/bin/sh\ncase "$*" in *find_spec*) exit 0;; esac\necho out of luck\nexit 1\n')
    python.chmod(0o755)
    with pytest.raises(SetupError, match="out of luck"):
        render_cycles(scene, camera(), STANDARD_SETTINGS[:1], tmp_path / "out", python=str(python))
    # What Blender was to build lies there whole.
    asked = json.loads((tmp_path / "out" / "settings.json").read_text())
    assert asked["settings"][0]["spp"] == 1
    with np.load(tmp_path / "out" / "scene.npz") as arrays:
        assert len(arrays["faces"]) == 2


@WITH_BPY
def test_a_matt_plate_under_the_flash_is_as_bright_as_the_law_says(tmp_path: Path) -> None:
    lens_camera, reflectance = camera(), 0.5
    scene = assemble_scene(flat("plate", side=2.0), {"plate": lambertian_surface("plate", reflectance)})
    setting = CyclesSetting("test", 64, denoise=False, bounces=0)
    (run,) = render_cycles(scene, lens_camera, [setting], tmp_path, threads=1)
    # E = sum over the discs of I p(t) cos(t) / d^2, taken at the discs' centres; L = R E / pi.
    lamp = lens_camera.flash
    nm = np.arange(300.0, 1101.0)
    intensity = lamp.radiant_intensity(nm) @ lens_camera.sensor.electrons_per_joule(nm).T
    directions = lens_camera.pixel_directions()
    points = directions / directions[..., 2:] * 0.5
    lights = np.column_stack([lamp.emitters_m, np.zeros(len(lamp.emitters_m))]) + np.asarray(lamp.offset_m)
    away = points[:, :, None] - lights
    distance = np.linalg.norm(away, axis=-1)
    cosine = away[..., 2] / distance
    lit = (lamp.profile.at(np.arccos(cosine)) * cosine / distance**2).mean(axis=-1)
    wanted = expected_electrons(reflectance / np.pi * lit[..., None] * intensity, lens_camera)
    np.testing.assert_allclose(run.image.mean((0, 1)), wanted.mean((0, 1)), rtol=5e-3)
    bright = wanted > 0.1 * wanted.max()
    np.testing.assert_allclose(run.image[bright], wanted[bright], rtol=0.05)


@WITH_BPY
def test_sky_lies_where_ours_lies_and_through_a_sheet_comes_its_share(tmp_path: Path) -> None:
    # A small sheet that lets all through, before a sky of one colour: it glows by what falls on its far side.
    nm = np.array([300.0, 1100.0])
    sheet = Surface("plate", nm, np.zeros((1, 2, 2)), np.full((1, 2), 0.5))
    lens_camera = camera(flash=False)
    setting = CyclesSetting("test", 64, denoise=False, bounces=1)
    even = assemble_scene(flat("plate", side=0.2), {"plate": sheet}, uniform_sky(sky_spectrum("d65"), 1e5))
    (run,) = render_cycles(even, lens_camera, [setting], tmp_path / "even", threads=1)
    peer = exported(even, lens_camera)
    sky = expected_electrons(np.broadcast_to(peer.arrays["sky"][0, 0] * peer.unit, (30, 40, 3)), lens_camera)
    ratio = run.image / sky
    np.testing.assert_allclose(ratio[:2], 1.0, rtol=1e-3)
    np.testing.assert_allclose(ratio[13:17, 18:22].mean(), 0.5, rtol=0.02)

    # Clouds are seen in the directions that the map says.
    rng = np.random.default_rng(3)
    clouds = partly_cloudy_sky(
        rng, illuminance_lx=1e5, sun_azimuth_rad=0.3, sun_elevation_rad=0.6, sun_fraction=0.0, cloud_cover=0.5
    )
    tilted = np.eye(4)
    tilted[:3, :3] = [[0.0, 0.5, np.sqrt(0.75)], [-1.0, 0.0, 0.0], [0.0, -np.sqrt(0.75), 0.5]]
    open_air = assemble_scene(flat("plate", z=-5.0, side=0.01), {"plate": sheet}, clouds)
    seen_by = lens_camera.at_pose(tilted)
    (run,) = render_cycles(open_air, seen_by, [setting], tmp_path / "clouds", threads=1)
    peer = exported(open_air, seen_by)
    rows, columns = peer.arrays["sky"].shape[:2]
    towards = seen_by.pixel_directions() @ tilted[:3, :3].T
    row = np.arccos(towards[..., 2]) / np.pi * rows
    column = np.arctan2(towards[..., 1], towards[..., 0]) % (2 * np.pi) / (2 * np.pi) * columns
    found = peer.arrays["sky"][row.astype(int), column.astype(int)] * peer.unit
    ratio = run.image / expected_electrons(found, seen_by)
    assert np.abs(np.median(ratio) - 1.0) < 0.01
    assert np.percentile(np.abs(ratio - 1.0), 90) < 0.1
