"""Lamps of recipes: where they are, and one sentence for what cannot be."""

import numpy as np
import pytest

from pepperscene.camera import colour_transform
from pepperscene.errors import InputError
from pepperscene.recipe.resolve.load import resolve_recipe

HEAD = 'extends = "barth2018"\nname = "lit"\n'
PANEL = '[[lamps]]\nlamp = "led_panel_600mm"\nposition_mm = [100, 200, 3000]\n'


def resolved(folder, text):
    (folder / "lit.toml").write_text(HEAD + text, encoding="utf-8")
    return resolve_recipe(folder / "lit.toml")


def test_grid_hangs_above_the_crop_and_shines_down(tmp_path):
    lamps = resolved(tmp_path, PANEL + "count = [3, 2]\nspacing_mm = [1000, 500]\nflux_lm = 100\n").lamps
    places = [lamp.position_m.tolist() for lamp in lamps]
    expected = [[x, y, 3.0] for y in (-0.05, 0.45) for x in (-0.9, 0.1, 1.1)]
    np.testing.assert_allclose(places, expected, atol=1e-12)
    assert all(lamp.rotation[:, 2].tolist() == [0, 0, -1] for lamp in lamps)
    assert [lamp.flux_lm for lamp in lamps] == pytest.approx([100.0] * 6)


def test_lamp_of_the_camera_looks_forwards_or_at_its_aim(tmp_path):
    text = (
        PANEL
        + 'fixed = "camera"\n'
        + PANEL.replace("100, 200, 3000", "0, 0, 0")
        + "aim_mm = [10, 0, 0]\nturn_deg = 90\n"
    )
    recipe = resolved(tmp_path, text)
    (at_camera,), (in_world,) = recipe.camera.lamps, recipe.lamps
    assert at_camera.position_m.tolist() == [0.1, 0.2, 3.0]
    np.testing.assert_allclose(at_camera.rotation, np.eye(3), atol=1e-12)
    # Along the row, a lamp's x axis is along the second axis, and turned by 90 degrees along the third.
    np.testing.assert_allclose(in_world.rotation.T, [[0, 0, 1], [0, -1, 0], [1, 0, 0]], atol=1e-12)


def test_identity_has_the_files_of_lamps(tmp_path):
    dark, lit = resolved(tmp_path, ""), resolved(tmp_path, PANEL)
    assert "lamps" not in dark.identity["recipe"]
    assert {"lamp", "lamp.spectrum"} <= lit.identity["files"].keys()
    assert dark.recipe.sha256() != lit.recipe.sha256()


LAMP = """
name = "mine"
shape = "disc"
radius_mm = 100
flux_lm = 10
[spectrum]
file = "mine.csv"
column = "lamp"
[beam]
kind = "lambertian"
"""
CURVE = "wavelength_nm,lamp\n400,1\n700,1\n"


def own_lamp(folder, lamp=LAMP, curve=CURVE):
    (folder / "mine.toml").write_text(lamp)
    (folder / "mine.csv").write_text(curve)
    return resolved(folder, '[[lamps]]\nlamp = "mine.toml"\nposition_mm = [0, 0, 0]\n')


def test_lamp_with_a_curve_of_a_user(tmp_path):
    (lamp,) = own_lamp(tmp_path).lamps
    assert lamp.name == "mine"
    assert lamp.flux_lm == pytest.approx(10.0)


def test_white_balance_of_lamps_is_that_of_their_light_together(tmp_path):
    """A white card in the light of lamps in the world and at the camera, by sums over spectra."""
    text = '[developing]\nwhite_balance = "lamps"\n' + PANEL + "count = [2, 1]\nspacing_mm = [600, 0]\n"
    text += PANEL.replace("led_panel_600mm", "hps_top_light_1000w") + 'fixed = "camera"\nflux_lm = 6000\n'
    recipe = resolved(tmp_path, text)
    nm = np.arange(300.0, 1100.0, 0.5)
    light = sum(lamp.flux_W * lamp.unit_spectrum.at(nm) for lamp in (*recipe.lamps, *recipe.camera.lamps))
    white = (recipe.camera.sensor.quantum_efficiency.at(nm) * nm * light).sum(axis=1)
    gains, _ = colour_transform(recipe.camera)
    np.testing.assert_allclose(gains * white / (gains * white).mean(), 1.0, rtol=2e-3)
    # By their flux: in less light of the sodium lamp, blue needs a smaller gain.
    bluer, _ = colour_transform(resolved(tmp_path, text.replace("6000", "600")).camera)
    assert bluer[2] < 0.9 * gains[2]
    assert recipe.camera.to_metadata()["developing"]["white_balance"] == "lamps"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('[developing]\nwhite_balance = "lamps"\n', r"white_balance = 'lamps': needs \[\[lamps\]\]"),
        (PANEL.replace("100, 200", "nan, 200"), r"lamps\.0\.position_mm"),
        (PANEL.replace("100, 200", "inf, 200"), r"lamps\.0\.position_mm"),
        (PANEL + "count = [100, 100]\nspacing_mm = [1, 1]\n", "at most 1000 lamps, not 10000"),
        (PANEL + "count = [2, 1]\n", "spacing_mm"),
        (PANEL * 1001, "at most 1000 lamps"),
        (PANEL + "flux_lm = 1\nppf_umol_s = 1\n", "at most one of"),
        (PANEL + "illuminance_lx = 1\n", "illuminance_lx and at_mm together"),
        (PANEL + "aim_mm = [100, 200, 3000]\n", "aim_mm that is not"),
        (PANEL + "flux_lm = { uniform = [1, 2] }\n", r"lamps\.0\.flux_lm"),
        (PANEL.replace("led_panel_600mm", "nothing"), r"lamps\.0\.lamp = 'nothing': no such file"),
        (PANEL.replace("led_panel_600mm", "nothing.ies"), "cannot be read"),
        ('[twins]\n"lamps.0.flux_lm" = [1, 2]\n' + PANEL, "twins"),
    ],
)
def test_what_cannot_be_is_one_sentence(tmp_path, text, message):
    with pytest.raises(InputError, match=message) as caught:
        resolved(tmp_path, text)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("lamp", "curve", "message"),
    [
        (LAMP.replace("10\n", "nan\n"), CURVE, "flux_lm"),
        (LAMP.replace("10\n", "1e9\n"), CURVE, r"at most 1e\+06 W"),
        (LAMP.replace("flux_lm = 10\n", ""), CURVE, "exactly one of flux_lm"),
        (LAMP.replace("radius_mm = 100\n", ""), CURVE, "needs radius_mm"),
        (LAMP.replace('"disc"', '"ring"'), CURVE, "needs inner_radius_mm"),
        (LAMP.replace('kind = "lambertian"', 'file = "x.txt"'), CURVE, r"must be an \.ies or \.ldt file"),
        (LAMP.replace('kind = "lambertian"', "angle_deg = [0, 5]"), CURVE, "given together"),
        (LAMP, "wavelength_nm,lamp\n400,1\n,1\n", "finite number"),
        (LAMP, "wavelength_nm,lamp\n400,1\n500,\n", "finite number"),
        (LAMP, "wavelength_nm,lamp\n400,0\n700,0\n", "0 throughout"),
        (LAMP, "wavelength_nm,lamp\n800,1\n900,1\n", "no light of this kind"),
        (LAMP, "wavelength_nm,lamp\n400,1\n700,-1\n", "at least 0"),
    ],
)
def test_faults_of_lamp_files_are_one_sentence(tmp_path, lamp, curve, message):
    with pytest.raises(InputError, match=message) as caught:
        own_lamp(tmp_path, lamp, curve)
    assert "\n" not in str(caught.value)
