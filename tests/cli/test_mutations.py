"""Mutated recipes and cultivars are valid, or give one line; a build that fails leaves no files."""

from __future__ import annotations

import copy
import math
import tempfile
from pathlib import Path

import pytest
import tomli_w
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from pepperscene.document import read_toml
from pepperscene.errors import PepperError
from pepperscene.recipe.resolve.load import resolve_recipe
from pepperscene.recipe.resolve.load_camera import load_camera
from pepperscene.shipped import shipped_folder

# One short plant without daylight is fast.
RECIPE = read_toml(shipped_folder("recipes") / "barth2018.toml") | {"cultivar": "plant.toml"}
RECIPE["row"] |= {"plants_front": 1, "plants_back": 0}
RECIPE["daylight"]["illuminance_lx"] = 0
RECIPE["camera"] |= {"filter": "schott_22022010", "focus_mm": 400, "gain": 2.0, "bits": 10}
STEPS = ("falloff", "shot_noise", "read_noise", "saturation", "quantise", "colour_matrix")
RECIPE["developing"] |= {"demosaic": "malvar", "tone": "srgb", **dict.fromkeys(STEPS, True)}
CULTIVAR = read_toml(shipped_folder("plants") / "kaite.toml")
CULTIVAR["stem"] |= {"parts": 4, "young_nodes": 2}

NUMBERS = (-1, 0, 1, 2, 40, 10**9, 2**63 - 1, -0.0, 0.5, -5.0, 1e-300, 1e300, math.nan, math.inf, -math.inf)
TEXTS = ("", "x", "1", "none", "nikon_d5100", "bandpass_850nm", "../..", "a\x00b", "q" * 400)
LISTS = ([], [1], [0, 1], [[0, 1, 1.0]], [["a"]])
TABLES = ({}, {"value": 1}, {"value_mm": 3, "chosen": "x"}, {"mean_mm": 1, "sd_mm": 1e9, "source": "x"})
REPLACEMENTS = st.one_of(
    st.sampled_from((*NUMBERS, True, False, *TEXTS, *LISTS, *TABLES)),
    st.floats(),
    st.integers(-(10**6), 10**6),
    st.text(max_size=8),
)


def paths(table, above=()):
    """Path of every key and list item below a table."""
    items = table.items() if isinstance(table, dict) else enumerate(table)
    for key, value in items:
        yield (*above, key)
        if isinstance(value, (dict, list)):
            yield from paths(value, (*above, key))


@st.composite
def mutated(draw, original):
    """A TOML file with up to three mutations, as bytes."""
    tables = copy.deepcopy(original)
    for _ in range(draw(st.integers(0, 3))):
        path = draw(st.sampled_from(sorted(paths(tables), key=str)))
        holder = tables
        for key in path[:-1]:
            holder = holder[key]
        apply_change(draw, holder, path[-1])
        if not tables:
            break
    data = bytearray(tomli_w.dumps(tables).encode())
    damage = draw(st.sampled_from(["none", "none", "none", "cut", "bytes", "line"]))
    at = draw(st.integers(0, max(0, len(data) - 1)))
    if damage == "cut":
        del data[at:]
    elif damage == "bytes":
        data[at:at] = draw(st.binary(min_size=1, max_size=4))
    elif damage == "line":
        lines = bytes(data).split(b"\n")
        del lines[at % len(lines)]
        data = bytearray(b"\n".join(lines))
    return bytes(data)


def apply_change(draw, holder, key):
    change = draw(st.sampled_from(["replace", "replace", "scale", "drop", "rename"]))
    value = holder[key]
    if change == "scale" and isinstance(value, (int, float)):
        holder[key] = value * draw(st.sampled_from([-1, 0, 1e-6, 0.5, 2, 10, 1000]))
    elif change == "drop":
        del holder[key]
    elif change == "rename" and isinstance(holder, dict):
        holder[draw(st.sampled_from([f"{key}_", str(key).replace("_mm", "_cm"), "", "ü"]))] = holder.pop(key)
    else:
        holder[key] = draw(REPLACEMENTS)


def check_values(recipe, cultivar):
    """Resolve a recipe: an error that users can fix is one line."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "mine.toml").write_bytes(recipe)
        (folder / "plant.toml").write_bytes(cultivar)
        message = ""
        try:
            load_camera(resolve_recipe(folder / "mine.toml").recipe)
        except PepperError as error:
            message = str(error)
        assert "\n" not in message


def check_build(command, recipe, cultivar, outputs):
    """Build a frame: an error leaves no file."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "mine.toml").write_bytes(recipe)
        (folder / "plant.toml").write_bytes(cultivar)
        result = command(
            "build", folder / "mine.toml", "--out", folder / "set", "--frames", "0:1", "--outputs", outputs
        )
        if result.exception is not None and not isinstance(result.exception, SystemExit):
            raise result.exception
        created = {path.name for path in folder.iterdir()} - {"mine.toml", "plant.toml"}
        if result.exit_code == 0:
            assert created == {"set"}
            assert (folder / "set" / "frames" / "000000.json").is_file()
        else:
            assert result.exit_code == 2
            assert result.stderr.startswith("error: ")
            assert result.stderr.count("\n") == 1
            assert created == set()


thorough = settings(
    max_examples=150,
    deadline=None,
    derandomize=True,
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.function_scoped_fixture],
)
GOOD_RECIPE = tomli_w.dumps(RECIPE).encode()
GOOD_CULTIVAR = tomli_w.dumps(CULTIVAR).encode()
WITHOUT_PIGMENTS = tomli_w.dumps(
    {key: value for key, value in CULTIVAR.items() if key != "pigments"}
).encode()


def test_files_are_valid_before_mutation(command):
    check_values(GOOD_RECIPE, GOOD_CULTIVAR)
    check_build(command, GOOD_RECIPE, GOOD_CULTIVAR, "class,colour")


@thorough
@given(mutated(RECIPE))
def test_values_of_recipes(recipe):
    check_values(recipe, GOOD_CULTIVAR)


@thorough
@given(mutated(CULTIVAR))
def test_values_of_cultivars(cultivar):
    check_values(GOOD_RECIPE, cultivar)


@settings(thorough, max_examples=4)
@given(mutated(RECIPE), mutated(CULTIVAR), mutated({"pigments": CULTIVAR["pigments"]}))
def test_builds(command, recipe, cultivar, pigments):
    check_build(command, recipe, GOOD_CULTIVAR, "class")
    check_build(command, GOOD_RECIPE, cultivar, "class")
    # Surfaces are needed for colour only.
    check_build(command, GOOD_RECIPE, WITHOUT_PIGMENTS + b"\n" + pigments, "colour")


@pytest.mark.parametrize("digits", [400, 5000])
@pytest.mark.parametrize("file", ["recipe", "cultivar"])
def test_enormous_integers(command, file, digits):
    """TOML integers have 64 bits, Python's any number."""
    number = b"4" + b"0" * digits
    recipe, cultivar = GOOD_RECIPE, GOOD_CULTIVAR
    if file == "recipe":
        recipe = recipe.replace(b"distance_mm = 400", b"distance_mm = " + number)
    else:
        cultivar = cultivar.replace(b"mean_mm = 99\n", b"mean_mm = " + number + b"\n")
    assert (recipe, cultivar) != (GOOD_RECIPE, GOOD_CULTIVAR), "the number to replace is missing"
    check_build(command, recipe, cultivar, "class")
