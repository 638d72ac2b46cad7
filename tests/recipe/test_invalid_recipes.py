"""Invalid views, variation, twins and rigs are one sentence with file and key, before the first frame."""

from __future__ import annotations

import pytest
from invalid_recipes import INVALID
from typer.testing import CliRunner

from pepperscene.cli import app
from pepperscene.errors import InputError
from pepperscene.recipe.resolve.load import load_recipe

SYNTAX_ERROR = "def poses(:\n"
FAULTY_FUNCTIONS = {SYNTAX_ERROR: "is not valid Python", "x = 1\n": "must be a function of the file"}


def write(folder, text):
    path = folder / "mine.toml"
    extended = "greenhouse" if "greenhouse." in text else "barth2018"
    path.write_text(f'extends = "{extended}"\n{text}\n')
    return path


@pytest.mark.parametrize(("text", "key"), INVALID, ids=[text.replace("\n", "; ") for text, _ in INVALID])
def test_invalid_tables_are_one_error_with_the_users_file_and_key(tmp_path, text, key):
    path = write(tmp_path, text)
    with pytest.raises(InputError) as caught:
        load_recipe(path)
    message = str(caught.value)
    assert message.startswith(f"{path}: {key}")
    assert "\n" not in message
    assert caught.value.problem


@pytest.mark.parametrize(("text", "key"), INVALID[::30])
def test_a_build_of_an_invalid_recipe_writes_nothing(tmp_path, text, key):
    path = write(tmp_path, text)
    result = CliRunner().invoke(app, ["build", str(path), "--out", str(tmp_path / "set")])
    assert result.exit_code == 2
    assert isinstance(result.exception, SystemExit)
    assert result.stderr.startswith("error: ")
    assert result.stderr.count("\n") == 1
    assert key in result.stderr
    assert [file.name for file in tmp_path.iterdir()] == ["mine.toml"]


@pytest.mark.parametrize("text", FAULTY_FUNCTIONS)
def test_a_file_without_its_function_is_refused_before_it_is_run(tmp_path, text):
    (tmp_path / "views.py").write_text(text)
    path = write(tmp_path, 'plan.frames = 2\n[views]\nkind = "function"\nfile = "views.py"')
    with pytest.raises(InputError, match=FAULTY_FUNCTIONS[text]):
        load_recipe(path)


def test_a_recipe_is_loaded_without_running_its_function(tmp_path):
    (tmp_path / "views.py").write_text("raise SystemExit(3)\ndef poses(scene, rng): pass\n")
    load_recipe(write(tmp_path, 'plan.frames = 2\n[views]\nkind = "function"\nfile = "views.py"'))


def test_an_error_names_the_file_that_holds_the_key(tmp_path):
    (tmp_path / "parent.toml").write_text(
        'extends = "barth2018"\ncamera.sensor = { ueye_ui5250re = 0.5, nikn = 0.5 }\n'
    )
    child = tmp_path / "child.toml"
    child.write_text('extends = "parent.toml"\ncamera.gain = 2\n')
    with pytest.raises(InputError, match=r"parent\.toml: camera\.sensor = 'nikn'"):
        load_recipe(child)
