"""What a killed export leaves blocks no other; the hint for missing outputs is a valid command."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest
from stand_in import PYTHONPATH

from pepperscene.errors import InputError, OutputError
from pepperscene.export import export_dataset, run
from pepperscene.recipe.resolve.load import resolve_recipe

_SCRIPT = """
import os, signal, sys
from pepperscene.export import export_dataset
export_dataset(sys.argv[1], "semantic", sys.argv[2], on_frame=lambda *_: os.kill(os.getpid(), signal.SIGKILL))
"""


@pytest.mark.skipif(os.name != "posix", reason="needs signals")
@pytest.mark.parametrize("exists", [True, False])
def test_the_leftovers_of_a_killed_export_are_removed(painted, tmp_path, exists):
    out = tmp_path / "out"
    if exists:
        out.mkdir()
    environment = {**os.environ, "PYTHONPATH": PYTHONPATH}
    process = subprocess.run(
        [sys.executable, "-c", _SCRIPT, str(painted.folder), str(out)], env=environment, timeout=60
    )
    assert process.returncode == -9
    left = list((out if exists else tmp_path).glob(".*.tmp"))
    assert len(left) == 1
    export_dataset(painted.folder, "semantic", out)
    assert not left[0].exists()
    assert not list(out.glob(".*"))


def test_the_files_of_a_running_export_are_kept(painted, tmp_path):
    out = tmp_path / "out"
    out.mkdir()

    def start_another(*_):
        with pytest.raises(OutputError, match="choose an empty or a new folder"):
            export_dataset(painted.folder, "semantic", out)

    export_dataset(painted.folder, "semantic", out, on_frame=start_another)
    assert not list(out.glob(".*"))


def adding_command(recipe, quality="standard"):
    """The hint of a set that was built with a recipe."""
    info = {"recipe": dict(recipe.identity)["recipe"], "quality": quality}
    return run._adding_command(SimpleNamespace(info=info, folder=Path("my set")), "depth_z")


def test_the_hint_of_a_shipped_recipe_is_complete():
    expected = "`pepperscene build demo --out 'my set' --outputs depth_z` adds it"
    assert adding_command(resolve_recipe("demo")) == expected


@pytest.mark.parametrize("case", ["own", "changed", "quality"])
def test_the_hint_names_no_recipe_that_would_not_add_to_the_set(case, tmp_path):
    recipe, quality = "demo", "standard"
    if case == "own":
        recipe = tmp_path / "mine.toml"
        recipe.write_text('extends = "demo"\nname = "demo"\nseed = 7\n')
    if case == "quality":
        quality = "draft"
    changes = {"seed": 9} if case == "changed" else {}
    expected = (
        "`pepperscene build RECIPE --out 'my set' --outputs depth_z` adds it, with the recipe and the options"
    )
    assert adding_command(resolve_recipe(recipe, changes), quality).startswith(expected)


def test_a_missing_output_is_named_with_the_hint(painted, copied, tmp_path):
    folder = copied(painted).folder
    (folder / "distance" / "000003.exr").unlink()
    with pytest.raises(
        InputError, match=r"no output 'distance', .*`pepperscene build RECIPE .*` adds it, with the"
    ):
        export_dataset(folder, "rgbd", tmp_path / "out")
