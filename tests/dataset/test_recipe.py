from __future__ import annotations

import dataclasses
import json
import shutil
from pathlib import Path

import pytest
import tomli_w
from hypothesis import given, settings
from hypothesis import strategies as st

from pepperscene.dataset import FrameRenderer, load_recipe
from pepperscene.dataset.recipe.load import parse_changes
from pepperscene.dataset.recipe.tables import DevelopingTable
from pepperscene.document import read_toml, validate
from pepperscene.errors import InputError
from pepperscene.shipped import shipped_folder

BARTH = shipped_folder("recipes") / "barth2018.toml"


@pytest.fixture
def write(tmp_path):
    def written(file="mine.toml", /, **tables):
        path = tmp_path / file
        path.write_text(tomli_w.dumps(tables), encoding="utf-8")
        return path

    return written


def test_the_shipped_plan_is_the_papers():
    recipe = load_recipe("barth2018")
    assert (recipe.plan.sets, recipe.plan.rotations, recipe.plan.frames) == (6, 7, 250)
    assert (recipe.row.plants_front, recipe.row.plants_back) == (7, 6)
    assert (recipe.row.spacing_mm, recipe.row.gap_mm, recipe.row.shift_mm) == (200, 200, 100)
    assert (recipe.path.distance_mm, recipe.path.pitch_deg) == (400, 20)
    assert 5000 <= recipe.daylight.illuminance_lx <= 6000
    assert recipe.camera.exposure_us == 50


def test_every_number_of_the_shipped_recipes_says_where_it_comes_from():
    for path in shipped_folder("recipes").glob("*.toml"):
        for line in path.read_text(encoding="utf-8").splitlines():
            key, _, rest = line.partition("=")
            if rest and key.strip() not in ("name", "extends"):
                assert "section" in line or "chosen" in line, f"{path.name}: {line}"


def test_the_demo_is_a_part_of_the_papers_plan():
    demo, whole = load_recipe("demo"), load_recipe("barth2018")
    assert len(demo.plan.select) == 6
    assert len({demo.plan.frame(index).set for index in demo.plan.select}) == 6
    renamed = demo.model_copy(update={"name": whole.name})
    assert renamed.identity() == whole.identity()


def test_tables_are_merged_and_lists_replaced(write):
    base = write("base.toml", extends="barth2018", plan={"frames": 5, "select": [1, 2, 3]})
    recipe = load_recipe(
        write(extends=base.name, name="x", plan={"select": [4]}, path={"azimuth_deg": [0, 10]})
    )
    assert (recipe.plan.sets, recipe.plan.frames, recipe.plan.select) == (6, 5, (4,))
    assert recipe.path.azimuth_deg == (0, 10)
    assert recipe.path.distance_mm == 400


def test_paths_are_relative_to_the_file_that_says_them(tmp_path, write, monkeypatch):
    shutil.copy(shipped_folder("plants") / "kaite.toml", tmp_path / "mine_plant.toml")
    recipe = load_recipe(write(extends="barth2018", cultivar="mine_plant.toml"))
    monkeypatch.chdir("/")
    assert recipe.cultivar == str(tmp_path / "mine_plant.toml")
    # The machine's folders are no part of what the data set is.
    assert str(tmp_path) not in str(recipe.identity())
    assert recipe.identity()["recipe"]["cultivar"] == "mine_plant"


def test_identity_follows_values_not_comments(tmp_path, write):
    plant = tmp_path / "plant.toml"
    text = (shipped_folder("plants") / "kaite.toml").read_text(encoding="utf-8")
    plant.write_text(text, encoding="utf-8")
    recipe = load_recipe(write(extends="barth2018", cultivar="plant.toml"))
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


@pytest.fixture
def own_devices(tmp_path, write):
    """A recipe with copies of shipped devices in a folder of its own."""
    for _, folder, _, _ in DEVICES.values():
        shutil.copytree(shipped_folder("materials") / folder, tmp_path / folder)
    return load_recipe(write(extends="barth2018", **_tables("{folder}/{name}.toml")))


def _tables(form):
    """The recipe's tables with every device."""
    tables = {}
    for part, (table, folder, name, _) in DEVICES.items():
        tables.setdefault(table, {})[part] = form.format(folder=folder, name=name)
    return tables


def _path(recipe, part):
    return Path(getattr(getattr(recipe, DEVICES[part][0]), part))


def test_copies_are_the_shipped_devices(own_devices, write):
    shipped = load_recipe(write("shipped.toml", extends="barth2018", **_tables("{name}")))
    assert own_devices.identity() == shipped.identity()
    expected = {"cultivar"}.union(
        *({part, *(f"{part}.{table}" for table in tables)} for part, (*_, tables) in DEVICES.items())
    )
    assert set(shipped.identity()["files"]) == expected


@pytest.mark.parametrize("part", DEVICES)
def test_identity_follows_the_devices_values(own_devices, part):
    before, file = own_devices.identity()["files"], _path(own_devices, part)
    file.write_text("# a remark\n" + file.read_text(encoding="utf-8"), encoding="utf-8")
    assert own_devices.identity()["files"] == before
    tables = read_toml(file)
    file.write_text(tomli_w.dumps(tables | {"name": "another"}), encoding="utf-8")
    after = own_devices.identity()["files"]
    assert {key for key in after if after[key] != before[key]} == {part}


@pytest.mark.parametrize(
    ("part", "table"), [(part, table) for part, (*_, tables) in DEVICES.items() for table in tables]
)
def test_identity_follows_the_spectra_that_devices_refer_to(own_devices, part, table):
    before, file = own_devices.identity()["files"], _path(own_devices, part)
    spectrum = file.parent / read_toml(file)[table]["file"]
    text = spectrum.read_text(encoding="utf-8")
    # Line ends and the way that a number is written do not count.
    spectrum.write_bytes(text.replace("\n", "\r\n").encode())
    assert own_devices.identity()["files"] == before
    # The last number of the last row, a little larger.
    head, _, last = text.rstrip().rpartition(",")
    spectrum.write_text(f"{head},{float(last) + 1e-9!r}\n", encoding="utf-8")
    after = own_devices.identity()["files"]
    assert {key for key in after if after[key] != before[key]} == {f"{part}.{table}"}
    spectrum.unlink()
    with pytest.raises(InputError, match=spectrum.stem):
        own_devices.sha256()


def test_seed_can_be_replaced():
    recipe = load_recipe("barth2018")
    assert recipe.with_seed(None) is recipe
    assert recipe.with_seed(5).seed == 5
    assert recipe.with_seed(5).sha256() != recipe.sha256()
    for wrong in (-1, 2**63):
        with pytest.raises(InputError, match="seed"):
            recipe.with_seed(wrong)


@pytest.mark.parametrize(
    ("table", "key", "value"),
    [
        ("plan", "frames", 0),
        ("plan", "frames", 2.5),
        ("plan", "frames", "250"),
        ("plan", "frames", True),
        ("plan", "select", []),
        ("plan", "select", [-1]),
        ("row", "plants_front", 0),
        ("row", "spacing_mm", -200.0),
        ("path", "distance_mm", 0.4),
        ("path", "azimuth_deg", [0.0]),
        ("path", "azimuth_deg", [0.0, float("nan")]),
        ("path", "height_mm", [0.0, float("inf")]),
        ("path", "pitch_deg", 90.0),
        ("camera", "exposure_us", 0.0),
        ("camera", "focus_mm", 0.0),
        ("camera", "gain", 0),
        ("camera", "bits", 17),
        ("camera", "bits", 0),
        ("camera", "bits", 8.0),
        ("developing", "white_balance", "tungsten"),
        ("developing", "white_balance", True),
        ("developing", "white_balance", 1.5),
        ("developing", "white_balance", [1.9, 1.0]),
        ("developing", "white_balance", [1.9, 0.0, 1.5]),
        ("developing", "white_balance", [1.9, 1000.0, 1.5]),
        ("developing", "white_balance", [1.9, float("nan"), 1.5]),
        ("developing", "white_balance", [1.9, True, 1.5]),
        ("developing", "white_balance", ["flash", 1.0, 1.5]),
        ("developing", "colour_matrix", "none"),
        ("developing", "colour_matrix", 1),
        ("developing", "colour_matrix", [1.0, 0.0, 0.0]),
        ("developing", "colour_matrix", [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]),
        ("developing", "colour_matrix", [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0]]),
        ("developing", "colour_matrix", [[1.0, 0.0, 0.0], [0.0, float("inf"), 0.0], [0.0, 0.0, 1.0]]),
        ("developing", "demosaic", "best"),
        ("developing", "falloff", 0),
        ("daylight", "cover", ""),
        ("daylight", "illuminance_lx", -1.0),
        ("daylight", "sun_fraction", 1.5),
        ("twine", "diameter_mm", 1e9),
        ("twine", "diameter_m", 0.003),
        ("nonsense", "x", 1),
    ],
)
def test_a_wrong_value_is_named_with_file_and_key(write, table, key, value):
    path = write(extends="barth2018", **{table: {key: value}})
    with pytest.raises(InputError) as caught:
        load_recipe(path)
    assert caught.value.where == str(path)
    assert caught.value.key.startswith(table if table == "nonsense" else f"{table}.{key}")


def test_a_plan_beyond_six_digits_is_refused(write):
    with pytest.raises(InputError, match="at most 1000000"):
        load_recipe(write(extends="barth2018", plan={"sets": 1000, "rotations": 1000, "frames": 2}))
    with pytest.raises(InputError, match="indices end at 10499"):
        load_recipe(write(extends="barth2018", plan={"select": [10_500]}))


def test_a_fault_in_the_extended_file_names_that_file(write):
    base = write("base.toml", extends="barth2018", row={"gap_mm": -5.0})
    top = write("top.toml", extends="base.toml", name="top")
    with pytest.raises(InputError) as caught:
        load_recipe(top)
    assert (caught.value.where, caught.value.key, caught.value.value) == (str(base), "row.gap_mm", -5.0)


def test_a_missing_key_is_named(write):
    tables = read_toml(BARTH)
    del tables["row"]["gap_mm"]
    with pytest.raises(InputError, match=r"row\.gap_mm.*missing"):
        load_recipe(write(**tables))


def test_circles_and_wrong_bases_are_refused(write):
    write("a.toml", extends="b.toml")
    write("b.toml", extends="a.toml")
    with pytest.raises(InputError, match="extends"):
        load_recipe(write("b.toml", extends="a.toml"))
    with pytest.raises(InputError, match="extends"):
        load_recipe(write("self.toml", extends="self.toml"))
    for wrong in ("nowhere.toml", "nothing", 5, "\0", "x" * 5000):
        with pytest.raises(InputError, match="extends"):
            load_recipe(write("c.toml", extends=wrong))


def test_an_unknown_cultivar_is_named_with_its_file(write):
    path = write(extends="barth2018", cultivar="cucumber")
    with pytest.raises(InputError, match=r"cultivar = 'cucumber'.*kaite") as caught:
        load_recipe(path)
    assert caught.value.where == str(path)


@pytest.mark.parametrize("name", ["", "nothing", "nowhere/x.toml", "x" * 5000, "a\0b", "."])
def test_an_unknown_recipe_is_an_input_error(name):
    with pytest.raises(InputError):
        load_recipe(name)


def test_without_a_flash_the_white_balance_must_be_another(write):
    with pytest.raises(InputError, match=r"camera\.flash = 'none'.*daylight"):
        load_recipe(write(extends="barth2018", camera={"flash": "none"}))
    for other, expected in (("daylight", "daylight"), ("none", None)):
        recipe = load_recipe(
            write(extends="barth2018", camera={"flash": "none"}, developing={"white_balance": other})
        )
        assert "flash" not in recipe.identity()["files"]
        assert FrameRenderer(recipe).camera(recipe.plan.frame(0)).developing.white_balance == expected


def test_the_developing_table_is_the_cameras(write):
    from pepperscene.camera import Developing

    steps = load_recipe(write(extends="barth2018", developing={"tone": "linear", "read_noise": False}))
    assert FrameRenderer(steps).camera(steps.plan.frame(0)).developing == Developing(
        tone="linear", read_noise=False
    )
    # A recipe without the table is developed as a camera without a word.
    assert set(DevelopingTable.model_fields) == {field.name for field in dataclasses.fields(Developing)}
    assert Developing(**DevelopingTable().model_dump()) == Developing()


GAINS = (1.9, 1.0, 1.5)
MATRIX = ((1.6, -0.4, -0.2), (-0.2, 1.5, -0.3), (0.1, -0.6, 1.5))


def test_gains_and_a_matrix_are_the_cameras_and_need_no_flash(write):
    told = {"white_balance": list(GAINS), "colour_matrix": [list(row) for row in MATRIX]}
    base = write("base.toml", extends="barth2018", camera={"flash": "none"}, developing=told)
    recipe = load_recipe(base)
    steps = FrameRenderer(recipe).camera(recipe.plan.frame(0)).developing
    assert (steps.white_balance, steps.colour_matrix) == (GAINS, MATRIX)

    # The identity goes through JSON and says them; every entry counts.
    identity = json.loads(json.dumps(recipe.identity()))
    assert identity == recipe.identity()
    assert {key: identity["recipe"]["developing"][key] for key in told} == told
    other = load_recipe(base, {"developing.white_balance": [1.9, 1.0, 1.50001]})
    assert other.sha256() != recipe.sha256()

    # A list is replaced whole, and may be given up again.
    above = load_recipe(write(extends=base.name, developing={"white_balance": [2, 1, 1]}))
    assert above.developing.white_balance == (2.0, 1.0, 1.0)
    assert above.developing.colour_matrix == MATRIX
    given_up = load_recipe(base, {"developing.white_balance": "daylight", "developing.colour_matrix": True})
    plain = write("plain.toml", extends="barth2018", camera={"flash": "none"},
                  developing={"white_balance": "daylight"})  # fmt: skip
    assert given_up.sha256() == load_recipe(plain).sha256()


def test_the_command_line_gives_gains_and_a_matrix():
    changes = parse_changes(
        [
            "developing.white_balance=[1.9, 1, 1.5]",
            "developing.colour_matrix=[[1, 0, 0], [0, 1, 0], [0, 0, 1]]",
        ]
    )
    found = load_recipe("barth2018", changes).developing
    assert found.white_balance == GAINS
    assert found.colour_matrix == ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))


@pytest.mark.parametrize(
    ("key", "value", "allowed"),
    [
        ("white_balance", [1.9, 1.0], "gains of red, green and blue, each 0.01 to 100"),
        ("white_balance", "tungsten", '"flash", "daylight", "none"'),
        ("colour_matrix", [[1.0]], "three rows of three numbers, each -100 to 100"),
    ],
)
def test_a_wrong_balance_or_matrix_is_told_in_one_sentence(write, key, value, allowed):
    path = write(extends="barth2018", developing={key: value})
    with pytest.raises(InputError) as caught:
        load_recipe(path)
    assert (caught.value.key, caught.value.value) == (f"developing.{key}", value)
    assert allowed in caught.value.problem


NUMBERS = st.floats() | st.floats(0.01, 100) | st.integers(-2, 200)
ROWS = st.lists(NUMBERS, min_size=2, max_size=4)
VALUES = st.one_of(
    st.none() | st.booleans() | NUMBERS,
    st.sampled_from(["flash", "daylight", "none", "", "[1, 1, 1]"]),
    ROWS | st.lists(ROWS, min_size=2, max_size=4) | st.tuples(*3 * [NUMBERS]),
    st.lists(st.booleans() | st.text(), max_size=3),
)


@given(VALUES, st.sampled_from(["white_balance", "colour_matrix"]))
@settings(max_examples=300, deadline=None)
def test_whatever_a_recipe_takes_a_camera_takes(value, key):
    """And whatever else stands there is a fault of the key itself."""
    from pepperscene.camera import Developing

    found = read_or_fault({key: value})
    if isinstance(found, InputError):
        assert found.key == key
    else:
        steps = {name: None if step == "none" else step for name, step in found.model_dump().items()}
        assert getattr(Developing(**steps), key) == steps[key]


def read_or_fault(steps):
    try:
        return validate(DevelopingTable, steps, "mine.toml")
    except InputError as fault:
        return fault


def test_the_limits_of_gains_and_matrix_are_the_cameras():
    from pepperscene.camera.readout import GAIN_RANGE, LARGEST_MATRIX_ENTRY

    for limit, beyond in zip(GAIN_RANGE, (0.99, 1.01), strict=True):
        assert DevelopingTable(white_balance=(limit, 1.0, 1.0)).white_balance[0] == limit
        with pytest.raises(ValueError, match="must be"):
            DevelopingTable(white_balance=(beyond * limit, 1.0, 1.0))
    for entry in (LARGEST_MATRIX_ENTRY, -LARGEST_MATRIX_ENTRY):
        rows = ((entry, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
        assert DevelopingTable(colour_matrix=rows).colour_matrix == rows
        with pytest.raises(ValueError, match="must be"):
            DevelopingTable(colour_matrix=((1.01 * entry, 0.0, 0.0), *rows[1:]))


def test_a_monochrome_camera_needs_no_white_balance(write):
    mono = {"flash": "none", "sensor": "onsemi_mt9v024_mono"}
    assert load_recipe(write(extends="barth2018", camera=mono)).camera.flash == "none"


@pytest.mark.parametrize(
    ("text", "changes", "kept"),
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
def test_what_is_expected_goes_on_for_the_same_kind_of_frames_alone(tmp_path, text, changes, kept):
    file = tmp_path / "mine.toml"
    file.write_text(f'extends = "barth2018"\n{text}\n')
    assert (load_recipe(file, changes).expect is not None) == kept
