"""Files of a fit load like any other recipe, and have the fitted values."""

from __future__ import annotations

import datetime
import json
import os
import re
import tomllib
from dataclasses import replace

import numpy as np
import pytest
from example_fit import VALUES, example_fit, example_patches

from pepperscene.building.scenes.frame_renderer import FrameRenderer
from pepperscene.camera import colour_transform
from pepperscene.cultivar import PigmentPath, Pigments, load_cultivar
from pepperscene.errors import InputError, OutputError
from pepperscene.recipe.resolve.load import load_recipe
from pepperscene.recipe.resolve.load_camera import load_camera
from pepperscene.recipe.resolve.resolved import load_recipe_cultivar
from pepperscene.tuning import write as write_module
from pepperscene.tuning.part_files import simplify_path
from pepperscene.tuning.report import RunInfo, format_value, format_with_sd, toml_text
from pepperscene.tuning.write import write_tuned

WHEN = datetime.date(2026, 1, 2)
STATES = np.linspace(0.0, 1.0, 401)


def write(recipe, fit, out, options=None, **further):
    return write_tuned(recipe, fit, out, RunInfo.of(example_patches(), WHEN, options), **further)


def check_pigments(pigments, expected):
    """Contents agree to a millionth of their range at every state, the rest to rounding."""
    for name, path in expected.items():
        states = np.linspace(-1.0, 1.0, 801)  # below 0 is tissue that ages
        contents, written = path.at(states), pigments[name].at(states)
        for field, content in contents.items():
            extent = max(np.ptp(content), 1e-9 * np.abs(content).max())
            assert np.abs(written[field] - content).max() <= 1.001e-6 * extent + 1e-15, (name, field)
        flesh = [one.flesh_reflectance for one in (pigments[name], path)]
        assert flesh == [None, None] or flesh[0] == pytest.approx(flesh[1], rel=1e-10)
        assert pigments[name].ior == pytest.approx(path.ior, rel=1e-10)
        assert pigments[name].roughness == pytest.approx(path.roughness, rel=1e-10)
        assert pigments[name].wide_roughness == path.wide_roughness
        assert pigments[name].wide_share == path.wide_share
        assert [fraction for fraction, _ in pigments[name].ageing] == [one for one, _ in path.ageing]


def check_camera(camera, before, parts):
    """Exposure, gains, matrix and light are those of the fit."""
    time, gain = (parts.exposure, 1.0) if before.flash is None else (1.0, parts.exposure)
    assert camera.exposure_s == pytest.approx(before.exposure_s * time, rel=1e-10)
    assert camera.sensor.gain == pytest.approx(before.sensor.gain * gain, rel=1e-10)
    if before.sensor.channels > 1:
        gains, matrix = colour_transform(camera)
        np.testing.assert_allclose(gains, parts.gains, rtol=1e-9)
        np.testing.assert_allclose(matrix, parts.matrix, atol=1e-9)
    if before.flash is not None:
        # On the renderer's grid: every whole nanometre, with factors linear between nodes that are not on it.
        nm = np.arange(370.0, 800.0)
        factors = np.interp(nm, parts.flash_nodes_nm, parts.flash_factors)
        expected = parts.flash_power * factors * before.flash.radiant_intensity(nm)
        written = camera.flash.radiant_intensity(nm)
        np.testing.assert_allclose(written, expected, rtol=1e-6, atol=1e-12 * expected.max())


def check_recipe(path, before, fit):
    """The recipe in a file has the fitted values."""
    recipe = load_recipe(path)
    check_pigments(load_recipe_cultivar(recipe).pigments, fit.tuned_parts.pigments)
    check_camera(load_camera(recipe), load_camera(before), fit.tuned_parts)


@pytest.fixture(autouse=True)
def small_picture(monkeypatch):
    """The figure has its own tests (test_figure.py), and takes half of the time of writing."""
    monkeypatch.setattr(write_module, "before_after_png", lambda *_: b"PNG")


@pytest.fixture(scope="module")
def demo():
    return load_recipe("demo")


@pytest.fixture(scope="module")
def fit(demo):
    return example_fit(demo)


def test_written_recipe_has_the_fitted_values_and_inherits_the_rest(demo, fit, tmp_path):
    files = write(demo, fit, tmp_path / "out", extends="demo")
    check_recipe(files[0], demo, fit)
    check_pigments(FrameRenderer(load_recipe(files[0])).cultivar.pigments, fit.tuned_parts.pigments)
    assert {path.name for path in files} == {path.name for path in (tmp_path / "out").iterdir()}
    recipe, cultivar = (tomllib.loads(path.read_text()) for path in files[:2])
    assert recipe.keys() == {"extends", "name", "cultivar", "camera", "developing"}
    assert recipe["name"] == "demo_tuned"
    assert recipe["camera"].keys() == {"flash", "gain"}
    assert recipe["developing"].keys() == {"white_balance", "colour_matrix"}
    assert cultivar["extends"] == "kaite"
    assert cultivar["pigments"].keys() == {"leaf", "fruit"}
    tuned, original = load_cultivar(files[1]), load_cultivar("kaite")
    for name in ("organs", "stem", "date"):
        assert getattr(tuned, name) == getattr(original, name)
    for name in original.pigments.keys() - {"leaf", "fruit"}:
        assert tuned.pigments[name] == original.pigments[name]


def test_unchanged_values_write_no_changes(demo, tmp_path):
    defaults = {one.name: one.default for one in example_fit(demo).parameters}
    files = write(demo, example_fit(demo, defaults), tmp_path / "out", extends="demo")
    assert tomllib.loads(files[0].read_text()) == {"extends": "demo", "name": "demo_tuned"}
    assert [path.name for path in files[1:]] == ["before_after.png", "tuning.json"]


# Pigments alone are those of the test of growth stages.
@pytest.mark.parametrize("name", sorted(VALUES.keys() - {"leaf.chlorophyll", "fruit.ripeness"}))
def test_each_parameter_alone_is_written(demo, name, tmp_path):
    fit = example_fit(demo, {name: VALUES[name]})
    path = write(demo, fit, tmp_path / "out", extends="demo")[0]
    check_recipe(path, demo, fit)
    if name == "flash.colour":
        # The recipe balances to its flash; another flash must not change that.
        gains = [colour_transform(load_camera(recipe))[0] for recipe in (load_recipe(path), demo)]
        np.testing.assert_allclose(*gains, rtol=1e-9)


def test_infrared_flash_has_its_strength_in_watts(tmp_path):
    changes = {"camera.sensor": "onsemi_mt9v024_mono", "camera.flash": "led_nir_850nm"}
    recipe = load_recipe("demo", changes | {"developing.white_balance": "none"})
    fit = example_fit(recipe, {"flash.power": [1.3], "flash.spectrum": np.linspace(0.5, 1.5, 8)})
    flash = load_camera(load_recipe(write(recipe, fit, tmp_path / "out")[0])).flash
    nm = np.arange(780.0, 920.0)
    factors = np.interp(nm, fit.tuned_parts.flash_nodes_nm, fit.tuned_parts.flash_factors)
    expected = 1.3 * factors * load_camera(recipe).flash.radiant_intensity(nm)
    np.testing.assert_allclose(flash.radiant_intensity(nm), expected, rtol=1e-6)
    assert flash.irradiance_W_m2 is not None


def test_both_growth_stages_are_tuned(tmp_path):
    changes = {"cultivar": "kaite_february", "growth.until": "kaite_september", "growth.share": 0.3}
    recipe = load_recipe("demo", changes)
    fit = example_fit(recipe, {"leaf.chlorophyll": [41.0]})
    files = write(recipe, fit, tmp_path / "out", extends="demo")
    assert {"kaite_february_tuned.toml", "kaite_september_tuned.toml"} <= {path.name for path in files}
    cultivar = load_recipe_cultivar(load_recipe(files[0]))
    check_pigments(cultivar.pigments, fit.tuned_parts.pigments)
    assert cultivar.date == load_recipe_cultivar(recipe).date


def test_recipe_without_a_flash_has_no_flash_file(tmp_path):
    recipe = load_recipe("greenhouse")
    fit = example_fit(recipe, {"exposure": [1.4], "white_balance": [0.9, 1.2]})
    files = write(recipe, fit, tmp_path / "out", extends="greenhouse")
    assert [path.name for path in files] == ["greenhouse_tuned.toml", "before_after.png", "tuning.json"]
    check_recipe(files[0], recipe, fit)


def test_files_of_the_user_are_found_by_relative_paths(tmp_path, monkeypatch):
    mine = tmp_path / "both" / "mine"
    mine.mkdir(parents=True)
    (mine / "plant.toml").write_text('extends = "red_blocky"\nname = "Mine"\nsource = "own"\n')
    (mine / "crop.toml").write_text('extends = "demo"\nname = "crop"\ncultivar = "plant.toml"\n')
    monkeypatch.chdir(mine)
    recipe = load_recipe("crop.toml", {"camera.exposure_us": 40})
    fit = example_fit(recipe)
    files = write(recipe, fit, "../results/first", extends="crop.toml")
    stated = tomllib.loads(files[0].read_text())
    assert stated["extends"] == "../../mine/crop.toml"
    assert stated["camera"]["exposure_us"] == 40
    # From another working directory, and after both have moved together.
    monkeypatch.chdir("/")
    (tmp_path / "both").rename(tmp_path / "moved")
    moved = load_recipe_cultivar(load_recipe(tmp_path / "moved" / "results" / "first" / "crop_tuned.toml"))
    check_pigments(moved.pigments, fit.tuned_parts.pigments)
    assert moved.organs == load_cultivar("red_blocky").organs


def test_files_of_the_user_are_found_behind_a_symbolic_link(tmp_path):
    (tmp_path / "real" / "deep" / "er").mkdir(parents=True)
    (tmp_path / "link").symlink_to(tmp_path / "real" / "deep" / "er")
    (tmp_path / "crop.toml").write_text('extends = "demo"\n')
    recipe = load_recipe(tmp_path / "crop.toml")
    files = write(recipe, example_fit(recipe), tmp_path / "link" / "out", extends=tmp_path / "crop.toml")
    assert load_recipe_cultivar(load_recipe(files[0])).name == "Kaite, tuned"


def test_recipe_without_a_file_is_written_completely(demo, fit, tmp_path):
    files = write(demo, fit, tmp_path / "out")
    assert "extends" not in tomllib.loads(files[0].read_text())
    recipe, base = load_recipe(files[0]), load_recipe(write(demo, fit, tmp_path / "two", extends="demo")[0])
    for name in ("seed", "plan", "row", "views", "daylight", "twine", "growth", "greenhouse", "developing"):
        assert getattr(recipe, name) == getattr(base, name), name
    # So is one that lacks a table of its file.
    night = demo.model_copy(update={"daylight": None})
    assert load_recipe(write(night, fit, tmp_path / "night", extends="demo")[0]).daylight is None


def test_names_of_files_differ_and_need_not_be_that_of_the_recipe(demo, fit, tmp_path):
    files = write(demo.model_copy(update={"name": "kaite"}), fit, tmp_path / "out", extends="demo")
    assert len({path.name.lower() for path in files}) == len(files) == 7
    assert load_recipe_cultivar(load_recipe(files[0])).name == "Kaite, tuned"
    recipe = demo.model_copy(update={"name": 'a/b: "c" \\'})
    first = write(recipe, example_fit(demo, {"exposure": [1.2]}), tmp_path / "other", extends="demo")[0]
    assert first.parent == tmp_path / "other"
    assert load_recipe(first).name == 'a/b: "c" \\_tuned'


def test_tuned_recipe_can_be_tuned_again(demo, fit, tmp_path):
    first = write(demo, fit, tmp_path / "one", extends="demo")[0]
    recipe = load_recipe(first)
    again = example_fit(recipe, {"leaf.chlorophyll": [30.0], "flash.power": [0.9]})
    second = write(recipe, again, tmp_path / "two", extends=first)[0]
    check_recipe(second, recipe, again)
    fruit = load_recipe_cultivar(recipe).pigments["fruit"]
    check_pigments(load_recipe_cultivar(load_recipe(second)).pigments, {"fruit": fruit})


def test_every_file_states_its_provenance_and_the_record_is_plain_json(demo, fit, tmp_path):
    verification = {"frames": 2, "worst": float("nan")}
    out = tmp_path / "out"
    files = write(demo, fit, out, extends="demo", options={"seed": 3}, verification=verification)

    def refuse(text):
        raise AssertionError(f"{text} is not valid JSON")

    record = json.loads((out / "tuning.json").read_text(), parse_constant=refuse)
    for text in (path.read_text() for path in files if path.suffix == ".toml"):
        assert all(part in text for part in ("2026-01-02", record["version"], record["patches"]["sha256"]))
    leaf = tomllib.loads(files[1].read_text())["pigments"]["leaf"]["source"]
    assert all(part in leaf for part in ("leaf.chlorophyll 48.12 ± 0.96", "(was 56.00)", "LOPEX"))
    assert "fruit.ripeness" not in leaf
    assert record["options"] == {"seed": 3}
    assert record["verification"] == {"frames": 2, "worst": None}
    assert [one["name"] for one in record["parameters"]] == list(VALUES)
    assert len(record["entries"]) == len(record["correlation"]) == 15
    for one in record["parameters"]:
        assert one["value"] == list(VALUES[one["name"]])
        assert len(one["sd"]) == len(one["gained"]) == len(one["bounds"]) == len(one["labels"])
        assert one["bounds"][0].keys() == {"mean", "sd", "low", "high", "source", "chosen"}
    assert record["kinds"].keys() == {"leaf", "pepper.ripe", "peduncle"}
    assert record["spectra"].keys() == {"green pepper"}
    assert [one["cost"] for one in record["starts"]] == [812.5, None]
    assert record["leftover"] == {"camera": 0.4, "light": None}
    assert record["verdict"] == list(fit.diagnostics)
    assert record["tuned"]["gains"] == pytest.approx(list(fit.tuned_parts.gains))


def test_digests_identify_patches():
    runs = [RunInfo.of(example_patches(), WHEN) for _ in range(2)]
    assert runs[0] == runs[1]
    patches = example_patches()
    patches.patches[0].linear[0, 0] += 1e-3
    other = RunInfo.of(patches, WHEN)
    assert other.sha256 != runs[0].sha256
    assert [n for n, digest in other.members.items() if digest != runs[0].members[n]] == ["leaf 1"]


def test_same_fit_gives_the_same_bytes(demo, fit, tmp_path, monkeypatch):
    monkeypatch.undo()  # the figure as well
    pairs = zip(write(demo, fit, tmp_path / "one"), write(demo, fit, tmp_path / "two"), strict=True)
    assert all(a.read_bytes() == b.read_bytes() for a, b in pairs)


def test_errors_leave_no_files(demo, fit, tmp_path):
    loud = demo.model_copy(update={"camera": replace(demo.camera, gain=900.0)})
    with pytest.raises(InputError, match=r"camera\.gain"):
        write(loud, example_fit(demo, {"exposure": [50.0]}), tmp_path / "out")
    assert not list(tmp_path.iterdir())
    (tmp_path / "mine.txt").write_text("keep")
    with pytest.raises(OutputError, match=r"mine\.txt"):
        write(demo, fit, tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["mine.txt"]


@pytest.mark.parametrize("failing", [0, 6])
def test_full_disk_leaves_no_files(demo, fit, tmp_path, monkeypatch, failing):
    flush, calls = os.fsync, []

    def full(file):
        calls.append(file)
        if len(calls) == failing + 1:
            raise OSError(28, "No space left on device")
        flush(file)

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(OutputError, match="No space left"):
        write(demo, fit, tmp_path / "deep" / "out")
    assert not list(tmp_path.iterdir())


def path_of(states, chlorophyll):
    fixed = {"structure_n": 1.5, "carotenoid_ug_cm2": 2.0, "water_cm": 0.01, "dry_matter_g_cm2": 0.004}
    start, *between, end = (Pigments(chlorophyll_ug_cm2=c, **fixed) for c in chlorophyll)
    knots = tuple(zip(states[1:-1], between, strict=True))
    return PigmentPath(source="test", start=start, end=end, path=knots, ior=1.3, roughness=(0.3, 0.4))


def test_simplified_path_keeps_corners_and_ageing_only():
    states = [float(s) for s in np.linspace(0.0, 1.0, 21)]
    simple = simplify_path(path_of(states, np.interp(states, [0, 0.25, 0.6, 1], [5, 40, 41, 3])))
    assert [state for state, _ in simple.path] == pytest.approx([0.25, 0.6])
    assert not simplify_path(path_of(states, np.full(21, 7.0))).path
    leaf = load_cultivar("kaite").pigments["leaf"]
    assert leaf.ageing
    assert simplify_path(leaf).knots == leaf.knots


def test_simplified_path_is_within_the_tolerance():
    rng = np.random.default_rng(11)
    states = np.sort(np.concatenate([[0.0, 1.0], rng.uniform(0.01, 0.99, 22)])).tolist()
    rough = path_of(states, np.maximum(90.0 + np.cumsum(rng.normal(0.0, 2.0, 24)), 0.0))
    smooth = path_of(states, 10.0 + 1e-7 * rng.random(24) + 20.0 * np.array(states))
    for path in (rough, smooth):
        before, after = (p.at(STATES)["chlorophyll_ug_cm2"] for p in (path, simplify_path(path)))
        assert np.abs(before - after).max() <= 1.001e-6 * np.ptp(before)
    assert len(simplify_path(rough).path) == 22
    assert not simplify_path(smooth).path


@pytest.mark.parametrize("depth", [0, 1, 2, 5])
def test_toml_text_loads_with_the_same_values(depth):
    tables = {
        "name": 'a "b" \\ \n\t\x7f µ', "integer": 3, "small": 1.25e-7, "round": 2.0, "yes": True, "day": WHEN,
        "rows": [[1.0, 2.5], [3.0, 4.0]], "empty": [], "array": [1.0, {"x": 2.5}],
        "one": {"two": {"three": {"x": 0.1}, "y": 1}, "a key": "v"}, "none": {},
    }  # fmt: skip
    comments = {"name": "a\ncomment", "rows": "more", "one.a key": "x"}
    text = toml_text(tables, "head\nand more", comments, depth)
    assert tomllib.loads(text) == tables
    assert text.startswith("# head\n# and more\n\n")
    assert 'µ"  # a comment\n' in text
    assert len(re.findall(r"^\[", text, re.MULTILINE)) == (0, 2, 3, 4)[min(depth, 3)]


def test_texts_of_numbers():
    text = toml_text({"x": 0.1 + 0.2, "y": np.array([1.0 / 3.0, 2.0])})
    assert text == "x = 0.3\ny = [0.333333333333, 2]\n"
    assert format_with_sd(48.1234, 0.957) == "48.12 ± 0.96"
    assert format_with_sd(1234.5, 120.0) == "1230 ± 120"
    assert format_with_sd(0.0, 0.004) == "0.0000 ± 0.0040"
    assert format_value(3.14159, 0.0) == format_value(3.14159, float("inf")) == "3.142"
