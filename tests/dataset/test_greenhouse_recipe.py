"""The tables [growth] and [greenhouse]: what they allow, what they change, and that faults are told."""

from __future__ import annotations

import datetime
import shutil

import numpy as np
import pytest
import tomli_w

from pepperscene.cultivar import interpolate_cultivars, load_cultivar
from pepperscene.dataset import FrameRenderer, load_recipe, parse_changes
from pepperscene.dataset.recipe.recipe import Recipe
from pepperscene.dataset.recipe.resolved import load_recipe_cultivar
from pepperscene.dataset.recipe.tables import GreenhouseTable
from pepperscene.errors import InputError
from pepperscene.shipped import shipped_folder


def with_changes(*texts, recipe="barth2018"):
    return load_recipe(recipe, parse_changes(texts))


def fault(*texts, recipe="barth2018"):
    with pytest.raises(InputError) as caught:
        with_changes(*texts, recipe=recipe)
    message = str(caught.value)
    # One sentence on one line.
    assert "\n" not in message
    return message


# --- greenhouse ---------------------------------------------------------------------------------------------


def test_without_the_tables_a_recipe_is_what_it_was():
    recipe = load_recipe("barth2018")
    assert (recipe.growth, recipe.greenhouse) == (None, None)
    assert not {"growth", "greenhouse"} & set(recipe.identity()["recipe"])
    assert set(load_recipe("greenhouse").identity()["recipe"]["greenhouse"]) == set(
        GreenhouseTable.model_fields
    )


@pytest.mark.parametrize("key", GreenhouseTable.model_fields)
def test_every_key_changes_what_the_data_set_is(key):
    value = getattr(load_recipe("greenhouse").greenhouse, key)
    other = (not value) if isinstance(value, bool) else value + 1
    changed = with_changes(f"greenhouse.{key}={str(other).lower()}", recipe="greenhouse")
    assert getattr(changed.greenhouse, key) == other
    assert changed.sha256() != load_recipe("greenhouse").sha256()


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ("greenhouse.row_lean_deg=21", "greenhouse.row_lean_deg=21"),
        ("greenhouse.row_lean_deg=-1", "greater than or equal to 0"),
        ("greenhouse.turn_sd_deg=nan", "greenhouse.turn_sd_deg"),
        ("greenhouse.floor=1", "greenhouse.floor"),
        ("greenhouse.far_rows=1.5", "greenhouse.far_rows"),
        ("greenhouse.far_rows=6", "less than or equal to 5"),
        ("greenhouse.aisle_mm=100", "greenhouse.aisle_mm"),
        ("greenhouse.roof=true", "not a known key"),
        ("greenhouse=true", "greenhouse"),
        ("greenhouse.gutter_height_mm=300", "needs a gutter_width_mm above 0"),
        ("greenhouse.gutter_width_mm=50", "at least 110"),
        ("greenhouse.gutter_width_mm=210", "must be at most row.gap_mm, 200"),
        ("greenhouse.crop_wire_mm=400", "at least 500 above the gutter"),
    ],
)
def test_faults_of_the_greenhouse(change, told):
    message = fault(change)
    assert told in message
    assert "--set" in message


def test_gutters_across_the_aisle_must_not_overlap():
    message = fault("greenhouse.gutter_width_mm=700", "greenhouse.aisle_mm=650", "row.gap_mm=800")
    assert "must be at most greenhouse.aisle_mm, 650" in message
    # Of a single row there is no other gutter within the gap.
    alone = with_changes("greenhouse.gutter_width_mm=300", "row.plants_back=0")
    assert alone.greenhouse.gutter_width_mm == 300


def test_the_arc_leans_with_the_row():
    upright = load_recipe("barth2018")
    leaning = with_changes("greenhouse.row_lean_deg=4", "greenhouse.gutter_width_mm=200")
    before, after = (
        np.array([stage.camera(recipe.plan.frame(step)).pose for step in (0, 100, 249)])
        for recipe in (upright, leaning)
        for stage in [FrameRenderer(recipe)]
    )
    height = before[:, 2, 3]
    np.testing.assert_allclose(after[:, :, :3], before[:, :, :3])
    np.testing.assert_allclose(after[:, [0, 2], 3], before[:, [0, 2], 3])
    # The stems' feet stand 144 mm above the floor.
    np.testing.assert_allclose(
        before[:, 1, 3] - after[:, 1, 3], np.tan(np.radians(4)) * (height - 0.144), atol=1e-12
    )


# --- growth -------------------------------------------------------------------------------------------------


def stem_mean(cultivar):
    """Mean internode length, a number that differs between stages."""
    law = cultivar.organs["internode"].length
    return float(law.quantiles(np.linspace(0.005, 0.995, 100), np.full(100, 0.5)).mean())


def test_a_share_lies_between_the_stages():
    first, last = load_cultivar("kaite"), load_cultivar("kaite_september")
    recipe = with_changes("growth.until=kaite_september", "growth.share=0.25")
    assert stem_mean(load_recipe_cultivar(recipe)) == pytest.approx(
        stem_mean(interpolate_cultivars(first, last, 0.25))
    )
    ends = [
        stem_mean(load_recipe_cultivar(with_changes("growth.until=kaite_september", f"growth.share={share}")))
        for share in ("0.0", "1.0")
    ]
    assert ends == pytest.approx([stem_mean(first), stem_mean(last)])


def test_a_date_is_a_share():
    first, last = load_cultivar("kaite"), load_cultivar("kaite_september")
    day = first.date + (last.date - first.date) / 2
    days = (day - first.date).days / (last.date - first.date).days
    dated = with_changes("growth.until=kaite_september", f"growth.date={day.isoformat()}")
    shared = with_changes("growth.until=kaite_september", f"growth.share={days!r}")
    assert load_recipe_cultivar(dated) == load_recipe_cultivar(shared)
    assert dated.growth.date == day
    assert dated.identity()["recipe"]["growth"]["date"] == day.isoformat()
    assert dated.sha256() != shared.sha256()


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        (["growth.until=kaite_september"], "either share or date"),
        (["growth.share=0.5"], "growth.until: is required"),
        (
            ["growth.until=kaite_september", "growth.share=0.5", "growth.date=2016-06-01"],
            "either share or date",
        ),
        (["growth.until=kaite_september", "growth.share=1.5"], "growth.share=1.5"),
        (
            ["growth.until=kaite_september", "growth.date=2015-06-01"],
            "growth.date=2015-06-01: must lie between",
        ),
        (["growth.until=kaite_september", "growth.date=2016-06-01T12:00:00"], "growth.date"),
        (["growth.until=kaite_september", "growth.date=june"], "growth.date"),
        (["growth.until=nothing", "growth.share=0.5"], "kaite_september"),
        # Earlier than the first stage.
        (["growth.until=kaite_february", "growth.date=2016-03-01"], "must lie between"),
        # Another crop has other organs.
        (["growth.until=tomato", "growth.share=0.5"], "growth.until=tomato"),
    ],
)
def test_faults_of_growth(changes, told):
    message = fault(*changes)
    assert told in message
    assert "--set" in message


def test_a_stage_without_a_date_has_no_date_between(tmp_path):
    file = tmp_path / "undated.toml"
    lines = (shipped_folder("plants") / "kaite.toml").read_text(encoding="utf-8").splitlines()
    file.write_text("\n".join(line for line in lines if not line.startswith("date")), encoding="utf-8")
    message = fault(f"growth.until={file}", "growth.date=2016-06-01")
    assert "needs a date in the file of Kaite" in message


def test_both_stages_and_their_parents_are_part_of_the_identity(tmp_path):
    for name in ("kaite", "kaite_september"):
        shutil.copy(shipped_folder("plants") / f"{name}.toml", tmp_path)
    later = tmp_path / "kaite_september.toml"
    tables = {"until": "kaite_september.toml", "share": 0.5}
    path = tmp_path / "mine.toml"
    path.write_text(tomli_w.dumps({"extends": "barth2018", "growth": tables}), encoding="utf-8")
    recipe = load_recipe(path)
    # Paths are seen from the recipe's folder, and are no part of the identity.
    assert recipe.growth.until == str(later)
    identity = recipe.identity()
    assert identity["recipe"]["growth"]["until"] == "kaite_september"
    assert str(tmp_path) not in str(identity)
    shipped = with_changes("growth.until=kaite_september", "growth.share=0.5")
    assert identity["files"] == shipped.identity()["files"]
    parents = {key: one["name"] for key, one in identity["files"].items() if key.startswith("growth.until")}
    assert parents == {"growth.until": "kaite_september", "growth.until.1": "kaite"}
    text = later.read_text(encoding="utf-8")
    later.write_text("# a remark\n" + text, encoding="utf-8")
    assert recipe.identity() == identity
    later.write_text(text.replace("parts = 46", "parts = 45"), encoding="utf-8")
    changed = recipe.identity()["files"]
    assert {key for key in changed if changed[key] != identity["files"][key]} == {"growth.until"}


def test_a_date_in_a_change_is_told_as_a_date():
    from pepperscene.dataset.recipe.load import label

    assert label("growth.date", datetime.date(2016, 6, 1)) == "--set growth.date=2016-06-01"
    assert parse_changes(["growth.date=2016-06-01"]) == {"growth.date": datetime.date(2016, 6, 1)}
    assert Recipe.model_fields["growth"].default is None
