"""Stray light: energy, symmetry, closed forms of diffraction and scatter, ghosts, the veiling glare index."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from scipy.special import j1

from pepperscene.camera import (
    Camera,
    Developing,
    Ghost,
    StrayLight,
    add_stray_light,
    load_lens,
    load_sensor,
    stray_light_factor,
)
from pepperscene.camera.image.electrons import convolve_inside, point_spread

LENS, SENSOR = load_lens("lensagon_cmfa0420nd"), load_sensor("ueye_ui5250re")
NO_GHOSTS = StrayLight(ghosts=())
WAVELENGTH_M = 550e-9


def camera_with(stray, columns=200, rows=150, **lens):
    return Camera(replace(LENS, stray_light=stray, **lens), replace(SENSOR, columns=columns, rows=rows))


def image_of(camera, *points, value=1e6):
    image = np.zeros((camera.height, camera.width, 3))
    for row, column in points:
        image[row, column] = value
    return image


def whole_sum(quarter):
    """Sum over the plane of values at offsets of 0 and more."""
    return quarter[0, 0] + 2 * quarter[0, 1:].sum() + 2 * quarter[1:, 0].sum() + 4 * quarter[1:, 1:].sum()


@pytest.mark.parametrize(("size", "shape"), [(1, (31, 31)), (7, (40, 131)), (31, (72, 96))])
def test_convolution_has_the_bits_of_scipy(shape, size):
    from scipy.signal import fftconvolve

    rng = np.random.default_rng(size)
    image, weights = rng.random(shape), rng.random((size, size))
    np.testing.assert_array_equal(convolve_inside(image, weights), fftconvolve(image, weights, mode="valid"))


@pytest.mark.long
def test_stray_light_does_not_import_scipy_signal():
    code = (
        "import sys, numpy; from pepperscene.camera import *\n"
        "camera = Camera(load_lens('lensagon_cmfa0420nd'), load_sensor('ueye_ui5250re'))\n"
        "add_stray_light(numpy.ones((camera.height, camera.width, 3)), camera)\n"
        "assert camera.lens.stray_light.ghosts and 'scipy.signal' not in sys.modules\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


@pytest.mark.parametrize("stray", [StrayLight(), NO_GHOSTS, StrayLight(ghosts=(Ghost(-3.0, 1e-3, 0.1),))])
def test_light_is_redistributed_and_none_is_lost(stray):
    camera = camera_with(stray)
    image = np.random.default_rng(1).random((150, 200, 3)) ** 8 * 1e4
    image[3, 190] = 1e9  # the sun near a corner
    result = add_stray_light(image, camera)
    np.testing.assert_allclose(result.sum(axis=(0, 1)), image.sum(axis=(0, 1)), rtol=1e-12)
    assert result.min() >= 0.0
    if not stray.ghosts:
        even = add_stray_light(np.full((150, 200, 3), 70.0), camera)
        np.testing.assert_allclose(even, 70.0, rtol=1e-10)


def test_point_spreads_alike_in_both_directions_and_is_reciprocal():
    camera = camera_with(NO_GHOSTS)
    spread = add_stray_light(image_of(camera, (75, 100)), camera)[..., 1]
    for down, right in ((3, 0), (0, 3), (2, 5), (5, 2)):
        values = [spread[75 + i * down, 100 + j * right] for i in (-1, 1) for j in (-1, 1)]
        np.testing.assert_allclose(values, values[0], rtol=2e-3)  # mirrored borders are not the same
    # From one pixel to another as from the other to the one, corners included.
    a, b = (2, 3), (140, 20)
    forth, back = (add_stray_light(image_of(camera, p), camera)[q][1] for p, q in ((a, b), (b, a)))
    assert forth == pytest.approx(back, rel=1e-9)


@pytest.mark.parametrize("pitch_m", [1.4e-6, 9e-6])
def test_near_pixels_match_direct_integration(pitch_m):
    # Light from random places in a pixel, on random places in another, by the formulas of both densities.
    stray, rng, n = StrayLight(scatter=0.3, veil=0.0, ghosts=()), np.random.default_rng(3), 400_000
    quarter = point_spread(stray, 2.8, pitch_m, WAVELENGTH_M, (40, 40))
    for down, right in ((0, 3), (2, 2), (5, 8), (12, 0), (9, 30)):
        distance = np.hypot(*(rng.random((2, n)) - rng.random((2, n)) + [[down], [right]])) * pitch_m
        v = np.pi * distance / (2.8 * WAVELENGTH_M)
        airy = np.pi / (2 * 2.8 * WAVELENGTH_M) ** 2 * (2 * j1(v) / v) ** 2
        scatter = 0.31 / (np.pi * 1.76e-6**2) * (1 + (distance / 1.76e-6) ** 2) ** -1.31
        light = (0.7 * airy + 0.3 * scatter) * pitch_m**2
        error = 5 * light.std() / np.sqrt(n)
        assert quarter[down, right] == pytest.approx(light.mean(), rel=0.02, abs=error)


def test_light_beyond_a_radius_follows_the_closed_forms():
    # The Airy disc at f/16 covers many pixels: the centre has the density pi / (4 N^2 lambda^2).
    centre = point_spread(StrayLight(0.0, veil=0.0, ghosts=()), 16.0, 2e-6, WAVELENGTH_M, (30, 30))[0, 0]
    assert centre == pytest.approx(np.pi / (4 * (16 * WAVELENGTH_M) ** 2) * (2e-6) ** 2, rel=0.05)
    stray, pitch_m = StrayLight(scatter=0.4, veil=0.1, ghosts=()), 9e-6
    quarter = point_spread(stray, 2.0, pitch_m, WAVELENGTH_M, (600, 600))
    row, column = np.ogrid[:601, :601]
    for pixels in (20, 100, 400):
        inside = whole_sum(np.where(np.hypot(row, column) < pixels, quarter, 0.0))
        radius = pixels * pitch_m
        # 1 - J0^2 - J1^2 approaches 1 - 2 / (pi v), with v = pi r / (N lambda).
        direct = 0.5 * (1 - 2 * 2.0 * WAVELENGTH_M / (np.pi**2 * radius))
        scattered = 0.4 * (1 - (1 + (radius / 1.76e-6) ** 2) ** -0.31)
        assert inside == pytest.approx(direct + scattered, abs=4e-4)


def test_veiling_glare_index_of_the_default_is_1_to_2_percent():
    # ISO 9358: the light in the middle of a black disc on an extended white field. Chosen: the disc has a
    # fifth and a tenth of the height of the image.
    for fraction, low, high in ((0.2, 0.010, 0.020), (0.1, 0.012, 0.021)):
        camera = camera_with(StrayLight(), 800, 600)
        row, column = np.ogrid[:600, :800]
        black = np.hypot(row - 299.5, column - 399.5) < 300 * fraction
        image = np.repeat(np.where(black, 0.0, 1000.0)[..., None], 3, axis=2)
        index = add_stray_light(image, camera)[298:302, 398:402].mean() / 1000.0
        assert low < index < high


def test_veil_alone_is_a_fraction_of_the_mean():
    stray = StrayLight(scatter=0.0, veil=0.02, ghosts=())
    camera = camera_with(stray, f_number=0.5)
    image = image_of(camera, (75, 100))
    far = add_stray_light(image, camera)[0, 0]
    # And the diffraction that reaches the corner, 125 pixels away, is far less.
    np.testing.assert_allclose(far, 0.02 * image.mean(axis=(0, 1)), rtol=0.05)


@pytest.mark.parametrize("magnification", [-1.0, 0.6])
def test_ghost_is_scaled_about_the_axis_and_has_its_light(magnification):
    ghost = Ghost(magnification, 5e-5, 0.05)
    camera = camera_with(StrayLight(0.0, veil=0.0, ghosts=(ghost,)))
    without = camera_with(StrayLight(0.0, veil=0.0, ghosts=()))
    image = image_of(camera, (40, 140))
    difference = add_stray_light(image, camera) - 0.95 * add_stray_light(image, without)
    weight = np.maximum(difference[..., 1], 0.0)
    # The two pictures differ by a constant: light that diffraction takes out of the image.
    weight[weight < 0.01 * weight.max()] = 0.0
    assert weight.sum() == pytest.approx(0.05 * 1e6, rel=0.05)
    row, column = np.mgrid[:150, :200] + 0.5
    centre = [(weight * axis).sum() / weight.sum() for axis in (row, column)]
    expected = [75 + magnification * (40.5 - 75), 100 + magnification * (140.5 - 100)]
    np.testing.assert_allclose(centre, expected, atol=3.5)  # cells of three pixels
    # Blurred to the radius of 5.6 pixels, and no further than a few cells.
    distance = np.hypot(row - centre[0], column - centre[1])
    assert 2.5 < np.sqrt((weight * distance**2).sum() / weight.sum() / 2) < 6.0


def test_ghosts_move_with_the_optical_axis():
    stray = StrayLight(0.0, veil=0.0, ghosts=(Ghost(-1.0, 5e-5, 0.05),))
    camera = camera_with(stray, principal_offset_m=(20 * 9e-6, -10 * 9e-6))
    ghost = add_stray_light(image_of(camera, (65, 150)), camera)[..., 1]
    ghost[60:70, 145:155] = 0.0
    row, column = np.unravel_index(ghost.argmax(), ghost.shape)
    # The axis is at row 65 and column 120, so that the ghost of column 150 is at 90.
    assert abs(row - 65) <= 6
    assert abs(column - 90) <= 6


def test_raises_on_impossible_numbers():
    for wrong in (
        {"scatter": -0.1}, {"scatter": 0.8, "veil": 0.2}, {"veil": float("nan")}, {"scatter_width_m": 0.0},
        {"scatter_exponent": 1.0}, {"ghosts": (Ghost(0.0, 1e-3, 0.1),)},
        {"ghosts": (Ghost(1.0, 0.0, 0.1),)}, {"ghosts": (Ghost(1.0, 1e-3, 0.95),)},
    ):  # fmt: skip
        with pytest.raises(ValueError, match=r"stray light|scatter|ghost"):
            StrayLight(**wrong)


def test_factor_is_what_is_left_of_independent_deviations():
    camera = replace(camera_with(StrayLight()), developing=Developing(stray_light=True))
    image = np.random.default_rng(4).normal(1000.0, 30.0, (camera.height, camera.width, 3))
    # 90,000 deviations give the ratio to .4 %.
    left = add_stray_light(image, camera).std() / image.std()
    assert stray_light_factor(camera) == pytest.approx(left, rel=0.02)
    assert stray_light_factor(camera) < 0.9
    assert stray_light_factor(camera_with(StrayLight())) == 1.0
