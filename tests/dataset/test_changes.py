from __future__ import annotations

import shutil

import pytest
import tomli_w
from hypothesis import example, given
from hypothesis import strategies as st

from pepperscene.dataset import load_recipe, parse_changes
from pepperscene.dataset.recipe.load import label
from pepperscene.errors import InputError
from pepperscene.shipped import shipped_folder

PRINTABLE = st.characters(exclude_categories=("C", "Z"), include_characters=" ")


@given(
    st.one_of(
        st.booleans(),
        st.integers(-(2**63), 2**63 - 1),
        st.floats(allow_nan=False),
        st.text(),
        st.lists(st.floats(allow_nan=False), max_size=3),
        st.lists(st.text(PRINTABLE), max_size=3),
    )
)
def test_values_are_read_as_in_a_toml_file(value):
    text = tomli_w.dumps({"value": value}, multiline_strings=False).partition("=")[2]
    # Lists are written over several lines; on the command line there is one.
    assert parse_changes([f"key={' '.join(text.split(chr(10)))}"]) == {"key": value}


@pytest.mark.parametrize(
    "word", ["none", "nikon_d5100", "mine/sensor.toml", "../x.toml", "2024_camera.toml", ""]
)
def test_what_is_no_toml_value_is_text(word):
    assert parse_changes([f"camera.sensor={word}"]) == {"camera.sensor": word}


@given(st.text())
@example("1\nseed = 3")
@example("{a = 1}\n[row]")
def test_a_value_says_nothing_but_itself(text):
    try:
        changes = parse_changes([f"path.pitch_deg={text}"])
    except InputError:
        return
    assert list(changes) == ["path.pitch_deg"]


@given(st.one_of(st.text(PRINTABLE, max_size=20), st.integers(-(10**9), 10**9), st.booleans()))
def test_a_label_reads_as_the_value(value):
    assert parse_changes([label("key", value).removeprefix("--set ")]) == {"key": value}


def test_of_two_values_the_last_one_counts():
    assert parse_changes(["a=1", "b=2", "a = 3"]) == {"b": 2, "a": 3}
    recipe = load_recipe(
        "barth2018", parse_changes(["daylight={cloud_cover=0.1}", "daylight.cloud_cover=0.2"])
    )
    assert recipe.daylight.cloud_cover == 0.2


def test_a_change_is_what_a_file_with_it_is(tmp_path):
    tables = {"path": {"pitch_deg": 5, "azimuth_deg": [0, 10]}, "camera": {"exposure_us": 60.0}}
    file = tmp_path / "mine.toml"
    file.write_text(tomli_w.dumps({"extends": "barth2018", **tables}), encoding="utf-8")
    texts = ["path.pitch_deg=5", "path={azimuth_deg=[0, 10]}", "camera.exposure_us=60.0"]
    assert load_recipe("barth2018", parse_changes(texts)) == load_recipe(file)
    assert load_recipe("barth2018", parse_changes(texts)).sha256() == load_recipe(file).sha256()


def test_a_change_does_not_touch_what_it_was_given(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    shutil.copy(shipped_folder("materials") / "lenses" / "lensagon_cmfa0420nd.toml", tmp_path / "mine.toml")
    mine_table = {"camera": {"lens": "mine.toml"}}
    assert load_recipe("barth2018", mine_table).camera.lens == str(tmp_path / "mine.toml")
    assert mine_table == {"camera": {"lens": "mine.toml"}}


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("nonsense", "must be KEY=VALUE"),
        ("=3", "is not a known key; allowed are name, seed"),
        ("camera.senzor=x", r"--set camera\.senzor: .*allowed in camera are sensor, lens"),
        ("camera.sensor.x=1", r"camera\.sensor is no table"),
        ("extends=demo", "not a known key"),
        ("camera.sensor=nothing", "--set camera.sensor=nothing: no such file, nor one of .*ueye_ui5250re"),
        ("camera.exposure_us=12mm", "--set camera.exposure_us=12mm: must be a valid number"),
        ("camera.exposure_us=-1", "--set camera.exposure_us=-1: must be greater"),
        ('camera.bits="8"', '--set camera.bits="8": must be a valid integer'),
        ("camera.focus_mm=2", "--set camera.focus_mm=2: must be beyond the focal length"),
        ("camera.flash=none", "--set camera.flash=none: needs a developing.white_balance"),
        ("camera.filter=bandpass_850nm", "--set camera.filter=bandpass_850nm: .*sees no light at all"),
        ("camera.exposure_us=1" + "0" * 400, r"--set camera\.exposure_us=10+….* must be"),
        ("daylight={cloud_cover=2}", r"--set daylight=.*: daylight\.cloud_cover = 2: must be less"),
        ("path.azimuth_deg=[0,999]", r"--set path\.azimuth_deg=\[0, 999\]: path\.azimuth_deg\.1 = 999"),
        ("path.azimuth_deg=[0", r"--set path\.azimuth_deg=\[0: is not a value"),
        ("cultivar=../x.toml", "--set cultivar=../x.toml: no such file"),
    ],
)
def test_faults_name_the_change_and_what_is_allowed(text, told):
    with pytest.raises(InputError, match=told):
        load_recipe("barth2018", parse_changes([text, "path.pitch_deg=3"]))


def test_a_table_that_only_a_change_begins_is_the_changes_fault(tmp_path):
    night = tmp_path / "night.toml"
    tables = load_recipe("barth2018").model_dump(exclude={"daylight", "twine"}, exclude_none=True)
    night.write_text(tomli_w.dumps(tables), encoding="utf-8")
    with pytest.raises(InputError, match=r"--set twine\.turns_per_m=2: twine\.diameter_mm: is required"):
        load_recipe(night, {"twine.turns_per_m": 2})


def test_a_fault_of_the_file_stays_the_files(tmp_path):
    wrong = tmp_path / "wrong.toml"
    wrong.write_text('extends = "barth2018"\n[row]\ngap_mm = -5\n', encoding="utf-8")
    with pytest.raises(InputError, match=r"wrong\.toml: row\.gap_mm = -5"):
        load_recipe(wrong, {"row.spacing_mm": 300})
