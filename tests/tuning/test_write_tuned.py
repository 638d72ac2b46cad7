"""What a fit writes loads like any other recipe, and shows what was fitted."""

from __future__ import annotations

import datetime
import json
import shutil
import tomllib

import numpy as np
import pytest
from example_fit import VALUES, a_fit, some_patches
from PIL import Image

from pepperscene.camera import colour_transform
from pepperscene.cultivar import PigmentPath, Pigments, load_cultivar
from pepperscene.dataset import FrameRenderer, load_recipe
from pepperscene.dataset.recipe.equipment import load_camera, load_recipe_cultivar
from pepperscene.errors import InputError, OutputError
from pepperscene.tuning.output import write as written
from pepperscene.tuning.output.cultivar import simplify_path
from pepperscene.tuning.output.provenance import plain, format_with_sd
from pepperscene.tuning.output.toml_text import document, inline
from pepperscene.tuning.output.write import write_tuned

WHEN = datetime.date(2026, 1, 2)
STATES = np.linspace(0.0, 1.0, 401)


def write(recipe, fit, out, **more):
    return write_tuned(recipe, fit, out, patches=some_patches(), when=WHEN, **more)


def check_pigments(found, wanted):
    """Contents to a millionth of their range at every state, the rest to rounding."""
    for name, path in wanted.items():
        contents, others = path.at(STATES), found[name].at(STATES)
        for what, content in contents.items():
            reach = max(np.ptp(content), 1e-9 * np.abs(content).max())
            assert np.abs(others[what] - content).max() <= 1.001e-6 * reach + 1e-15, (name, what)
        flesh = [one.flesh_reflectance for one in (found[name], path)]
        assert flesh == [None, None] or flesh[0] == pytest.approx(flesh[1], rel=1e-10)
        assert found[name].ior == pytest.approx(path.ior, rel=1e-10)
        assert found[name].roughness == pytest.approx(path.roughness, rel=1e-10)


def light(flash, nm):
    """W sr-1 nm-1 on the axis, as the renderer asks for it."""
    return flash.radiant_intensity(nm)


def check_camera(found, before, tuned):
    """Exposure, gains, matrix and light are those of the fit."""
    in_time, in_gain = (tuned.exposure, 1.0) if before.flash is None else (1.0, tuned.exposure)
    assert found.exposure_s == pytest.approx(before.exposure_s * in_time, rel=1e-10)
    assert found.sensor.gain == pytest.approx(before.sensor.gain * in_gain, rel=1e-10)
    if before.sensor.channels > 1:
        gains, matrix = colour_transform(found)
        np.testing.assert_allclose(gains, tuned.gains, rtol=1e-9)
        np.testing.assert_allclose(matrix, tuned.matrix, atol=1e-9)
    if before.flash is not None:
        # The renderer's grid: every whole nanometre, with factors linear between nodes that are not on it.
        nm = np.arange(370.0, 800.0)
        factors = np.interp(nm, tuned.flash_nodes_nm, tuned.flash_spectrum)
        wanted = tuned.flash_power * factors * light(before.flash, nm)
        np.testing.assert_allclose(light(found.flash, nm), wanted, rtol=1e-6, atol=1e-12 * wanted.max())


@pytest.fixture(autouse=True)
def small_picture(monkeypatch):
    """The sheet has tests of its own (test_before_after.py), and takes half of the time of writing."""
    monkeypatch.setattr(written, "sheet", lambda *_: Image.new("RGB", (4, 4)))


@pytest.fixture
def demo():
    return load_recipe("demo")


@pytest.fixture
def fit(demo):
    return a_fit(demo)


# --- what is written is what was fitted -------------------------------------------------------------------


def test_written_recipe_shows_what_was_fitted(demo, fit, tmp_path):
    files = write(demo, fit, tmp_path / "out", extends="demo")
    recipe = load_recipe(files[0])
    check_pigments(FrameRenderer(recipe).cultivar.pigments, fit.tuned.pigments)
    check_camera(load_camera(recipe), load_camera(demo), fit.tuned)
    assert recipe.name == "demo_tuned"
    assert {path.name for path in files} == {path.name for path in (tmp_path / "out").iterdir()}


def test_only_what_changed_is_stated(demo, fit, tmp_path):
    recipe, cultivar = (
        tomllib.loads(p.read_text()) for p in write(demo, fit, tmp_path / "o", extends="demo")[:2]
    )
    assert recipe.keys() == {"extends", "name", "cultivar", "camera", "developing"}
    assert recipe["camera"].keys() == {"flash", "gain"}
    assert recipe["developing"].keys() == {"white_balance", "colour_matrix"}
    assert cultivar["extends"] == "kaite"
    assert cultivar["pigments"].keys() == {"leaf", "fruit"}


def test_all_else_is_inherited(demo, fit, tmp_path):
    found = load_cultivar(write(demo, fit, tmp_path / "out", extends="demo")[1])
    old = load_cultivar("kaite")
    assert found.organs == old.organs
    assert found.stem == old.stem
    assert found.date == old.date
    untouched = old.pigments.keys() - {"leaf", "fruit"}
    assert {n: found.pigments[n] for n in untouched} == {n: old.pigments[n] for n in untouched}


def test_nothing_fitted_changes_nothing(demo, tmp_path):
    defaults = {one.name: one.default for one in a_fit(demo).parameters}
    files = write(demo, a_fit(demo, defaults), tmp_path / "out", extends="demo")
    stated = tomllib.loads(files[0].read_text())
    assert stated == {"extends": "demo", "name": "demo_tuned"}
    assert [path.name for path in files[1:]] == ["before_after.png", "tuning.json"]


@pytest.mark.parametrize("name", list(VALUES))
def test_each_parameter_alone_comes_back(demo, name, tmp_path):
    fit = a_fit(demo, {name: VALUES[name]})
    recipe = load_recipe(write(demo, fit, tmp_path / "out", extends="demo")[0])
    check_pigments(load_recipe_cultivar(recipe).pigments, fit.tuned.pigments)
    check_camera(load_camera(recipe), load_camera(demo), fit.tuned)


def test_light_keeps_the_balance_that_it_was_fitted_with(demo, tmp_path):
    """The recipe balances to its flash; another flash must not move the balance that the fit had."""
    fit = a_fit(demo, {"flash.colour": [0.4, 0.0]})
    found = load_camera(load_recipe(write(demo, fit, tmp_path / "out", extends="demo")[0]))
    np.testing.assert_allclose(colour_transform(found)[0], colour_transform(load_camera(demo))[0], rtol=1e-9)


def test_infrared_flash_keeps_its_watts(tmp_path):
    recipe = load_recipe(
        "demo",
        {
            "camera.sensor": "onsemi_mt9v024_mono",
            "camera.flash": "led_nir_850nm",
            "developing.white_balance": "none",
        },
    )
    fit = a_fit(recipe, {"flash.power": [1.3], "flash.spectrum": np.linspace(0.5, 1.5, 8)})
    found = load_camera(load_recipe(write(recipe, fit, tmp_path / "out")[0]))
    nm = np.arange(780.0, 920.0)
    factors = np.interp(nm, fit.tuned.flash_nodes_nm, fit.tuned.flash_spectrum)
    wanted = 1.3 * factors * light(load_camera(recipe).flash, nm)
    np.testing.assert_allclose(light(found.flash, nm), wanted, rtol=1e-6)
    assert found.flash.irradiance_W_m2 is not None


def test_growth_stage_is_tuned_at_both_ends(tmp_path):
    changes = {"cultivar": "kaite_february", "growth.until": "kaite_september", "growth.share": 0.3}
    recipe = load_recipe("demo", changes)
    fit = a_fit(recipe, {"leaf.chlorophyll": [41.0]})
    files = write(recipe, fit, tmp_path / "out", extends="demo")
    assert {"kaite_february_tuned.toml", "kaite_september_tuned.toml"} <= {path.name for path in files}
    found = load_recipe_cultivar(load_recipe(files[0]))
    check_pigments(found.pigments, fit.tuned.pigments)
    assert found.date == load_recipe_cultivar(recipe).date


def test_no_flash_no_flash_file(tmp_path):
    recipe = load_recipe("greenhouse")
    fit = a_fit(recipe, {"exposure": [1.4], "white_balance": [0.9, 1.2]})
    files = write(recipe, fit, tmp_path / "out", extends="greenhouse")
    assert [path.name for path in files] == ["greenhouse_tuned.toml", "before_after.png", "tuning.json"]
    check_camera(load_camera(load_recipe(files[0])), load_camera(recipe), fit.tuned)


# --- where files lie --------------------------------------------------------------------------------------


def test_folder_can_be_moved(demo, fit, tmp_path):
    write(demo, fit, tmp_path / "out", extends="demo")
    (tmp_path / "far").mkdir()
    shutil.move(tmp_path / "out", tmp_path / "far" / "away")
    recipe = load_recipe(tmp_path / "far" / "away" / "demo_tuned.toml")
    check_pigments(load_recipe_cultivar(recipe).pigments, fit.tuned.pigments)
    check_camera(load_camera(recipe), load_camera(demo), fit.tuned)


def test_own_files_are_found_by_the_way_to_them(tmp_path, monkeypatch):
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "plant.toml").write_text('extends = "red_blocky"\nname = "Mine"\nsource = "own"\n')
    (tmp_path / "mine" / "house.toml").write_text(
        'extends = "demo"\nname = "house"\ncultivar = "plant.toml"\n'
    )
    monkeypatch.chdir(tmp_path / "mine")
    recipe = load_recipe("house.toml", {"camera.exposure_us": 40})
    fit = a_fit(recipe)
    files = write(recipe, fit, "../results/first", extends="house.toml")
    stated = tomllib.loads(files[0].read_text())
    assert stated["extends"] == "../../mine/house.toml"
    assert stated["camera"]["exposure_us"] == 40
    # From elsewhere, and after both have moved together.
    monkeypatch.chdir("/")
    shutil.copytree(tmp_path, tmp_path.parent / f"{tmp_path.name}_copy")
    shutil.rmtree(tmp_path / "mine")
    moved = load_recipe(tmp_path.parent / f"{tmp_path.name}_copy" / "results" / "first" / "house_tuned.toml")
    check_pigments(load_recipe_cultivar(moved).pigments, fit.tuned.pigments)
    assert (
        load_recipe_cultivar(moved).organs
        == load_recipe_cultivar(load_recipe("demo", {"cultivar": "red_blocky"})).organs
    )


def test_behind_a_link_own_files_are_found(tmp_path):
    (tmp_path / "real" / "deep" / "er").mkdir(parents=True)
    (tmp_path / "link").symlink_to(tmp_path / "real" / "deep" / "er")
    (tmp_path / "plant.toml").write_text('extends = "kaite"\nname = "Mine"\n')
    (tmp_path / "house.toml").write_text('extends = "demo"\ncultivar = "plant.toml"\n')
    recipe = load_recipe(tmp_path / "house.toml")
    files = write(recipe, a_fit(recipe), tmp_path / "link" / "out", extends=tmp_path / "house.toml")
    assert load_recipe_cultivar(load_recipe(files[0])).name == "Mine, tuned"


def test_recipe_without_a_file_is_written_whole(demo, fit, tmp_path):
    files = write(demo, fit, tmp_path / "out")
    assert "extends" not in tomllib.loads(files[0].read_text())
    found, base = load_recipe(files[0]), load_recipe(write(demo, fit, tmp_path / "two", extends="demo")[0])
    for name in ("seed", "plan", "row", "path", "daylight", "twine", "growth", "greenhouse", "developing"):
        assert getattr(found, name) == getattr(base, name), name


def test_what_cannot_be_taken_away_by_extending_is_written_whole(demo, fit, tmp_path):
    night = demo.model_copy(update={"daylight": None})
    assert load_recipe(write(night, fit, tmp_path / "out", extends="demo")[0]).daylight is None


def test_equal_names_do_not_meet(demo, fit, tmp_path):
    recipe = demo.model_copy(update={"name": "kaite"})
    files = write(recipe, fit, tmp_path / "out", extends="demo")
    assert len({path.name.lower() for path in files}) == len(files) == 7
    assert load_recipe_cultivar(load_recipe(files[0])).name == "Kaite, tuned"


def test_name_that_is_no_file_name(demo, tmp_path):
    recipe = demo.model_copy(update={"name": 'a/b: "c" \\'})
    fit = a_fit(recipe, {"exposure": [1.2]})
    first = write(recipe, fit, tmp_path / "out", extends="demo")[0]
    assert first.parent == tmp_path / "out"
    assert load_recipe(first).name == 'a/b: "c" \\_tuned'


def test_tuned_recipe_can_be_tuned_again(demo, fit, tmp_path):
    first = write(demo, fit, tmp_path / "one", extends="demo")[0]
    recipe = load_recipe(first)
    again = a_fit(recipe, {"leaf.chlorophyll": [30.0], "flash.power": [0.9]})
    found = load_recipe(write(recipe, again, tmp_path / "two", extends=first)[0])
    check_pigments(load_recipe_cultivar(found).pigments, again.tuned.pigments)
    check_pigments(
        load_recipe_cultivar(found).pigments, {"fruit": load_recipe_cultivar(recipe).pigments["fruit"]}
    )
    check_camera(load_camera(found), load_camera(recipe), again.tuned)


# --- provenance -------------------------------------------------------------------------------------------


def test_every_file_tells_where_its_numbers_come_from(demo, fit, tmp_path):
    files = write(demo, fit, tmp_path / "out", extends="demo")
    record = json.loads((tmp_path / "out" / "tuning.json").read_text())
    for path in files:
        if path.suffix == ".toml":
            text = path.read_text()
            assert "2026-01-02" in text
            assert record["version"] in text
            assert record["patches"]["sha256"] in text
    leaf = tomllib.loads(files[1].read_text())["pigments"]["leaf"]["source"]
    assert "leaf.chlorophyll 48.12 ± 0.96" in leaf
    assert "(was 62.00)" in leaf
    assert "LOPEX" in leaf
    assert "fruit.ripeness" not in leaf


def test_record_is_whole_and_plain_json(demo, fit, tmp_path):
    write(demo, fit, tmp_path / "out", options={"seed": 3}, verification={"frames": 2, "worst": float("nan")})

    def refuse(text):
        raise AssertionError(f"{text} is no JSON")

    told = json.loads((tmp_path / "out" / "tuning.json").read_text(), parse_constant=refuse)
    assert told["options"] == {"seed": 3}
    assert told["verification"] == {"frames": 2, "worst": None}
    assert [one["name"] for one in told["parameters"]] == list(VALUES)
    assert len(told["entries"]) == len(told["correlation"]) == 15
    for one in told["parameters"]:
        assert one["value"] == list(VALUES[one["name"]])
        assert len(one["sd"]) == len(one["gained"]) == len(one["bounds"]) == len(one["labels"])
    assert told["kinds"].keys() == {"leaf", "pepper.ripe", "peduncle"}
    assert told["spectra"].keys() == {"green pepper"}
    assert [one["cost"] for one in told["starts"]] == [812.5, None]
    assert told["leftover"] == {"camera": 0.4, "light": None}
    assert told["tuned"]["gains"] == pytest.approx(list(fit.tuned.gains))


def test_digests_tell_patches_apart():
    occasions = [written.RunInfo.of(some_patches(), WHEN) for _ in range(2)]
    assert occasions[0] == occasions[1]
    one = some_patches()
    one.patches[0].linear[0, 0] += 1e-3
    other = written.RunInfo.of(one, WHEN)
    assert other.sha256 != occasions[0].sha256
    assert [n for n, d in other.members.items() if d != occasions[0].members[n]] == ["leaf 1"]


def test_same_fit_same_bytes(demo, fit, tmp_path):
    pairs = zip(write(demo, fit, tmp_path / "one"), write(demo, fit, tmp_path / "two"), strict=True)
    assert all(a.read_bytes() == b.read_bytes() for a, b in pairs)


# --- all or nothing ---------------------------------------------------------------------------------------


def test_folder_with_something_in_it_is_refused(demo, fit, tmp_path):
    (tmp_path / "mine.txt").write_text("keep")
    with pytest.raises(OutputError, match=r"mine\.txt"):
        write(demo, fit, tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["mine.txt"]


@pytest.mark.parametrize("at", [0, 3, 6])
def test_failure_leaves_nothing(demo, fit, tmp_path, monkeypatch, at):
    """A disk that is full at any of the files."""
    real, calls = written.atomic_write, []

    def full(path):
        calls.append(path)
        if len(calls) == at + 1:
            raise OSError(28, "No space left on device", str(path))
        return real(path)

    monkeypatch.setattr(written, "replacing", full)
    with pytest.raises(OutputError, match="No space left"):
        write(demo, fit, tmp_path / "deep" / "out")
    assert not list(tmp_path.iterdir())


def test_values_that_no_file_may_say_leave_nothing(demo, tmp_path):
    fit = a_fit(demo, {"exposure": [50.0]})
    loud = demo.model_copy(update={"camera": demo.camera.model_copy(update={"gain": 900.0})})
    with pytest.raises(InputError, match=r"camera\.gain"):
        write(loud, fit, tmp_path / "out")
    assert not list(tmp_path.iterdir())


# --- knots and text ---------------------------------------------------------------------------------------


def path_of(states, chlorophyll):
    contents = [
        Pigments(
            structure_n=1.5,
            chlorophyll_ug_cm2=c,
            carotenoid_ug_cm2=2.0,
            water_cm=0.01,
            dry_matter_g_cm2=0.004,
        )
        for c in chlorophyll
    ]
    between = tuple(zip(states[1:-1], contents[1:-1], strict=True))
    return PigmentPath(
        source="parts", start=contents[0], end=contents[-1], path=between, ior=1.3, roughness=(0.3, 0.4)
    )


def test_knots_on_a_line_go_and_corners_stay():
    states = [float(s) for s in np.linspace(0.0, 1.0, 21)]
    thin = simplify_path(path_of(states, np.interp(states, [0, 0.25, 0.6, 1], [5, 40, 41, 3])))
    assert [state for state, _ in thin.path] == pytest.approx([0.25, 0.6])
    assert not simplify_path(path_of(states, np.full(21, 7.0))).path


def test_thinned_path_is_as_close_as_promised():
    rng = np.random.default_rng(11)
    states = np.sort(np.concatenate([[0.0, 1.0], rng.uniform(0.01, 0.99, 22)])).tolist()
    rough = path_of(states, np.maximum(90.0 + np.cumsum(rng.normal(0.0, 2.0, 24)), 0.0))
    smooth = path_of(states, 10.0 + 1e-7 * rng.random(24) + 20.0 * np.array(states))
    for path in (rough, smooth):
        here, there = (p.at(STATES)["chlorophyll_ug_cm2"] for p in (path, simplify_path(path)))
        assert np.abs(here - there).max() <= 1.001e-6 * np.ptp(here)
    assert len(simplify_path(rough).path) == 22
    assert not simplify_path(smooth).path


def test_text_reads_back():
    tables = {
        "name": 'a "b" \\ \n\t\x7f µ', "whole": 3, "small": 1.25e-7, "round": 2.0, "yes": True, "day": WHEN,
        "rows": [[1.0, 2.5], [3.0, 4.0]], "empty": [],
        "one": {"two": {"three": {"x": 0.1}, "y": 1}, "a key": "v"}, "none": {},
    }  # fmt: skip
    for deep in (0, 1, 2, 5):
        comments = {"name": "a\ncomment", "rows": "more", "one.a key": "x"}
        text = document(tables, comments, "head\nand more", deep)
        assert tomllib.loads(text) == tables
        assert text.startswith("# head\n# and more\n\n")
    with pytest.raises(ValueError, match="no place"):
        inline(float("nan"))
    with pytest.raises(ValueError, match="NoneType"):
        inline(None)


def test_numbers_are_told_to_what_is_known_of_them():
    assert format_with_sd(48.1234, 0.957) == "48.12 ± 0.96"
    assert format_with_sd(1234.5, 120.0) == "1230 ± 120"
    assert format_with_sd(0.0, 0.004) == "0.0000 ± 0.0040"
    assert plain(3.14159, 0.0) == "3.142"
    assert plain(3.14159, float("inf")) == "3.142"
