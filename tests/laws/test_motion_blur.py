"""Blur, lean and light of images from a moving camera, against closed forms."""

from dataclasses import replace

import numpy as np
import pytest
from bodies import EVEN_SKY, axis_camera, card, even_lamp, knife_edge, sheet

from pepperscene.camera import AngularProfile, Camera, Flash, Motion
from pepperscene.geometry import concatenate_meshes
from pepperscene.materials import lambertian_surface
from pepperscene.render import Quality, Renderer
from pepperscene.render.reference.path_tracer import INSTANTS
from pepperscene.render.transport import strips
from pepperscene.scene import assemble_scene, uniform_sky
from pepperscene.spectra import Spectrum

COLUMNS, ROWS = 96, 16
DEPTH_M = 0.5
OURS = Quality(256, 256, 256, 0, target=None, denoise=False)
PATHS = replace(OURS, samples=512, soft=512, most=512, bounces=0, integrator="path")
NM = np.array([300.0, 1100.0])


def white_edge(sky_lx: float | None = 5500.0):
    """A white half-plane (x < 0) in front of a black wall, with the sky behind the camera."""
    surfaces = {"white": lambertian_surface("white", 0.9), "black": lambertian_surface("black", 0.0)}
    mesh = concatenate_meshes([card(-2.0, 0.0, 4.0, 8.0, "white", DEPTH_M), sheet(90.0, 90.0, 0.55, "black")])
    return assemble_scene(mesh, surfaces, uniform_sky(Spectrum(NM, np.ones(2)), sky_lx) if sky_lx else None)


def camera(
    velocity=(0.0, 0.0, 0.0),
    spin=(0.0, 0.0, 0.0),
    *,
    exposure_s: float = 3e-3,
    line_time_s: float = 0.0,
    flash: Flash | None = None,
    columns: int = COLUMNS,
    rows: int = ROWS,
) -> Camera:
    base = axis_camera(columns, rows, flash=flash)
    developing = replace(base.developing, falloff=False)
    sensor = replace(base.sensor, line_time_s=line_time_s)
    moved = replace(base, sensor=sensor, exposure_s=exposure_s, developing=developing)
    return replace(moved, motion=Motion(velocity, spin))


def lamp(pulse_s: float, lux: float = 2000.0) -> Flash:
    """A point at the lens of intensity I cos^-3, which lights a facing plane evenly with I / z^2."""
    angle = np.radians(np.arange(0.0, 60.1, 0.25))
    profile = AngularProfile(angle, np.cos(angle) ** -3)
    return replace(even_lamp(Spectrum(NM, np.ones(2)), lux), profile=profile, pulse_s=pulse_s)


def electrons(scene, view: Camera, quality: Quality = OURS, seed: int = 0) -> np.ndarray:
    """`(h, w)` of the green photosites."""
    return Renderer(scene).render(view, ["electrons"], quality, seed)["electrons"][..., 1].astype(float)


def ramp_width(profile: np.ndarray) -> float:
    """Width of the box that smears a step into this profile, pixels, from the variance of its derivative."""
    # Without the flat ends of the profile, which have only noise.
    change = -np.diff(profile)
    begin, end = np.flatnonzero(change > 0.2 * change.max())[[0, -1]] + (-3, 4)
    at = np.arange(max(begin, 0), min(end, change.size))
    change = change[at]
    mean = (at * change).sum() / change.sum()
    variance = ((at - mean) ** 2 * change).sum() / change.sum()
    # Differences of means over pixels weight the edge with a triangle, whose variance is 1/6: the convolution
    # of two boxes.
    return float(np.sqrt(max(12.0 * variance - 2.0, 0.0)))


def edge_columns(image: np.ndarray) -> np.ndarray:
    """`(h,)` where the bright left part of each row ends, in columns, to a fraction of a pixel."""
    return (image / image[:, :1].mean()).sum(axis=1)


@pytest.mark.parametrize(
    "quality", [OURS, pytest.param(PATHS, marks=pytest.mark.long)], ids=["ours", "paths"]
)
def test_an_edge_is_smeared_by_speed_times_exposure_times_focal_length_over_distance(quality):
    view = camera((8.0, 0.0, 0.0))
    expected = 8.0 * 3e-3 * view.intrinsics[0, 0] / DEPTH_M
    assert 10 < expected < 40
    profile = electrons(knife_edge(DEPTH_M), view, quality).mean(axis=0)
    assert ramp_width(profile) == pytest.approx(expected, rel=0.02)
    # Straight between its ends.
    x = np.arange(COLUMNS) + 0.5 - COLUMNS / 2
    inner = np.abs(x) < expected / 2 - 1
    ramp = 0.5 - x / expected
    # The profile of the reference has `INSTANTS` steps at random places; chosen: half of one is allowed.
    steps = 0.02 if quality is OURS else 0.02 + 0.5 / INSTANTS
    assert np.abs(profile / profile[0] - ramp)[inner].max() < steps


def test_rolling_about_the_axis_smears_in_proportion_to_the_distance_from_it():
    view = camera(spin=(0.0, 0.0, 60.0), rows=192)
    image = electrons(knife_edge(DEPTH_M), view)
    for first in (0, 16, 160, 176):
        distance = np.abs(np.arange(first, first + 16) + 0.5 - 96)
        # The edge turns by the angle about the centre: tan(angle / 2) to both sides. The mean over 16 rows,
        # whose widths differ, has less noise.
        expected = 2 * distance * np.tan(0.5 * 60.0 * 3e-3)
        widths = [ramp_width(row) for row in image[first : first + 16]]
        assert np.mean(widths) == pytest.approx(expected.mean(), rel=0.02)


def test_a_rolling_shutter_leans_a_vertical_edge():
    # Exposed briefly, so that there is no blur: one row sees the edge f v t / z further than the last.
    view = camera((5.0, 0.0, 0.0), exposure_s=2e-5, line_time_s=1e-4, rows=64)
    columns = edge_columns(electrons(knife_edge(DEPTH_M), view))
    slope = np.polyfit(np.arange(64), columns, 1)[0]
    expected = -5.0 * 1e-4 * view.intrinsics[0, 0] / DEPTH_M
    assert slope == pytest.approx(expected, rel=0.02)
    assert abs(expected) * 64 > 20
    # The labels lean as the image does, and cross the axis in the middle of the image.
    labels = Renderer(knife_edge(DEPTH_M)).render(view, ["class"])["class"]
    assert np.abs((labels == 0).sum(axis=1) - columns).max() < 1.0
    assert columns.mean() == pytest.approx(COLUMNS / 2, abs=0.1)


def test_a_flash_freezes_the_image():
    view = camera((8.0, 0.0, 0.0), flash=lamp(5e-5))
    scene = white_edge(None)
    blur = 8.0 * 5e-5 * view.intrinsics[0, 0] / DEPTH_M
    still = ramp_width(electrons(scene, replace(view, motion=None)).mean(axis=0))
    assert ramp_width(electrons(scene, view).mean(axis=0)) <= still + blur + 0.3
    # Its pulse starts with the exposure: the edge is where the camera was then.
    shift = 8.0 * (3e-3 - 5e-5) / 2 * view.intrinsics[0, 0] / DEPTH_M
    columns = [edge_columns(electrons(scene, moved)).mean() for moved in (view, replace(view, motion=None))]
    assert columns[0] - columns[1] == pytest.approx(shift, rel=0.01)


@pytest.mark.parametrize("quality", [OURS, PATHS], ids=["ours", "paths"])
def test_the_sharp_and_the_smeared_part_are_those_of_flash_and_daylight(quality):
    view = camera((8.0, 0.0, 0.0), flash=lamp(5e-5, 200_000.0))
    still = replace(view, motion=None)
    levels = [
        electrons(white_edge(None), still)[:, :8].mean(),
        electrons(white_edge(), replace(still, flash=None))[:, :8].mean(),
    ]
    profile = electrons(white_edge(), view, quality).mean(axis=0)
    # A step where the flash is, and the ramp of daylight, fitted to the image.
    pixel = (np.arange(COLUMNS * 64) + 0.5) / 64 - COLUMNS / 2
    focal = view.intrinsics[0, 0] / DEPTH_M
    smear = np.clip(0.5 - pixel / (8.0 * 3e-3 * focal), 0.0, 1.0)
    begin, pulse = 0.5 * 8.0 * 3e-3 * focal, 8.0 * 5e-5 * focal
    sharp = np.clip((begin - pixel) / pulse, 0.0, 1.0)
    shapes = np.stack([shape.reshape(COLUMNS, 64).mean(axis=1) for shape in (sharp, smear)], axis=1)
    found = np.linalg.lstsq(shapes, profile, rcond=None)[0]
    assert found == pytest.approx(levels, rel=0.02)
    assert found[0] / found[1] == pytest.approx(levels[0] / levels[1], rel=0.02)
    assert 0.2 < levels[0] / levels[1] < 5
    assert np.abs(shapes @ found - profile).max() < 0.03 * profile.max()


def test_motion_does_not_change_the_amount_of_light():
    # A plane that looks evenly bright from everywhere, by flash and daylight.
    surfaces = {"white": lambertian_surface("white", 0.9)}
    scene = assemble_scene(sheet(8.0, 8.0, DEPTH_M, "white"), surfaces, EVEN_SKY)
    view = camera((1.0, -0.5, 0.0), flash=lamp(5e-5, 200_000.0), line_time_s=1e-5)
    moved, still = (electrons(scene, v) for v in (view, replace(view, motion=None)))
    assert moved.mean() == pytest.approx(still.mean(), rel=0.002)


def test_rows_of_a_rolling_shutter_get_their_part_of_the_flash():
    # The camera stands still; the flash of 200 us starts with the first of 64 rows, 10 us apart.
    surfaces = {"white": lambertian_surface("white", 0.9)}
    scene = assemble_scene(sheet(8.0, 8.0, DEPTH_M, "white"), surfaces, None)
    view = camera(flash=lamp(2e-4), exposure_s=3e-4, line_time_s=1e-5, rows=64)
    alike = replace(view, sensor=replace(view.sensor, line_time_s=0.0))
    rows, full = (electrons(scene, v).mean(axis=1) for v in (view, alike))
    expected = np.clip(2e-4 - np.arange(64) * 1e-5, 0.0, None) / 2e-4
    np.testing.assert_allclose(rows / full, expected, atol=0.005)
    assert (rows[20:] <= 1e-6 * full.mean()).all()


def test_a_motion_of_zero_changes_nothing():
    view = camera(flash=lamp(5e-5))
    frames = [
        Renderer(white_edge()).render(v, ["colour", "position"], "draft")
        for v in (view, replace(view, motion=None))
    ]
    for name in ("colour", "position"):
        np.testing.assert_array_equal(frames[0][name], frames[1][name])


def test_parts_of_an_exposure_have_independent_samples(monkeypatch):
    seeds = []

    def recorded(light, sampling, rows):
        seeds.append(light.seed)
        return trace_rows(light, sampling, rows)

    trace_rows = strips.trace_rows
    monkeypatch.setattr(strips, "trace_rows", recorded)
    view = camera((1.0, 0.0, 0.0), flash=lamp(5e-5, 200_000.0))
    electrons(white_edge(), view, replace(OURS, samples=4, soft=4), seed=1)
    assert len(seeds) == len(set(seeds)) == 2
