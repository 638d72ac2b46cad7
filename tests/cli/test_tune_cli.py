"""`pepperscene tune`: names, patches, progress, tables and errors, with fits to reflectances."""

from __future__ import annotations

import importlib
import json
import shutil
import tomllib

import pytest

from pepperscene.recipe.resolve.load import load_recipe
from pepperscene.recipe.resolve.resolved import load_recipe_cultivar
from pepperscene.shipped import shipped_folder

MEASURED = {
    "structure_n": 1.0,
    "chlorophyll_ug_cm2": 15.7,
    "carotenoid_ug_cm2": 4.4,
    "anthocyanin_ug_cm2": 0.0,
    "brown": 0.36,
}
"""Contents of a layer on flesh that were fitted to the measured green pepper of Vrhel et al. 1994."""
MEASURED_FLESH = 0.66
FIT = ("--fit", "fruit.unripe.chlorophyll,fruit.unripe.brown", "--starts", "1")


@pytest.fixture(scope="module")
def green(tmp_path_factory):
    """A patches file with a measured green pepper."""
    folder = tmp_path_factory.mktemp("patches")
    for suffix in ("csv", "toml"):
        shutil.copy(shipped_folder("materials") / f"fruit/vrhel_fruit_vegetable_reflectance.{suffix}", folder)
    (folder / "green.toml").write_text(
        '[[spectrum]]\nfile = "vrhel_fruit_vegetable_reflectance.csv"\n'
        'column = "green_pepper_136"\nkind = "pepper.unripe"\n'
    )
    return folder / "green.toml"


@pytest.fixture(scope="module")
def fitted(command, green, tmp_path_factory):
    """A fit that starts from a wrong cultivar, and the folder of its files."""
    folder = tmp_path_factory.mktemp("tuned")
    wrong = ("--set", f"cultivar={write_paler_cultivar(folder)}", "--set", "camera.gain=2")
    result = command("tune", "demo", "--patches", green, *FIT, *wrong, "--out", folder / "out")
    assert result.exit_code == 0, result.stderr
    return result, folder


def write_paler_cultivar(folder):
    """Write a cultivar file whose green fruit has half of the chlorophyll of the measured one."""
    path = load_recipe_cultivar(load_recipe("demo")).pigments["fruit"]
    measured = path.start.model_copy(update=MEASURED)

    def row(pigments, factor):
        fields = pigments.model_dump() | {"chlorophyll_ug_cm2": factor * pigments.chlorophyll_ug_cm2}
        return "{ " + ", ".join(f"{name} = {value}" for name, value in fields.items()) + " }"

    (folder / "paler.toml").write_text(
        'extends = "kaite"\nname = "Paler"\n[pigments.fruit]\nchosen = "to be tuned"\n'
        f"flesh_reflectance = {MEASURED_FLESH}\nior = {path.ior}\n"
        f"roughness = {list(path.roughness)}\n"
        f"start = {row(measured, 0.5)}\nend = {row(path.end, 1.0)}\n"
    )
    return folder / "paler.toml"


def test_fit_is_printed_and_written(fitted):
    result, folder = fitted
    assert [line[:12] for line in result.stderr.splitlines()] == ["start 1 of 1"]
    lines = result.stdout.splitlines()
    assert lines[0] == "Fitted parameters"
    name, before, *_ = lines[2].split()
    assert name == "fruit.unripe.chlorophyll"
    # Rounded to its significant digits.
    assert float(before) == pytest.approx(7.85, abs=0.06)
    before, after = (float(cell) for cell in lines[lines.index("") + 3].split()[1:])
    assert after < 0.02 < before
    assert any(line.startswith("The model ") for line in lines)
    assert lines[-4:] == [
        str(folder / "out" / name)
        for name in ("demo_tuned.toml", "paler_tuned.toml", "before_after.png", "tuning.json")
    ]


def test_tuned_fruit_has_the_chlorophyll_of_the_measured_one(fitted):
    _, folder = fitted
    start = load_recipe_cultivar(load_recipe(folder / "out" / "demo_tuned.toml")).pigments["fruit"].start
    # The contents were fitted to the same spectrum by another method, all pigments together.
    assert start.chlorophyll_ug_cm2 == pytest.approx(MEASURED["chlorophyll_ug_cm2"], rel=0.15)


def test_written_recipe_has_manual_changes_as_well(fitted):
    _, folder = fitted
    content = tomllib.loads((folder / "out" / "demo_tuned.toml").read_text())
    assert content == {
        "extends": "demo", "name": "demo_tuned", "cultivar": "paler_tuned.toml", "camera": {"gain": 2}
    }  # fmt: skip
    options = json.loads((folder / "out" / "tuning.json").read_text())["options"]
    assert options["fit"] == ["fruit.unripe.chlorophyll", "fruit.unripe.brown"]
    assert options["starts"] == 1
    assert "camera.gain=2" in options["set"]


def test_patches_of_several_files_are_merged_and_json_is_the_only_output(command, green, tmp_path):
    files = ("--patches", green, "--patches", green)
    result = command("tune", "demo", *files, *FIT, "--out", tmp_path / "out", "--json")
    assert result.exit_code == 0, result.stderr
    assert result.stderr == ""
    record = json.loads(result.stdout)
    assert len(record["patches"]["members"]) == len(record["spectra"]) == 2
    assert [one["name"] for one in record["parameters"]] == ["fruit.unripe.chlorophyll", "fruit.unripe.brown"]
    assert record["files"][0] == str(tmp_path / "out" / "demo_tuned.toml")


def test_help_lists_the_parameters(command):
    result = command("tune", "demo", "--fit", "help")
    assert result.exit_code == 0
    for name in ("leaf.chlorophyll", "fruit.unripe.brown", "flash.colour (warmth)", "white_balance (red)"):
        assert f"\n{name} " in result.stdout
    names = json.loads(command("tune", "greenhouse", "--fit", "help", "--json").stdout)
    assert "exposure" in names
    assert not [name for name in names if name.startswith("flash.")]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"--fit": "leaf.chlorophyl"}, "closest are leaf.chlorophyll"),
        ({"--fit": ","}, "--fit: needs at least one"),
        ({"--fit": "flash.power", "--set": "camera.flash=none"}, "flash"),
        ({"--patches": "nowhere.toml"}, "nowhere.toml"),
        ({"--patches": None}, "--patches: is required"),
        ({"--bounds": "nowhere.toml"}, "nowhere.toml"),
        ({"--hold-out": "img9"}, "--hold-out: no patch is of a picture 'img9'"),
        ({"--labels": "barth2018"}, "--labels: applies only to a folder"),
        ({"--quality": "best", "--verify": "1"}, "draft, standard, reference"),
    ],
)
def test_errors_give_one_line_and_write_nothing(change, message, rejects, green, tmp_path):
    options = {"--fit": FIT[1], "--patches": str(green), "--out": str(tmp_path / "out")} | change
    arguments = [part for name, value in options.items() if value is not None for part in (name, value)]
    more = ("--set", "developing.white_balance=daylight") if "--set" in options else ()
    rejects(message, "tune", "demo", *arguments, *more)
    assert not (tmp_path / "out").exists()


def test_rejects_a_folder_with_files_before_the_fit(rejects, green, tmp_path):
    (tmp_path / "mine.txt").write_text("keep")
    rejects("mine.txt", "tune", "demo", "--patches", green, *FIT, "--out", tmp_path)


def test_interrupted_fit_writes_nothing(command, green, tmp_path, monkeypatch):
    def interrupt(*_args, **_kwargs):
        raise KeyboardInterrupt

    monkeypatch.setattr(importlib.import_module("pepperscene.tuning.workflow"), "fit_parameters", interrupt)
    result = command("tune", "demo", "--patches", green, *FIT, "--out", tmp_path / "out")
    assert result.exit_code == 130
    assert result.stderr == "interrupted; nothing was written\n"
    assert not (tmp_path / "out").exists()
