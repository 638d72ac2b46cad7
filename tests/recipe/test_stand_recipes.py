"""Recipes with a stand: invalid values are one sentence and exit code 2, and files of colours count."""

from __future__ import annotations

import pytest
from typer.testing import CliRunner

from pepperscene.cli import app
from pepperscene.errors import InputError
from pepperscene.recipe.resolve.load import resolve_recipe

CHART = "[[stand.charts]]\nposition_mm = [0, 0, 100]\n"
INVALID = [
    ("[stand]\npot_width_mm = 900", "stand.pot_width_mm = 900"),
    ("[stand]\npot_height_mm = -100", "stand.pot_height_mm = -100"),
    ("[stand]\npot_width_mm = 500", "stand: turntable_mm = 420 must be 0 for none"),
    ("[stand]\npot = 'round'\npot_shape = 'square'", "stand.pot_shape"),
    ("[stand]\nbackdrop = ['cloth', 'cabin']", "stand.backdrop"),
    ("[stand]\nbackdrop = 'curtain'", "stand.backdrop"),
    ("[stand]\nbackdrop = 'cloth'\nturntable_mm = 2000", "stand: backdrop_distance_mm"),
    ("[stand]\nstake_mm = 3", "stand.stake_mm"),
    ("[stand]\npot_colour = 'pink'", "stand.pot_colour"),
    ("[stand]\npot_colour = 'mine.csv'", "stand.pot_colour"),
    ("[stand]\nbackdrop_colour = 'percent.csv'", "stand.backdrop_colour"),
    ("[stand]\nturn_deg = 400", "stand.turn_deg = 400"),
    ("[row]\nplants_front = 3", "stand: is for one plant"),
    ("[greenhouse]\nfloor = true", "stand: is for one plant"),
    (
        "[plan]\nframes = 2\n[views]\nkind = 'random'\ntarget = 'leaf'\ndistance_mm = [300, 500]",
        "stand.turn_deg = 6",
    ),
    (CHART + "kind = 'charuco'\ncell_mm = 1", "stand.charts.0.cell_mm = 1"),
    (CHART + "kind = 'charuco'\ncount = [12, 9]", "stand.charts.0: count = [12, 9] needs 54 markers"),
    (CHART + "kind = 'charuco'\ncount = [1, 9]", "stand.charts.0: count must be at least [2, 2]"),
    (CHART + "kind = 'aruco'\nfirst_marker = 48", "stand.charts.0: count = [2, 2] needs 4 markers"),
    (CHART + "kind = 'colorchecker'\ncount = [4, 6]", "stand.charts.0: count must be [6, 4]"),
    (CHART + "kind = 'scale_bar'\ncount = [4, 6]", "stand.charts.0: count must have one row"),
    (CHART + "kind = 'chequers'", "stand.charts.0.kind"),
]  # fmt: skip


@pytest.mark.parametrize(("text", "message"), INVALID, ids=[message for _, message in INVALID])
def test_invalid_stands_are_one_sentence_and_exit_code_2(tmp_path, text, message):
    (tmp_path / "percent.csv").write_text("wavelength_nm,cloth\n400,20\n700,30\n")
    path = tmp_path / "mine.toml"
    path.write_text(f'extends = "turntable"\n{text}\n')
    result = CliRunner().invoke(app, ["build", str(path), "--out", str(tmp_path / "set")])
    assert result.exit_code == 2
    assert result.stderr.count("\n") == 1
    assert message in result.stderr
    assert not (tmp_path / "set").exists()


def test_a_colour_can_be_a_file_of_spectra_beside_the_recipe(tmp_path):
    path, colour = tmp_path / "mine.toml", tmp_path / "mine.csv"
    path.write_text('extends = "turntable"\n[stand]\npot_colour = "mine.csv"\n')
    identities = []
    for reflectance in (0.2, 0.3):
        colour.write_text(f"wavelength_nm,pot\n400,{reflectance}\n700,{reflectance}\n")
        recipe = resolve_recipe(path).recipe
        assert recipe.stand.pot_colour == str(colour)
        identities.append(recipe.identity())
    assert identities[0] != identities[1]
    assert str(tmp_path) not in str(identities)
    assert identities[0]["files"]["pot_colour"]["name"] == "mine"


def test_stands_can_vary_from_set_to_set():
    changes = {
        "stand.pot_colour": {"terracotta": 0.5, "black": 0.5},
        "stand.pot_width_mm": {"low": 100, "high": 150},
    }
    recipe = resolve_recipe("phenotyping_cabin", changes).recipe
    assert {varied.per for varied in recipe.variation} == {"set"}


def test_a_file_that_is_no_reflectance_is_an_input_error(tmp_path):
    with pytest.raises(InputError, match=r"stand.backdrop_colour.*neither a file of spectra nor one of"):
        resolve_recipe("turntable", {"stand.backdrop_colour": "green"})
