"""The camera of a recipe: sensor settings, filter, white balance and the other steps of developing."""

from __future__ import annotations

import dataclasses
import json

import numpy as np
import pytest

from pepperscene.camera import Developing, load_filter, load_sensor
from pepperscene.errors import InputError
from pepperscene.recipe.resolve.load import load_recipe, resolve_recipe
from pepperscene.recipe.resolve.load_camera import surface_wavelengths
from pepperscene.spectra import Spectrum


def camera_with(changes):
    return resolve_recipe("barth2018", changes).camera


def test_sensor_settings():
    before = camera_with({})
    after = camera_with({"camera.focus_mm": 350, "camera.gain": 4, "camera.bits": 8})
    assert (before.focus_m, after.focus_m) == (0.4, 0.35)
    assert (after.sensor.gain, after.sensor.bits) == (4, 8)
    assert before.sensor.gain == 1
    # A gain of 4 makes 4 times the digital numbers of the same electrons, on a converter of 8 bits.
    before, after = before.sensor, after.sensor
    ranges = [sensor.full_scale_dn - sensor.black_level_dn for sensor in (before, after)]
    ratio = before.gain_e_per_dn / after.gain_e_per_dn
    assert ratio == pytest.approx(4 * ranges[1] / ranges[0])


def test_filter_reduces_the_quantum_efficiency():
    sensor = camera_with({"camera.filter": "schott_22022010"}).sensor
    without = load_sensor("ueye_ui5250re").quantum_efficiency
    nm = np.arange(400.0, 701.0, 50.0)
    expected = without.at(nm) * load_filter("schott_22022010").transmittance.at(nm)
    np.testing.assert_allclose(sensor.quantum_efficiency.at(nm), expected)


def test_surface_wavelengths_cover_the_sensitive_range():
    def sensor(nm, efficiency):
        curve = Spectrum(np.array(nm), np.array([efficiency]))
        return dataclasses.replace(load_sensor("onsemi_mt9v024_mono"), quantum_efficiency=curve)

    grid = surface_wavelengths(sensor([300.0, 402.0, 500.0, 993.0, 1100.0], [0.0, 0.0, 0.5, 0.0, 0.0]))
    np.testing.assert_array_equal(grid, np.arange(400.0, 996.0, 5.0))
    # A curve that ends high is zero beyond.
    grid = surface_wavelengths(sensor([400.0, 412.0], [0.5, 0.5]))
    np.testing.assert_array_equal(grid, [400, 405, 410, 415])
    with pytest.raises(ValueError, match="is sensitive up to 2600 nm"):
        surface_wavelengths(sensor([900.0, 2600.0], [0.5, 0.5]))
    with pytest.raises(ValueError, match="is not sensitive at any wavelength"):
        surface_wavelengths(sensor([400.0, 700.0], [0.0, 0.0]))
    with pytest.raises(ValueError, match="is not sensitive at any whole number of nanometres"):
        surface_wavelengths(sensor([500.2, 500.5, 500.8], [0.0, 0.5, 0.0]))


def test_without_a_flash_the_white_balance_must_be_another():
    with pytest.raises(InputError, match=r"camera\.flash = .none.: needs a developing"):
        load_recipe("barth2018", {"camera.flash": "none"})
    for balance, expected in (("daylight", "daylight"), ("none", None)):
        changes = {"camera.flash": "none", "developing.white_balance": balance}
        assert "flash" not in load_recipe("barth2018", changes).identity()["files"]
        assert camera_with(changes).developing.white_balance == expected
    monochrome = {"camera.flash": "none", "camera.sensor": "onsemi_mt9v024_mono"}
    assert camera_with(monochrome).flash is None
    # Nor does a sensor with bands need another.
    bands = dict.fromkeys(("camera.sensor", "camera.lens"), "micasense_rededge_mx") | {"camera.flash": "none"}
    assert camera_with(bands).developing.white_balance == "daylight"


def test_developing_of_a_recipe_is_that_of_its_camera():
    own = {"developing.stray_light": False, "developing.pedestal": 0}  # the recipe's own are others
    steps = camera_with({"developing.tone": "linear", "developing.read_noise": False, **own}).developing
    assert steps == Developing(tone="linear", read_noise=False)


GAINS = (1.9, 1.0, 1.5)
MATRIX = ((1.6, -0.4, -0.2), (-0.2, 1.5, -0.3), (0.1, -0.6, 1.5))


def test_gains_and_matrix_in_camera_and_identity(write_recipe):
    table = {"white_balance": list(GAINS), "colour_matrix": [list(row) for row in MATRIX]}
    base = write_recipe("base.toml", camera={"flash": "none"}, developing=table)
    resolved = resolve_recipe(base)
    steps = resolved.camera.developing
    assert (steps.white_balance, steps.colour_matrix) == (GAINS, MATRIX)

    # The identity holds them and is unchanged by JSON; every entry counts.
    identity = resolved.identity
    assert json.loads(json.dumps(identity)) == identity
    assert {key: identity["recipe"]["developing"][key] for key in table} == table
    other = load_recipe(base, {"developing.white_balance": [1.9, 1.0, 1.50001]})
    assert other.sha256() != resolved.recipe.sha256()

    # A list is replaced as a whole by another kind of value.
    replaced = load_recipe(base, {"developing.white_balance": "daylight", "developing.colour_matrix": True})
    daylight = {"camera.flash": "none", "developing.white_balance": "daylight"}
    assert replaced.sha256() == load_recipe("barth2018", daylight).sha256()


@pytest.mark.parametrize("factor", [1.0, 1.01])
def test_gains_and_matrix_have_limits(factor):
    def is_valid(**table):
        try:
            load_recipe("barth2018", {f"developing.{key}": value for key, value in table.items()})
        except InputError:
            return False
        return True

    rows = [[0, 1, 0], [0, 0, 1]]
    tables = [{"white_balance": [gain, 1, 1]} for gain in (0.01 / factor, 100 * factor)]
    tables += [{"colour_matrix": [[sign * 100 * factor, 0, 0], *rows]} for sign in (-1, 1)]
    assert [is_valid(**table) for table in tables] == [factor == 1.0] * 4
