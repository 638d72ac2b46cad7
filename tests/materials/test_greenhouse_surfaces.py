"""Twine and wire, gutters and their contents, floor film, heating pipes."""

import numpy as np
import pytest
from plant_colours import lab
from scipy.integrate import solve_ivp

from pepperscene.materials import greenhouse_surfaces
from pepperscene.materials.greenhouse import FILM_SCATTERING, GROUND_REFLECTANCE
from pepperscene.spectra import read_spectrum

WHITE = ("gutter", "foil", "floor_film", "pipe")


def test_all_but_wire_and_substrate_are_nearly_white(surfaces, nm):
    assert set(greenhouse_surfaces(nm)) == {*WHITE, "twine", "steel", "rockwool"}
    for name in WHITE:
        lightness, a, b = lab(surfaces[name].reflectance[0, 0], nm)
        assert lightness > 85, name
        assert np.hypot(a, b) < 8, name
        # Paint is dark in the ultraviolet only.
        assert surfaces[name].reflectance[0, 0][nm <= 380].max() < 0.25
        assert surfaces[name].reflectance[0, 0][nm >= 430].min() > 0.55
    furrow, crown = (lab(row, nm) for row in surfaces["twine"].reflectance[:, 0])
    assert 80 < crown[0] < 88
    assert furrow[0] < crown[0] - 10
    assert max(np.hypot(*furrow[1:]), np.hypot(*crown[1:])) < 5


def test_twine_is_laid_of_three_strands(surfaces):
    """Three periods around, nine along fifteen diameters: each strand turns once in five diameters."""
    for images in (surfaces["twine"].pattern, surfaces["twine"].relief_mm):
        power = np.abs(np.fft.fft2(images[0] - images[0].mean())) ** 2
        row, column = np.unravel_index(np.argmax(power), power.shape)
        height, width = power.shape
        assert (min(row, height - row), min(column, width - column)) == (9, 3)
        # The helix repeats without a step where v jumps from 1 to 0.
        inside = np.abs(np.diff(images[0], axis=0)).mean()
        assert np.abs(images[0, 0] - images[0, -1]).mean() < 2 * inside
    # Crowns are high and light, furrows low and dark.
    pattern, relief = surfaces["twine"].pattern, surfaces["twine"].relief_mm
    low, high = np.percentile(relief, [20, 80])
    assert pattern[relief > high].mean() > pattern[relief < low].mean() + 0.4


def test_the_floor_solves_the_equations_of_kubelka_and_munk(surfaces, nm):
    """The closed form solves dR/dx = S - 2 (K + S) R + S R^2, from the ground up through the layer."""
    paint = read_spectrum("chart/colorchecker_iso17321_1", "white_9_5_05_d", outside="hold").at(nm)
    scattering = FILM_SCATTERING * 550 / nm
    absorption = scattering * (1 - paint) ** 2 / (2 * paint)

    def rate(depth, r):
        return scattering - 2 * (absorption + scattering) * r + scattering * r**2

    ground = np.full(nm.size, GROUND_REFLECTANCE)
    reflectance = solve_ivp(rate, (0, 1), ground, rtol=1e-9, atol=1e-10).y[:, -1]
    assert surfaces["floor_film"].reflectance[0, 0] == pytest.approx(reflectance, abs=1e-6)


def test_zinc_is_neutral_grey_and_wet_stone_wool_dark_brown(surfaces, nm):
    lightness, a, b = lab(surfaces["steel"].reflectance[0, 0], nm)
    assert 55 < lightness < 75
    assert np.hypot(a, b) < 1
    lightness, a, b = lab(surfaces["rockwool"].reflectance[0, 0], nm)
    assert lightness < 50
    # Between red and yellow.
    assert 0 < np.degrees(np.arctan2(b, a)) < 90
    assert np.hypot(a, b) > 8
