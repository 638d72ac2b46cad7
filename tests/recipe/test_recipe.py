"""Recipe files: the shipped ones, files that extend each other, the identity of a data set, and errors."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
import tomli_w

from pepperscene.document import read_toml
from pepperscene.errors import InputError
from pepperscene.recipe.resolve.load import load_recipe
from pepperscene.recipe.resolve.load_camera import load_camera
from pepperscene.shipped import shipped_folder

RECIPES, PLANTS = shipped_folder("recipes"), shipped_folder("plants")


def test_shipped_plan_is_the_published_one():
    recipe = load_recipe("barth2018")
    assert (recipe.plan.sets, recipe.plan.rotations, recipe.plan.frames) == (6, 7, 250)
    assert (recipe.row.plants_front, recipe.row.plants_back) == (7, 6)
    assert (recipe.row.spacing_m, recipe.row.gap_m, recipe.row.shift_m) == (0.2, 0.2, 0.1)
    assert (recipe.views.distance_m, recipe.views.pitch_rad) == (0.4, np.radians(20))
    assert 5000 <= recipe.daylight.illuminance_lx <= 6000
    assert recipe.camera.exposure_s == 50e-6


def test_every_shipped_number_names_its_source():
    for path in RECIPES.glob("*.toml"):
        for line in path.read_text(encoding="utf-8").splitlines():
            key, _, rest = line.partition("=")
            if rest and key.strip() not in ("name", "extends"):
                assert "section" in line or "chosen" in line, f"{path.name}: {line}"


def test_demo_selects_frames_of_the_published_plan():
    demo, published = load_recipe("demo"), load_recipe("barth2018")
    assert len(demo.plan.select) == 6
    assert len({demo.plan.frame(index).set for index in demo.plan.select}) == 6
    renamed = demo.model_copy(update={"name": published.name})
    assert renamed.identity() == published.identity()


def test_tables_are_merged_and_lists_replaced(write_recipe):
    base = write_recipe("base.toml", plan={"frames": 5, "select": [1, 2, 3]})
    recipe = load_recipe(
        write_recipe(extends=base.name, name="x", plan={"select": [4]}, views={"azimuth_deg": [0, 10]})
    )
    assert (recipe.plan.sets, recipe.plan.frames, recipe.plan.select) == (6, 5, (4,))
    assert recipe.views.azimuth_rad == (0, np.radians(10))
    assert recipe.views.distance_m == 0.4


def test_paths_are_relative_to_the_file_that_holds_them(tmp_path, write_recipe, monkeypatch):
    shutil.copy(PLANTS / "kaite.toml", tmp_path / "mine_plant.toml")
    recipe = load_recipe(write_recipe(cultivar="mine_plant.toml"))
    monkeypatch.chdir("/")
    assert recipe.cultivar == str(tmp_path / "mine_plant.toml")
    # Folders are no part of the identity.
    assert str(tmp_path) not in str(recipe.identity())
    assert recipe.identity()["recipe"]["cultivar"] == "mine_plant"


def test_rejects_cycles_and_missing_or_invalid_bases(write_recipe):
    write_recipe("a.toml", extends="b.toml")
    cases = [("b.toml", "a.toml"), ("self.toml", "self.toml")]
    cases += [("c.toml", base) for base in ("nowhere.toml", "nothing", 5, "\0", "x" * 5000)]
    for name, base in cases:
        with pytest.raises(InputError, match="extends"):
            load_recipe(write_recipe(name, extends=base))


@pytest.mark.parametrize(
    ("text", "changes", "inherited"),
    [
        ('name = "other"\nseed = 5', {}, True),
        ("[plan]\nselect = [3]", {}, True),
        ("[camera]\nexposure_us = 25", {}, False),
        ("", {"camera.exposure_us": 25.0}, False),
        ("", {"seed": 7}, True),
        ("[camera]\nexposure_us = 25\n[expect]\nintensity = [1, 50]", {}, True),
        ("[expect]\nintensity = [1, 50]", {"camera.exposure_us": 25.0}, False),
        ("[camera]\nexposure_us = 25", {"expect.saturated": 0.5}, True),
    ],
)
def test_expectations_are_inherited_only_for_frames_of_the_same_kind(tmp_path, text, changes, inherited):
    file = tmp_path / "mine.toml"
    file.write_text(f'extends = "barth2018"\n{text}\n')
    assert (load_recipe(file, changes).expect is not None) == inherited


def test_identity_follows_the_cultivars_values_not_its_comments(tmp_path, write_recipe):
    plant = tmp_path / "plant.toml"
    text = (PLANTS / "kaite.toml").read_text(encoding="utf-8")
    plant.write_text(text, encoding="utf-8")
    recipe = load_recipe(write_recipe(cultivar="plant.toml"))
    before = recipe.sha256()
    plant.write_text("# a remark\n" + text, encoding="utf-8")
    assert recipe.sha256() == before
    plant.write_text(text.replace("parts = 40", "parts = 39"), encoding="utf-8")
    assert recipe.sha256() != before


# The recipe's table, the folder, a shipped file, and its tables that refer to spectra.
DEVICES = {
    "sensor": ("camera", "sensors", "onsemi_mt9v024", ["quantum_efficiency", "infrared_cut"]),
    "lens": ("camera", "lenses", "lensagon_cmfa0420nd", []),
    "flash": ("camera", "flashes", "led_matrix_200klx", ["spectrum"]),
    "filter": ("camera", "filters", "schott_22022010", ["transmittance"]),
    "cover": ("daylight", "covers", "polyethylene_film", ["transmittance"]),
}


def device_tables(form):
    """The recipe's tables with every device."""
    tables = {}
    for part, (table, folder, name, _) in DEVICES.items():
        tables.setdefault(table, {})[part] = form.format(folder=folder, name=name)
    return tables


@pytest.fixture
def device_copies(tmp_path, write_recipe):
    """A recipe with copies of shipped devices in its folder."""
    for _, folder, _, _ in DEVICES.values():
        shutil.copytree(shipped_folder("materials") / folder, tmp_path / folder)
    return load_recipe(write_recipe(**device_tables("{folder}/{name}.toml")))


def device_file(recipe, part):
    return Path(getattr(getattr(recipe, DEVICES[part][0]), part))


def changed_files(before, recipe):
    after = recipe.identity()["files"]
    return {key for key in after if after[key] != before[key]}


def test_copies_of_devices_have_the_same_identity(device_copies, write_recipe):
    shipped = load_recipe(write_recipe("shipped.toml", **device_tables("{name}")))
    assert device_copies.identity() == shipped.identity()
    spectra = {f"{part}.{table}" for part, (*_, tables) in DEVICES.items() for table in tables}
    assert set(shipped.identity()["files"]) == {"cultivar", *DEVICES, *spectra}


@pytest.mark.parametrize("part", DEVICES)
def test_identity_follows_the_values_and_spectra_of_devices(device_copies, part):
    before, file = device_copies.identity()["files"], device_file(device_copies, part)
    for table in DEVICES[part][-1]:
        spectrum = file.parent / read_toml(file)[table]["file"]
        text = spectrum.read_text(encoding="utf-8")
        # Line ends do not count.
        spectrum.write_bytes(text.replace("\n", "\r\n").encode())
        assert not changed_files(before, device_copies)
        # The last number of the last row, a little larger.
        head, _, last = text.rstrip().rpartition(",")
        spectrum.write_text(f"{head},{float(last) + 1e-9!r}\n", encoding="utf-8")
        assert changed_files(before, device_copies) == {f"{part}.{table}"}
        spectrum.write_text(text, encoding="utf-8")
    file.write_text("# a remark\n" + file.read_text(encoding="utf-8"), encoding="utf-8")
    assert not changed_files(before, device_copies)
    file.write_text(tomli_w.dumps(read_toml(file) | {"name": "another"}), encoding="utf-8")
    assert changed_files(before, device_copies) == {part}


def test_seed_can_be_replaced():
    recipe = load_recipe("barth2018")
    assert recipe.with_seed(None) is recipe
    assert recipe.with_seed(5).seed == 5
    assert recipe.with_seed(5).sha256() != recipe.sha256()
    for invalid in (-1, 2**63):
        with pytest.raises(InputError, match="seed"):
            recipe.with_seed(invalid)


NAN, INF = float("nan"), float("inf")
INVALID = {
    "plan.frames": [0, 2.5, "250", True],
    "plan.select": [[-1]],
    "row.spacing_mm": [-200.0],
    "views.azimuth_deg": [[0.0], [0.0, NAN]],
    "views.height_mm": [[0.0, INF]],
    "views.pitch_deg": [90.0],
    "camera.gain": [0],
    "camera.bits": [17, 0, 8.0],
    "developing.white_balance": ["tungsten", True, 1.5, [1.9, 1.0], [1.9, NAN, 1.5], [1.9, True, 1.5]],
    "developing.colour_matrix": ["none", 1, [1.0, 0.0, 0.0], [[1.0, 0.0, 0.0]] * 2, [[1.0, INF, 0.0]] * 3],
    "developing.falloff": [0],
    "daylight.cover": [""],
    "daylight.sun_fraction": [1.5],
    "twine.diameter_mm": [1e9],
    "twine.diameter_m": [0.003],
}


@pytest.mark.parametrize(
    ("dotted_key", "value"), [(key, value) for key, values in INVALID.items() for value in values]
)
def test_invalid_value_is_named_with_file_and_key(write_recipe, dotted_key, value):
    table, key = dotted_key.split(".")
    path = write_recipe(**{table: {key: value}})
    with pytest.raises(InputError) as error:
        load_recipe(path)
    assert error.value.where == str(path)
    assert error.value.key.startswith(dotted_key)


def test_rejects_plans_with_too_many_frames_or_unknown_indices(write_recipe):
    with pytest.raises(InputError, match="at most 1000000"):
        load_recipe(write_recipe(plan={"sets": 1000, "rotations": 1000, "frames": 2}))
    with pytest.raises(InputError, match="the last index is 10499"):
        load_recipe(write_recipe(plan={"select": [10_500]}))


@pytest.mark.parametrize("name", ["", "nothing", "x" * 5000, "a\0b", "."])
def test_unknown_recipe_is_an_input_error(name):
    with pytest.raises(InputError):
        load_recipe(name)


@pytest.mark.parametrize(
    ("names", "f_number"),
    [
        (("barth2018", "demo", "barth2018_robot"), 3.6),
        (("greenhouse", "season", "multispectral", "twins"), None),
    ],
)
def test_recipes_of_the_paper_have_its_brightness_and_the_lens_for_it(names, f_number):
    """Draft frames of 42 scenes have the published mean of 37 at f/3.6."""
    for name in names:
        recipe = load_recipe(name)
        lens = load_camera(recipe).lens
        assert lens.f_number == f_number if f_number else "f/3.6" not in lens.name
        if f_number and name != "barth2018_robot":
            low, high = recipe.expect.intensity
            assert (low + high) / 2 == 37.0
            assert high - low <= 6.0
