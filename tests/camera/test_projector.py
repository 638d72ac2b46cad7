"""The projector of a depth camera: its dots, its power, its file."""

from __future__ import annotations

import math
import tomllib

import numpy as np
import pytest
import tomli_w

from pepperscene.camera import load_projector
from pepperscene.errors import InputError
from pepperscene.shipped import shipped_folder

SHIPPED = shipped_folder("materials") / "projectors" / "realsense_d435.toml"


@pytest.fixture(scope="module")
def projector():
    return load_projector("realsense_d435")


def test_dots_are_in_the_field_of_projection(projector):
    directions = projector.directions()
    slopes = np.abs(directions[..., :2] / directions[..., 2:])
    assert directions.shape[0] * directions.shape[1] == pytest.approx(5000, rel=0.02)
    np.testing.assert_allclose(np.linalg.norm(directions, axis=-1), 1.0)
    limits = math.tan(math.radians(43.0)), math.tan(math.radians(28.5))
    assert (slopes.max(axis=(0, 1)) <= limits).all()
    assert (slopes.max(axis=(0, 1)) > 0.98 * np.array(limits)).all()


def test_no_part_of_a_row_repeats(projector):
    # The places of dots in their cells, in windows of five cells along a row, are all different.
    directions = projector.directions()
    place = directions[..., 0] / directions[..., 2] * directions.shape[1]
    steps = np.diff(place, axis=1)
    windows = np.lib.stride_tricks.sliding_window_view(steps, 5, axis=1).reshape(-1, 5)
    order = np.lexsort(windows.T)
    assert np.abs(np.diff(windows[order], axis=0)).max(axis=1).min() > 1e-6


def test_dots_and_flood_have_the_power_of_the_device(projector):
    # A dot is a Gaussian of the angle: the integral of its intensity over the solid angle.
    angle = np.linspace(0.0, 0.02, 4001)
    deviation = 0.003 / (2.0 * math.sqrt(2.0 * math.log(2.0)))
    profile = np.exp(-0.5 * (angle / deviation) ** 2)
    power = projector.dot_intensity * np.trapezoid(profile * 2.0 * np.pi * np.sin(angle), angle)
    rows, columns = projector.grid
    assert rows * columns * power == pytest.approx(0.36, rel=1e-3)
    # The flash without dots: its intensity over the solid angle of its circle.
    flash = projector.flood()
    angle = np.linspace(0.0, flash.profile.angle_rad[-1], 4001)
    intensity = flash.irradiance_W_m2 * flash.profile.at(angle)
    assert np.trapezoid(intensity * 2.0 * np.pi * np.sin(angle), angle) == pytest.approx(0.36, rel=2e-3)


@pytest.mark.parametrize("step_nm", [0.5, 5.0])
def test_spectral_power_is_kept_on_any_grid(projector, step_nm):
    grid = np.arange(400.0, 1000.0, step_nm)
    power = projector.spectral_power(grid)
    assert power.sum() * step_nm == pytest.approx(1.0, abs=1e-6)
    assert (power * grid).sum() * step_nm == pytest.approx(850.0, abs=step_nm / 2 + 0.01)


@pytest.mark.parametrize(
    ("key", "value"),
    [("power_mW", 0), ("dot_mrad", 50.0), ("width_deg", 180), ("offset_mm", [0, 0])],
)
def test_errors_name_file_and_key(tmp_path, key, value):
    content = tomllib.loads(SHIPPED.read_text(encoding="utf-8"))
    del content["sources"]
    path = tmp_path / "mine.toml"
    path.write_text(tomli_w.dumps({**content, key: value}), encoding="utf-8")
    with pytest.raises(InputError, match=f"mine.toml.*{key}"):
        load_projector(path)
