"""Builds of changed recipes and cultivars: an error is one line and leaves no files."""

from __future__ import annotations

import tempfile
from pathlib import Path

import pytest
import tomli_w
from fuzzing import EDITS, mutated
from hypothesis import given, settings

from pepperscene.document import read_toml
from pepperscene.shipped import shipped_folder

# One short plant without daylight is fast.
RECIPE = read_toml(shipped_folder("recipes") / "barth2018.toml") | {"cultivar": "plant.toml"}
RECIPE["row"] |= {"plants_front": 1, "plants_back": 0}
RECIPE["daylight"]["illuminance_lx"] = 0
CULTIVAR = read_toml(shipped_folder("plants") / "kaite.toml")
CULTIVAR["stem"] |= {"parts": 4, "young_nodes": 2}
PIGMENTS = tomli_w.dumps({"pigments": CULTIVAR.pop("pigments")}).encode()
GOOD_RECIPE, WITHOUT_PIGMENTS = tomli_w.dumps(RECIPE).encode(), tomli_w.dumps(CULTIVAR).encode() + b"\n"
GOOD_CULTIVAR = WITHOUT_PIGMENTS + PIGMENTS


def build_of(command, recipe, cultivar, outputs):
    """Build a frame: an error leaves no file; returns the exit code."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "mine.toml").write_bytes(recipe)
        (folder / "plant.toml").write_bytes(cultivar)
        options = ("--out", folder / "set", "--frames", "0:1", "--outputs", outputs)
        result = command("build", folder / "mine.toml", *options)
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
        return result.exit_code


@pytest.mark.parametrize("examples", [3, pytest.param(300, marks=pytest.mark.long)])
def test_builds_of_changed_files(command, examples):
    assert build_of(command, GOOD_RECIPE, GOOD_CULTIVAR, "class,colour") == 0

    @settings(max_examples=examples)
    @given(EDITS)
    def check(edits):
        build_of(command, mutated(GOOD_RECIPE, edits), GOOD_CULTIVAR, "class")
        build_of(command, GOOD_RECIPE, mutated(GOOD_CULTIVAR, edits), "class")
        # Surfaces are needed for colour only.
        build_of(command, GOOD_RECIPE, WITHOUT_PIGMENTS + mutated(PIGMENTS, edits), "colour")

    check()


def test_enormous_integers(command):
    """TOML integers have 64 bits, Python's any number."""
    number = b"4" + b"0" * 5000
    recipe = GOOD_RECIPE.replace(b"distance_mm = 400", b"distance_mm = " + number)
    cultivar = GOOD_CULTIVAR.replace(b"mean_mm = 99\n", b"mean_mm = " + number + b"\n")
    assert len(recipe) > len(GOOD_RECIPE)
    assert len(cultivar) > len(GOOD_CULTIVAR)
    assert build_of(command, recipe, GOOD_CULTIVAR, "class") == 2
    assert build_of(command, GOOD_RECIPE, cultivar, "class") == 2
