"""Changes of single values of a recipe: parsed as in a TOML file, merged as a file, named in errors."""

from __future__ import annotations

import shutil

import pytest
import tomli_w
from hypothesis import example, given
from hypothesis import strategies as st

from pepperscene.errors import ArgumentError, InputError
from pepperscene.recipe.resolve.load import load_recipe, parse_changes
from pepperscene.shipped import shipped_folder

PRINTABLE = st.characters(exclude_categories=("C", "Z"), include_characters=" ")


@given(
    st.one_of(
        st.booleans(),
        st.integers(-(2**63), 2**63 - 1),
        st.floats(allow_nan=False),
        st.dates(),
        st.text(),
        st.lists(st.floats(allow_nan=False), max_size=3),
        st.lists(st.text(PRINTABLE), max_size=3),
    )
)
def test_values_are_parsed_as_in_a_toml_file(value):
    text = tomli_w.dumps({"value": value}, multiline_strings=False).partition("=")[2]
    # Lists are written over several lines; on the command line there is one.
    assert parse_changes([f"key={' '.join(text.split(chr(10)))}"]) == {"key": value}


@given(st.text())
@example("1\nseed = 3")
@example("{a = 1}\n[row]")
def test_value_changes_no_other_key(text):
    try:
        changes = parse_changes([f"views.pitch_deg={text}"])
    except InputError:
        return
    assert list(changes) == ["views.pitch_deg"]


def test_words_that_are_not_toml_are_text_and_the_last_change_of_a_key_counts():
    for word in ("none", "mine/sensor.toml", "../x.toml", "2024_camera.toml", ""):
        assert parse_changes([f"camera.sensor={word}"]) == {"camera.sensor": word}
    assert parse_changes(["a=1", "b=2", "a = 3"]) == {"b": 2, "a": 3}
    changes = parse_changes(["daylight={cloud_cover=0.1}", "daylight.cloud_cover=0.2"])
    assert load_recipe("barth2018", changes).daylight.cloud_cover == 0.2


def test_changes_are_equivalent_to_a_file(write_recipe):
    tables = {"views": {"pitch_deg": 5, "azimuth_deg": [0, 10]}, "camera": {"exposure_us": 60.0}}
    expected = load_recipe(write_recipe(**tables))
    texts = ["views.pitch_deg=5", "views={azimuth_deg=[0, 10]}", "camera.exposure_us=60.0"]
    changed = load_recipe("barth2018", parse_changes(texts))
    assert changed == expected
    assert changed.sha256() == expected.sha256()


def test_argument_is_not_modified(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    shutil.copy(shipped_folder("materials") / "lenses" / "lensagon_cmfa0420nd.toml", tmp_path / "mine.toml")
    changes = {"camera": {"lens": "mine.toml"}}
    assert load_recipe("barth2018", changes).camera.lens == str(tmp_path / "mine.toml")
    assert changes == {"camera": {"lens": "mine.toml"}}


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("nonsense", "must be KEY=VALUE"),
        ("=3", "is not a known key; allowed are name, seed"),
        ("camera.senzor=x", r"camera\.senzor: .*allowed in camera are sensor, lens"),
        ("camera.sensor.x=1", r"camera\.sensor is not a table"),
        ("extends=demo", "not a known key"),
        ("camera.sensor=nothing", "camera.sensor = 'nothing': no such file, nor one of .*ueye_ui5250re"),
        ("camera.exposure_us=-1", "camera.exposure_us = -1: must be 1 to 1,000,000"),
        ("camera.focus_mm=2", "camera.focus_mm = 2.*: must be beyond the focal length"),
        ("camera.exposure_us=1" + "0" * 400, r"camera\.exposure_us = 10+….* must be"),
        ("views.azimuth_deg=[0,999]", r"views\.azimuth_deg\.1 = 999"),
        ("views.azimuth_deg=[0", r"views\.azimuth_deg = '\[0': is not a valid TOML value"),
    ],
)
def test_errors_name_the_change_and_what_is_allowed(text, message):
    with pytest.raises(ArgumentError, match=f"^changes: .*{message}"):
        load_recipe("barth2018", parse_changes([text, "views.pitch_deg=3"]))


def test_error_in_a_table_that_only_a_change_has_names_the_change(tmp_path):
    night = tmp_path / "night.toml"
    tables = load_recipe("barth2018").model_dump(exclude={"daylight", "twine"}, exclude_none=True)
    night.write_text(tomli_w.dumps(tables), encoding="utf-8")
    with pytest.raises(ArgumentError, match=r"changes: twine\.diameter_mm: is required"):
        load_recipe(night, {"twine.turns_per_m": 2})
