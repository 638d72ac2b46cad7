"""Reading files: every error is one sentence with file, key, value and what is allowed."""

from __future__ import annotations

import math
import pickle
from contextlib import suppress
from typing import Annotated, Literal

import pytest
import tomli_w
from hypothesis import given
from hypothesis import strategies as st
from pydantic import Field, ValidationError, model_validator

from pepperscene.document import Document, read_toml, toml_key, validate
from pepperscene.errors import ArgumentError, InputError
from pepperscene.shipped import find_file, shipped_folder


class Flash(Document):
    lux: Annotated[float, Field(gt=0)]
    kind: Literal["led", "xenon"] = "led"


class Camera(Document):
    name: str
    flash: Flash
    sizes: Annotated[tuple[int, ...], Field(max_length=4)] = ()

    @model_validator(mode="after")
    def _ascending(self):
        if list(self.sizes) != sorted(self.sizes):
            raise ValueError("sizes must ascend")
        return self


GOOD = {"name": "c", "flash": {"lux": 5.0}}


@pytest.fixture
def write(tmp_path):
    def write_file(content, name="file.toml"):
        path = tmp_path / name
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
        return path

    return write_file


def error_of(path):
    """The error of reading a file; its message is one line that begins with the file."""
    with pytest.raises(InputError) as caught:
        read_toml(path)
    assert "\n" not in str(caught.value)
    assert str(caught.value).startswith(str(path))
    return caught.value


def test_valid_file_is_read_unchanged(write):
    table = GOOD | {"least": -(2**63), "most": 2**63 - 1, "on": True, "deep": {"er": [[1], [{"x": 2}]]}}
    assert read_toml(write(tomli_w.dumps(table))) == table


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"\xff\xfe", "UTF-8"),
        (b"a = ?\nb = 2", "line 1, column 5"),
        (b"a = 1\na = 2\nb = 3", "line 2, column 6"),
        (b"a = 1979-13-40", "not valid TOML"),
        (b"a = '\x00'", "not valid TOML"),
        (b'a = "\\ud800"', "not valid TOML"),
        (b"a = " + b"[" * 100_000, "nested too deeply"),
        (b"a = " + b"[" * 33 + b"]" * 33, "nested too deeply"),
        (b".".join([b"a"] * 5000) + b" = 1", "nested too deeply"),
    ],
)
def test_raises_on_invalid_toml(write, content, message):
    assert message in str(error_of(write(content)))


@pytest.mark.parametrize("where", ["missing.toml", ".", "x" * 300])
def test_raises_on_unreadable_file(tmp_path, where):
    assert "cannot be read" in str(error_of(tmp_path / where))


def test_raises_on_invalid_path(tmp_path):
    with pytest.raises(InputError, match="cannot be read") as caught:
        read_toml(tmp_path / "a\0b")
    assert "\0" not in str(caught.value)


@pytest.mark.parametrize(
    "number",
    [str(2**63), str(-(2**63) - 1), "-" + "9" * 5000, "_".join(["1"] * 5000), "0x" + "f" * 50_000],
    ids=["63 bits", "-63 bits", "5000 digits", "underscores", "hex"],
)
@pytest.mark.parametrize(
    ("text", "key"),
    [
        ("a = {}", "a"),
        ("[views]\ndistance_mm = 1.{zeros}1\nheight_mm = [0, {}]", "views.height_mm.1"),
        ('[[x]]\n["a b".c]\ny = [{{ z = {} }}]\n# 1{zeros}', '"a b".c.y.0.z'),
    ],
)
def test_integers_beyond_64_bits_are_named_by_their_key(write, text, key, number):
    error = error_of(write(text.format(number, zeros="0" * 5000)))
    assert error.key == key
    assert f": {key}" in str(error)
    assert str(2**63 - 1) in error.problem
    assert len(str(error).removeprefix(error.where)) < 250


def test_long_floats_and_strings_are_accepted(write):
    digits = "1" * 5000
    tables = read_toml(write(f"a = 0.{digits}\nb = '{digits}'\nc = {digits}.0"))
    assert tables == {"a": pytest.approx(1 / 9), "b": digits, "c": math.inf}


@given(st.binary(max_size=40) | st.text("[]{}=.,\"'#\n abe019_-+:Tx", max_size=40).map(str.encode))
def test_any_bytes_give_tables_or_an_input_error(write, content):
    path = write(content)
    with suppress(InputError):
        assert isinstance(read_toml(path), dict)


@pytest.mark.parametrize(
    ("change", "key", "value", "allowed"),
    [
        ({"name": None}, "name", None, "string"),
        ({"flash": {}}, "flash.lux", None, "is required but missing"),
        ({"flash": 3}, "flash", 3, "must be"),
        ({"flash": {"lux": 0}}, "flash.lux", 0, "must be greater than 0"),
        ({"flash": {"lux": math.inf}}, "flash.lux", math.inf, "must be a finite number"),
        ({"flash": {"lux": math.nan}}, "flash.lux", None, "must be a finite number"),
        ({"flash": {"lux": [1]}}, "flash.lux", [1], "must be a valid number"),
        ({"flash": {"lux": 1, "kind": "gas"}}, "flash.kind", "gas", "'led' or 'xenon'"),
        ({"flash": {"lux": 1, "kind": {}}}, "flash.kind", None, "'led' or 'xenon'"),
        ({"sizes": [1, 2, "x"]}, "sizes.2", "x", "must be a valid integer"),
        ({"sizes": [2, 1]}, "", None, "sizes must ascend"),
        ({"sizes": [1, 2, 3, 4, 5]}, "sizes", None, "has 5 entries; at most 4 are allowed"),
        ({"size": 1}, "size", None, "is not a known key"),
        ({"": 1}, '""', None, "is not a known key"),
        ({"a.b\n": 1}, '"a.b\\n"', None, "is not a known key"),
    ],
)
def test_error_names_file_key_value_and_what_is_allowed(change, key, value, allowed):
    with pytest.raises(InputError) as caught:
        validate(Camera, GOOD | change, "cam.toml")
    error = caught.value
    assert (error.where, error.key) == ("cam.toml", key)
    assert value is None or error.value == value
    assert allowed in error.problem
    assert str(error).startswith(f"cam.toml: {key}")
    assert str(error).endswith(error.problem)
    assert "\n" not in str(error)


def test_documents_are_frozen():
    camera = validate(Camera, GOOD, "cam.toml")
    with pytest.raises(ValidationError, match="frozen"):
        camera.name = "other"


@given(st.lists(st.text(max_size=5), min_size=1, max_size=4))
def test_only_plain_keys_are_written_without_quotes(parts):
    key = toml_key(tuple(parts))
    assert key.isprintable()
    assert (key == ".".join(parts)) == all(p and p.isprintable() and not set(p) & set(" .\"'") for p in parts)


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (5, "k = 5"),
        ("a\nb", "k = 'a\\nb'"),
        (False, "k = False"),
        (0, "k = 0"),
        (None, "k: "),
        ("x" * 1000, "…"),
    ],
)
def test_message_shows_the_value_on_one_short_line(value, text):
    message = str(InputError("f", "must be better", key="k", value=value))
    assert text in message
    assert message.startswith("f: k")
    assert message.endswith(": must be better")
    assert "\n" not in message
    assert len(message) < 120


def test_values_without_repr_are_shown_by_size_or_type():
    nested = []
    for _ in range(100_000):
        nested = [nested]
    for value, text in (
        (10**5000, "an integer of 16610 bits"),
        (-(10**5000), "an integer of 16610 bits"),
        ([10**5000], "list"),
        (nested, "list"),
    ):
        assert f"k = {text}: " in str(InputError("f", "must be better", key="k", value=value))
    with pytest.raises(InputError, match=r"flash\.lux = an integer of 16610 bits"):
        validate(Camera, GOOD | {"flash": {"lux": 10**5000}}, "cam.toml")


@pytest.mark.parametrize("kind", [InputError, ArgumentError])
def test_errors_can_be_pickled_with_any_value(kind):
    for value, pickled in ((5, 5), (None, None), ([1, 2], "[1, 2]")):
        copy = pickle.loads(pickle.dumps(kind("f", "must be better", key="k", value=value)))
        assert (type(copy), copy.where, copy.problem, copy.key) == (kind, "f", "must be better", "k")
        assert copy.value == pickled
    # A value without a key is left out.
    assert str(kind("seed", "must be better", value=5)) == "seed: must be better"


@pytest.mark.parametrize("name", ["plants", "recipes", "materials"])
def test_shipped_files_are_found_by_name(name):
    suffix = ".csv" if name == "materials" else ".toml"
    for path in shipped_folder(name).glob(f"*{suffix}"):
        assert find_file(name, path.stem, suffix=suffix) == path


def test_bare_name_is_never_a_file_of_the_working_folder(write, monkeypatch):
    path = write("", "kaite.toml")
    monkeypatch.chdir(path.parent)
    assert find_file("plants", path) == path
    assert find_file("plants", "kaite.toml").samefile(path)
    assert find_file("plants", "kaite") == shipped_folder("plants") / "kaite.toml"
    write("", "kaite")
    assert find_file("plants", "kaite") == shipped_folder("plants") / "kaite.toml"


@pytest.mark.parametrize(
    "name", ["keite", "", ".", "..", "nowhere/kaite.toml", "kaite.csv", "../plants/kaite"]
)
def test_missing_file_lists_the_shipped_ones(name):
    with pytest.raises(InputError) as caught:
        find_file("plants", name)
    assert caught.value.where == name
    assert "no such file" in str(caught.value)
    assert "kaite" in caught.value.problem


def test_file_with_another_suffix_is_not_reported_as_missing(write, monkeypatch):
    monkeypatch.chdir(write("", "mine.txt").parent)
    message = r"is a file without the suffix \.toml, nor one of the shipped plants"
    with pytest.raises(InputError, match=message):
        find_file("plants", "mine.txt")
