"""The tables `greenhouse` and `growth` of a recipe: what they allow, and what they change."""

from __future__ import annotations

import shutil

import numpy as np
import pytest

from pepperscene.building.scenes.frame_renderer import FrameRenderer
from pepperscene.cultivar import interpolate_cultivars, load_cultivar
from pepperscene.errors import ArgumentError
from pepperscene.recipe.resolve.load import load_recipe, parse_changes
from pepperscene.recipe.resolve.resolved import load_recipe_cultivar
from pepperscene.scene import Greenhouse
from pepperscene.shipped import shipped_folder
from pepperscene.units import file_values, table_fields

UNTIL = "growth.until=kaite_september"


def with_changes(*texts, recipe="barth2018"):
    return load_recipe(recipe, parse_changes(texts))


def error_message(*texts):
    with pytest.raises(ArgumentError) as error:
        with_changes(*texts)
    message = str(error.value)
    assert "\n" not in message
    return message


def test_identity_has_the_values_that_are_no_defaults():
    recipe = load_recipe("barth2018")
    assert (recipe.growth, recipe.greenhouse) == (None, None)
    assert not {"growth", "greenhouse"} & set(recipe.identity()["recipe"])
    same = with_changes("camera.gain=1.0", "camera.filter=none", "daylight.cloud_cover=0.5")
    assert same.identity() == with_changes("daylight.cloud_cover=0.5").identity()
    assert "gain" not in same.identity()["recipe"]["camera"]


@pytest.mark.parametrize("key", table_fields(Greenhouse))
def test_every_key_changes_the_identity(key):
    recipe = load_recipe("greenhouse")
    value = file_values(recipe.greenhouse)[key]
    other = (not value) if isinstance(value, bool) else "ignore" if isinstance(value, str) else value + 1
    changed = with_changes(f"greenhouse.{key}={str(other).lower()}", recipe="greenhouse")
    assert file_values(changed.greenhouse)[key] == other
    assert changed.sha256() != recipe.sha256()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ("row_lean_deg=21", "greenhouse.row_lean_deg = 21"),
        ("turn_sd_deg=nan", "greenhouse.turn_sd_deg"),
        ("floor=1", "greenhouse.floor"),
        ("far_rows=6", "less than or equal to 5"),
        ("roof=true", "not a known key"),
        ("gutter_height_mm=300", "needs a gutter_width_mm above 0"),
        ("gutter_width_mm=50", "at least 110"),
        ("gutter_width_mm=210", "must be at most row.gap_mm, 200"),
        ("crop_wire_mm=400", "at least 500 above the gutter"),
    ],
)
def test_rejects_invalid_greenhouse(change, message):
    assert message in error_message(f"greenhouse.{change}")


def test_gutters_must_not_overlap():
    gutter = "greenhouse.gutter_width_mm"
    message = error_message(f"{gutter}=700", "greenhouse.aisle_mm=650", "row.gap_mm=800")
    assert "must be at most greenhouse.aisle_mm, 650" in message
    # A single row has no other gutter within the gap.
    assert with_changes(f"{gutter}=300", "row.plants_back=0").greenhouse.gutter_width_m == 0.3


def test_camera_path_leans_with_the_row():
    upright, leaning = (
        np.array([renderer.camera(renderer.recipe.plan.frame(step)).pose for step in (0, 100, 249)])
        for changes in ([], ["greenhouse.row_lean_deg=4", "greenhouse.gutter_width_mm=200"])
        for renderer in [FrameRenderer(with_changes(*changes))]
    )
    np.testing.assert_allclose(leaning[:, :, :3], upright[:, :, :3])
    np.testing.assert_allclose(leaning[:, [0, 2], 3], upright[:, [0, 2], 3])
    # Stems begin 144 mm above the floor.
    expected = np.tan(np.radians(4)) * (upright[:, 2, 3] - 0.144)
    np.testing.assert_allclose(upright[:, 1, 3] - leaning[:, 1, 3], expected, atol=1e-12)


def test_date_is_converted_to_a_share():
    first, last = load_cultivar("kaite"), load_cultivar("kaite_september")
    date = first.date + (last.date - first.date) / 4
    share = (date - first.date).days / (last.date - first.date).days
    dated = with_changes(UNTIL, f"growth.date={date.isoformat()}")
    shared = with_changes(UNTIL, f"growth.share={share!r}")
    cultivar = load_recipe_cultivar(dated)
    assert cultivar == load_recipe_cultivar(shared)
    middle = interpolate_cultivars(first, last, share)
    assert (cultivar.stem, cultivar.organs) == (middle.stem, middle.organs)
    assert dated.growth.date == date
    assert dated.identity()["recipe"]["growth"]["date"] == date.isoformat()
    assert dated.sha256() != shared.sha256()


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ([UNTIL], "either share or date"),
        (["growth.share=0.5"], "growth.until: is required"),
        ([UNTIL, "growth.share=0.5", "growth.date=2016-06-01"], "either share or date"),
        ([UNTIL, "growth.date=2015-06-01"], "growth.date = '2015-06-01': must be between"),
        # Earlier than the first stage.
        (["growth.until=kaite_february", "growth.date=2016-03-01"], "must be between"),
        # Another crop has other organs.
        (["growth.until=tomato", "growth.share=0.5"], "growth.until = 'tomato'"),
    ],
)
def test_rejects_invalid_growth(changes, message):
    assert message in error_message(*changes)


def test_date_needs_dated_stages(tmp_path):
    file = tmp_path / "undated.toml"
    lines = (shipped_folder("plants") / "kaite.toml").read_text(encoding="utf-8").splitlines()
    file.write_text("\n".join(line for line in lines if not line.startswith("date")), encoding="utf-8")
    message = error_message(f"growth.until={file}", "growth.date=2016-06-01")
    assert "needs a date in the file of Kaite" in message


def test_identity_includes_both_stages_and_the_files_that_they_extend(tmp_path, write_recipe):
    for name in ("kaite", "kaite_september"):
        shutil.copy(shipped_folder("plants") / f"{name}.toml", tmp_path)
    last = tmp_path / "kaite_september.toml"
    recipe = load_recipe(write_recipe(growth={"until": "kaite_september.toml", "share": 0.5}))
    # Paths are relative to the recipe's folder, and are no part of the identity.
    assert recipe.growth.until == str(last)
    identity = recipe.identity()
    assert identity["recipe"]["growth"]["until"] == "kaite_september"
    assert str(tmp_path) not in str(identity)
    assert identity["files"] == with_changes(UNTIL, "growth.share=0.5").identity()["files"]
    names = {key: one["name"] for key, one in identity["files"].items() if key.startswith("growth.until")}
    assert names == {"growth.until": "kaite_september", "growth.until.1": "kaite"}
    # Values count, comments do not.
    text = last.read_text(encoding="utf-8")
    last.write_text("# a remark\n" + text, encoding="utf-8")
    assert recipe.identity() == identity
    last.write_text(text.replace("parts = 46", "parts = 45"), encoding="utf-8")
    changed = recipe.identity()["files"]
    assert {key for key in changed if changed[key] != identity["files"][key]} == {"growth.until"}
