"""The flash's light straight ahead, integrated over random points of its LEDs from its file's numbers."""

from __future__ import annotations

import dataclasses
import math
import tomllib

import numpy as np
import pytest
from bodies import columns_of, lux

from pepperscene.camera import load_flash
from pepperscene.shipped import shipped_folder

FOLDER = shipped_folder("materials") / "flashes"
DRAWS = 400_000
"""The LEDs' contributions differ by 3 %, so the mean of this many draws is off by 5e-5 (one deviation)."""


def load_table(name):
    return tomllib.loads((FOLDER / f"{name}.toml").read_text(encoding="utf-8"))


def random_points(table, rng):
    """`(DRAWS, 2)` points on the LEDs, uniform over their areas, metres from the centre of the matrix."""
    matrix, radius = table["matrix"], table["radius_mm"]
    middle = (np.array([matrix["columns"], matrix["rows"]]) - 1) / 2
    led = (rng.integers(0, [matrix["columns"], matrix["rows"]], (DRAWS, 2)) - middle) * matrix["pitch_mm"]
    within = rng.uniform(-radius, radius, (3 * DRAWS, 2))
    within = within[np.hypot(*within.T) < radius][:DRAWS]
    assert len(within) == DRAWS
    return (led + within) * 1e-3


def falloff(points, target, table):
    """`(n,)` p(theta) cos / r^2 of points of the flash at a target `(3,)` on a plane that faces it."""
    ray = target - np.column_stack([points, np.zeros(len(points))])
    distance = np.linalg.norm(ray, axis=-1)
    cosine = ray[:, 2] / distance
    profile = table["profile"]
    relative = np.interp(
        np.degrees(np.arccos(cosine)), profile["angle_deg"], profile["relative_intensity"], right=0
    )
    return relative * cosine / distance**2


@pytest.mark.parametrize("name", ["led_matrix_200klx", "led_nir_850nm"])
def test_leds_give_the_stated_strength_at_the_stated_distance(name):
    table, flash = load_table(name), load_flash(name)
    file = (FOLDER / table["spectrum"]["file"]).relative_to(shipped_folder("materials")).with_suffix("")
    nm = np.arange(*columns_of(str(file))[table["spectrum"]["column"]][0][[0, -1]], 0.1)
    points = random_points(table, np.random.default_rng(20180))
    factor = falloff(points, np.array([0, 0, table["at_mm"] * 1e-3]), table)
    assert factor.std() / factor.mean() / math.sqrt(DRAWS) < 1e-4
    irradiance = flash.radiant_intensity(nm) * factor.mean()
    # Five deviations of the draws, and as much for the quadrature over wavelength.
    if "irradiance_W_m2" in table:
        assert np.trapezoid(irradiance, nm) == pytest.approx(table["irradiance_W_m2"], rel=5e-4)
    else:
        assert lux(nm, irradiance) == pytest.approx(table["illuminance_lx"], rel=5e-4)


@pytest.mark.parametrize("at_m", [0.05, 0.2, 2.0])
def test_strength_given_at_another_distance(at_m):
    # At a short distance, LEDs far from the axis contribute little straight ahead.
    table = load_table("led_matrix_200klx")
    flash = dataclasses.replace(load_flash("led_matrix_200klx"), at_m=at_m)
    factor = falloff(random_points(table, np.random.default_rng(7)), np.array([0, 0, at_m]), table)
    five_deviations = 5 * factor.std() / factor.mean() / math.sqrt(DRAWS)
    assert factor.mean() * flash.axial_area_m2 == pytest.approx(1.0, abs=five_deviations)
    # Far away it is a point, except for the profile's slope: the LEDs are 0.7 degrees off the axis.
    relative_to_point = flash.axial_area_m2 / at_m**2
    if at_m == 2.0:
        assert relative_to_point == pytest.approx(1.01, abs=2e-3)
    if at_m == 0.05:
        assert relative_to_point > 2
