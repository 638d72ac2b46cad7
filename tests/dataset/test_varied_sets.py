"""Manifest and check of data sets with drawn values, twins and a rig."""

from __future__ import annotations

import json
import shutil

import pyarrow
import pytest
from data_sets import set_without_plants
from disc_set import rewrite_manifest, sign
from pyarrow import parquet
from stand_in import StandIn
from varied_set import COLUMNS, FRAMES, RIG, TWINS, VARIED, make_varied_set

from pepperscene.atomic import canonical_json
from pepperscene.dataset.store.dataset import open_dataset
from pepperscene.dataset.store.journal import JOURNAL
from pepperscene.dataset.store.manifest import FRAME_COLUMNS, MANIFEST, drawn_columns
from pepperscene.recipe.plan import Plan
from pepperscene.recipe.resolve.frame_setups import frame_values
from pepperscene.recipe.resolve.load import load_recipe
from pepperscene.recipe.variation.notation import parse_varied
from pepperscene.recipe.variation.recorded import read_variation, recorded_draws
from pepperscene.review.check import check_dataset
from pepperscene.review.check.one_frame import FrameTraits
from pepperscene.review.check.run import exposure_notes, unlikely_draws
from pepperscene.review.report import write_report

TIMINGS = ("render_s", "write_s", "worker")


@pytest.fixture(scope="module")
def original(tmp_path_factory):
    """A correct data set with variation; to be read, not changed."""
    return make_varied_set(tmp_path_factory.mktemp("varied") / "set").folder


@pytest.fixture
def folder(original, tmp_path):
    return shutil.copytree(original, tmp_path / "set")


def rows(folder):
    return open_dataset(folder).manifest().to_pylist()


def problems(folder):
    """Kind, frame and description of each finding."""
    return {
        (finding.kind, finding.index, finding.problem)
        for finding in check_dataset(folder, workers=1).findings
    }


def test_manifest_has_the_values_of_each_frame(original):
    dataset = open_dataset(original)
    table, by_moment = dataset.manifest(), {}
    assert tuple(table.column_names) == (*FRAME_COLUMNS, *COLUMNS)
    assert table.num_rows == FRAMES
    for row in table.to_pylist():
        metadata = dataset.metadata(row["index"])
        assert {name: row[f"drawn.{name}"] for name in metadata["drawn"]} == metadata["drawn"]
        assert {name: row[name] for name in ("moment", "twin", "rig_camera")} == {
            name: metadata[name] for name in ("moment", "twin", "rig_camera")
        }
        assert row["exposure_us"] == pytest.approx(metadata["drawn"]["camera.exposure_us"])
        assert row["gain"] == metadata["camera"]["gain"]
        shared = {name: row[name] for name in COLUMNS if name.startswith("drawn.camera.")}
        assert by_moment.setdefault(row["moment"], shared) == shared
    assert len(by_moment) == 6
    types = {name: str(table.schema.field(name).type) for name in COLUMNS}
    assert types["drawn.camera.bits"] == "double"
    assert types["drawn.camera.filter"] == "string"
    assert types["drawn.developing.shot_noise"] == "bool"


def test_columns_do_not_depend_on_the_frames_that_exist(tmp_path, original):
    one = make_varied_set(tmp_path / "one", [3], ("class",)).manifest()
    whole = open_dataset(original).manifest()
    assert one.schema.equals(whole.schema)
    # Without light there is no exposure.
    assert one["exposure_us"].to_pylist() == [None]


def test_lost_drawn_columns_are_restored_from_the_frames(folder):
    before = rows(folder)
    (folder / MANIFEST).write_bytes(b"no table")
    assert rows(folder) == before
    (folder / MANIFEST).unlink()
    (folder / JOURNAL).unlink()
    assert rows(folder) == [{**row, **dict.fromkeys(TIMINGS)} for row in before]


@pytest.mark.parametrize(
    ("column", "value"),
    [("drawn.camera.exposure_us", 77.0), ("drawn.developing.shot_noise", None), ("twin", 0)],
)
def test_a_damaged_value_of_the_manifest_is_found_and_repaired(folder, column, value):
    before = open_dataset(folder).manifest()
    values = before[column].to_pylist()
    values[-1] = value
    field = before.schema.field(column)
    table = before.set_column(before.schema.get_field_index(column), field, pyarrow.array(values, field.type))
    parquet.write_table(table, folder / MANIFEST, write_page_checksum=True)
    assert problems(folder) == {("contradiction", FRAMES - 1, "disagrees with the JSON of this frame")}
    rewrite_manifest(folder)
    assert problems(folder) == set()


def test_a_tampered_drawn_value_is_found(folder):
    drawn = open_dataset(folder).metadata(5)["drawn"]
    sign(folder, 5, {"drawn": {**drawn, "camera.exposure_us": 100.0, "camera.bits": 8}})
    sign(folder, 6, {"drawn": {"camera.gain": 1.0}})
    found = problems(folder)
    assert {kind for kind, _, _ in found} == {"contradiction"}
    assert len([None for _, index, _ in found if index == 5]) == 2
    expected = f"camera.exposure_us = 100.0; by its index and seed it must be {drawn['camera.exposure_us']!r}"
    assert ("contradiction", 5, f"has the drawn value {expected}") in found
    # All of those that are missing, and the one that is too many.
    assert len([None for _, index, _ in found if index == 6]) == len(drawn) + 1


def test_a_wrong_moment_twin_or_camera_is_found(folder):
    sign(folder, 1, {"moment": 5, "twin": 1, "rig_camera": "left"})
    assert problems(folder) == {
        ("contradiction", 1, "has moment = 5; by the plan it must be 0"),
        ("contradiction", 1, "has twin = 1; by the plan it must be 0"),
        ("contradiction", 1, "has rig_camera = 'left'; by the plan it must be 'right'"),
    }


def test_twins_with_equal_labels_are_no_duplicates(tmp_path):
    # The discs depend on the pose alone, so only one scene.
    changes = {"plan.sets": 1}
    dataset = make_varied_set(tmp_path / "set", range(FRAMES // 2), ("class", "distance"), **changes)
    assert dataset.image(0, "class").tolist() == dataset.image(6, "class").tolist()
    assert check_dataset(dataset.folder, workers=1).findings == ()


def test_a_record_of_variation_that_is_not_valid_is_one_finding(folder):
    info = json.loads((folder / "dataset.json").read_text())
    info["recipe"]["variation"]["camera.bits"] = {"per": "day"}
    (folder / "dataset.json").write_text(json.dumps(info))
    found = [finding for finding in check_dataset(folder, workers=1).findings if finding.kind == "damaged"]
    assert "dataset.json" in {finding.file for finding in found}
    assert {finding.index for finding in found} == {None}


def test_the_record_of_a_recipe_draws_the_values_of_each_frame():
    further = {
        "cultivar": {"kaite": 0.5, "kaite_february": 0.5},
        "row.spacing_mm": {"mean": 200.0, "sd": 10.0, "draw": "density"},
        "row.gap_mm": {"low": 150.0, "high": 300.0, "draw": "density", "reversed": True},
        "row.plants_front": {"low": 5, "high": 9},
        "developing.demosaic": {"malvar": 0.5, "bilinear": 0.5},
    }
    tables = {"daylight": [{"illuminance_lx": 900.0, "cover": "none"}, {"illuminance_lx": 100.0}]}
    recipe = load_recipe("barth2018", {**VARIED, **further, "twins": {**TWINS, **tables}, "rig": RIG})
    recorded = json.loads(canonical_json(recipe.identity()))["recipe"]
    variation = read_variation(recorded)
    assert {varied.name: varied.identity() for varied in variation} == recorded["variation"]
    for index in (0, 1, 77, recipe.plan.count - 1):
        spec = recipe.plan.frame(index)
        assert recorded_draws(recorded, variation, spec) == frame_values(recipe, spec)[1]


def test_automatic_exposures_are_in_the_manifest_and_the_report(tmp_path):
    changes = {"camera.exposure_us": "auto"}
    folder = set_without_plants(tmp_path / "set", [0], ("colour",), AutoRenderer, changes).folder
    (row,) = rows(folder)
    assert (row["exposure_us"], row["gain"]) == (pytest.approx(1234.0), 2.5)
    assert "<dd>automatic</dd>" in write_report(folder).page.read_text(encoding="utf-8")


class AutoRenderer(StandIn):
    """Says what automatic exposure chose."""

    def render(self, *args, **kwargs):
        frame = super().render(*args, **kwargs)
        frame.metadata["auto_exposure"] = {"exposure_s": 1.234e-3, "gain": 2.5, "limited_by": None}
        return frame


def test_recipes_without_variation_have_no_further_columns():
    recipe = {"seed": 1, "camera": {"exposure_us": 50.0, "gain": 1.0}}
    assert drawn_columns({"recipe": recipe}) == {}
    assert list(drawn_columns({"recipe": {**recipe, "camera": {"exposure_us": "auto"}}})) == [
        "exposure_us", "gain",
    ]  # fmt: skip
    assert list(drawn_columns({"recipe": {**recipe, "rig": RIG}})) == ["moment", "rig_camera"]
    rig = [{"name": "dark", "camera": {"exposure_us": 10.0}}]
    assert list(drawn_columns({"recipe": {**recipe, "rig": rig}}))[2:] == ["exposure_us", "gain"]
    assert drawn_columns({"recipe": {**recipe, "twins": TWINS}}) == {
        "moment": "int64", "twin": "int32", "drawn.developing.white_balance": "string",
    }  # fmt: skip


def test_columns_of_a_damaged_record_raise_no_error():
    for info in ({}, {"recipe": None}, {"recipe": {"variation": [1], "twins": 2, "rig": 3}}):
        assert set(drawn_columns(info)) <= {"moment", "rig_camera"}


def drawn_notes(changed=None, plan=None):
    """Notes on the draws of a plan, whose record says something else about one value."""
    plan = plan or Plan(sets=1, rotations=1, frames=60, twins=2)
    values = [
        parse_varied(tuple(key.split(".")), table, kind_of(key), "frame") for key, table in VARIED.items()
    ]
    recipe = {"seed": 3, "plan": plan.model_dump()}
    recipe["variation"] = {varied.name: varied.identity() for varied in values}
    variation = read_variation(json.loads(json.dumps(recipe)))
    frames = [
        FrameTraits(index, drawn=recorded_draws(recipe, variation, plan.frame(index)))
        for index in range(plan.count)
    ]
    recipe["variation"] |= changed or {}
    return list(unlikely_draws(frames, json.loads(json.dumps(recipe))))


def kind_of(key):
    return None if key in ("camera.filter", "developing.shot_noise") else "number"


def test_draws_of_another_distribution_are_one_note():
    assert drawn_notes() == []
    other = parse_varied(("camera", "exposure_us"), {"low": 20.0, "high": 2000.0}, "number", "frame")
    (note,) = drawn_notes({"camera.exposure_us": other.identity()})
    assert note.startswith(
        "the 60 draws of camera.exposure_us do not fit the recipe's distribution, 20 to 2000"
    )


def test_few_draws_are_not_judged():
    other = parse_varied(("camera", "focus_mm"), {"low": 1.0, "high": 2.0}, "number", "scene").identity()
    # Sixty frames, but one scene.
    assert drawn_notes({"camera.focus_mm": other}) == []
    many = Plan(sets=60, rotations=1, frames=1)
    assert len(drawn_notes({"camera.focus_mm": other}, many)) == 1


def notes_on(*frames, exposure_us=50.0, **info):
    """Notes on frames given by mean grey value, saturated fraction, and what automatic exposure did."""
    traits = [
        FrameTraits(0, mean=mean, saturated=saturated, automatic=auto) for mean, saturated, auto in frames
    ]
    return list(exposure_notes(traits, {"recipe": {"camera": {"exposure_us": exposure_us}}, **info}))


def test_dark_and_overexposed_sets_are_one_note_with_advice():
    assert notes_on((100.0, 0.0, {}), (20.0, 0.0, {}), (None, 0.0, {})) == []
    (note,) = notes_on((30.0, 0.0, {}), (40.0, 0.0, {}))
    assert note.startswith("the photographs are dark: their mean grey value is 35 of 255")
    assert note.endswith('set a longer camera.exposure_us, or exposure_us = "auto"')
    for frame in ((200.0, 0.0, {}), (120.0, 0.06, {})):
        (note,) = notes_on(frame)
        assert note.endswith('set a shorter camera.exposure_us, or exposure_us = "auto"')
    # The recipe's own expectations judge.
    assert notes_on((30.0, 0.0, {}), expect={"intensity": [20, 50]}) == []


def test_limits_of_automatic_exposure_are_one_note():
    limits = [None, "longest exposure and gain", "saturation", "longest exposure and gain"]
    frames = [(100.0, 0.0, {"exposure_s": 1e-3, "limited_by": limit}) for limit in limits]
    (note,) = notes_on(*frames, exposure_us="auto")
    assert note.startswith(
        "3 of 4 automatic exposures reached a limit (2 longest exposure and gain, 1 saturation)"
    )
    (note,) = notes_on((20.0, 0.0, {"limited_by": None}), exposure_us="auto")
    assert "auto_exposure.target_grey" in note
