"""Large images are exposed, read out and developed in strips of rows, as they would be as a whole."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pepperscene.camera import (
    Camera,
    Developing,
    camera_rgb,
    develop,
    expected_electrons,
    image_electrons,
    load_flash,
    load_lens,
    load_sensor,
    raw_frame,
    relative_illumination,
)
from pepperscene.camera.sensor import rows as row_strips
from pepperscene.camera.sensor.readout import bin_photosites
from pepperscene.camera.sensor.rows import LARGEST_WHOLE, STRIP_PIXELS

FLASH = load_flash("led_matrix_200klx")
BINNED = replace(load_sensor("ueye_ui5250re"), columns=60, rows=50)
FULL = load_sensor("ueye_ui5250re_full")


def camera(sensor, lens="lensagon_cmfa0420nd", **developing) -> Camera:
    settings = Developing(**{"white_balance": "flash", **developing})
    return Camera(load_lens(lens), sensor, np.eye(4), 50e-6, FLASH, developing=settings)


CAMERAS = {
    "binned": camera(BINNED),
    "distorted": camera(BINNED, "lensagon_cmfa0420nd_typical_distortion"),
    "malvar": camera(replace(BINNED, binning=1)),
    "menon": camera(replace(BINNED, binning=1), demosaic="menon"),
    "averaged": camera(FULL.with_size(56, 42)),
    "averaged, mono": camera(load_sensor("onsemi_mt9v024_mono").with_size(70, 46), pedestal="auto"),
}


@pytest.fixture
def short_strips(monkeypatch):
    """Computes something in strips of a few rows."""

    def in_strips(compute):
        with monkeypatch.context() as patch:
            patch.setattr(row_strips, "LARGEST_WHOLE", 1)
            patch.setattr(row_strips, "STRIP_PIXELS", 600)
            return compute()

    return in_strips


def random_signal(view, mean_electrons=2000.0):
    """Light that varies from pixel to pixel."""
    rng = np.random.default_rng(5)
    signal = rng.gamma(2.0, 0.5, (view.height, view.width, view.sensor.channels))
    return (signal * mean_electrons / expected_electrons(signal, view).mean()).astype(np.float32)


@pytest.mark.parametrize("size", [(1, 1), (1921, 1093), (6000, 4000), (4_000_000, 3)])
def test_strips_are_even_parts_of_the_image(size):
    width, height = size
    strips = row_strips.row_strips(width, height)
    assert [row for rows in strips for row in range(height)[rows]] == list(range(height))
    assert (len(strips) == 1) == (width * height <= LARGEST_WHOLE)
    if len(strips) > 1:
        assert all(rows.start % 2 == 0 for rows in strips)
        assert (strips[0].stop - 2) * width <= STRIP_PIXELS


@pytest.mark.parametrize("name", CAMERAS)
def test_rays_of_rows_are_those_of_the_image(name, short_strips):
    view, rows = CAMERAS[name], slice(7, 19)
    for rays in (Camera.ray_slopes, Camera.pixel_directions, relative_illumination):
        part = short_strips(lambda rays=rays: rays(view, rows))
        np.testing.assert_allclose(part, rays(view)[rows], rtol=0, atol=1e-14)


@pytest.mark.parametrize("name", ["binned", "distorted"])
def test_limits_of_the_rays_do_not_depend_on_strips(name, short_strips):
    # Another name, so that nothing is remembered.
    view, other = (replace(CAMERAS[name], sensor=replace(BINNED, name=text)) for text in ("one", "other"))
    slopes = view.ray_slopes().reshape(-1, 2)
    np.testing.assert_array_equal(view.slope_limits(), [slopes.min(axis=0), slopes.max(axis=0)])
    expected = [view.slope_limits(), *view.border_slopes()]
    parts = short_strips(lambda: [other.slope_limits(), *other.border_slopes()])
    for part, whole in zip(parts, expected, strict=True):
        np.testing.assert_allclose(part, whole, rtol=0, atol=1e-14)


@pytest.mark.parametrize("name", CAMERAS)
def test_without_noise_strips_have_the_bytes_of_the_image(name, short_strips):
    view = CAMERAS[name]
    electrons = expected_electrons(random_signal(view), view)
    for compute in (develop, raw_frame, camera_rgb):
        parts = short_strips(lambda compute=compute: compute(electrons, view))
        np.testing.assert_array_equal(parts, compute(electrons, view))


def test_an_image_in_strips_is_developed_from_its_raw_frame(short_strips):
    view = CAMERAS["binned"]
    electrons = expected_electrons(random_signal(view), view)
    raw, colours = short_strips(
        lambda: [compute(electrons, view, np.random.default_rng(3)) for compute in (raw_frame, camera_rgb)]
    )
    black, full = BINNED.black_level_dn, BINNED.full_scale_dn
    sites = ((raw - np.float32(black)) / np.float32(full - black)).astype(np.float32)
    np.testing.assert_allclose(colours, bin_photosites(sites, BINNED), atol=1e-6)


def test_noise_of_strips_is_independent_and_that_of_the_image(short_strips):
    sensor = replace(load_sensor("onsemi_mt9v024_mono"), columns=200, rows=200)
    view = camera(sensor)
    electrons = np.full((200, 200, 1), 0.3 * sensor.full_well_e)
    raw = short_strips(lambda: raw_frame(electrons, view, np.random.default_rng(4))).astype(float)
    # Shot noise, read noise and rounding, in squared digital numbers; 40,000 values know it to .7 %.
    variance = (electrons.mean() + sensor.read_noise_e**2) / sensor.gain_e_per_dn**2 + 1.0 / 12.0
    assert raw.var() == pytest.approx(variance, rel=0.035)
    rows = raw - raw.mean()
    # Of rows at the same place in neighbouring strips, of two rows each: equal noise would give 1.
    correlation = np.mean(rows[:-2] * rows[2:]) / raw.var()
    assert abs(correlation) < 5.0 / np.sqrt(rows[:-2].size)


@pytest.mark.parametrize("stray_light", [False, True])
def test_electrons_of_a_large_image_are_exact_to_single_precision(stray_light, short_strips):
    view = camera(replace(BINNED, columns=90, rows=70), stray_light=stray_light)
    signal = random_signal(view)
    whole = image_electrons(signal, view)
    large = signal.copy()
    parts = short_strips(lambda: image_electrons(large, view))
    assert parts is large
    assert parts.dtype == np.float32
    assert np.abs(parts - whole).max() < 2e-6 * np.sqrt(np.mean(np.square(whole)))
