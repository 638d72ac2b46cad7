"""Where commands write: not into a data set; unforeseen system errors; the frames of a dry run."""

from __future__ import annotations

import errno
import os

import pytest

from pepperscene.atomic import check_can_create, check_can_write
from pepperscene.cli import building
from pepperscene.errors import EXIT_BAD_INPUT, OutputError


@pytest.fixture(scope="module")
def data_set(tmp_path_factory):
    """The folder of a data set, as far as other commands know one."""
    folder = tmp_path_factory.mktemp("sets") / "set"
    (folder / "frames").mkdir(parents=True)
    (folder / "colour").mkdir()
    (folder / "dataset.json").write_text("{}")
    return folder


def files_of(folder):
    return sorted(str(path) for path in folder.rglob("*"))


DRY = ("build", "demo", "--dry-run", "--no-probe")
COMMANDS = {
    "visibility": ("visibility", "demo", "--out", "{}/seen.parquet"),
    "drawing": (*DRY, "--drawing", "{}/plan.png"),
    "folder of the drawing": (*DRY, "--drawing", "{}"),
    "poses": (*DRY, "--poses", "{}/poses.csv"),
    "plant": ("plant", "kaite", "--out", "{}/plant.glb"),
    "render": ("render", "demo", "--out", "{}"),
    "scene": ("scene", "demo", "--out", "{}/scene.glb"),
    "model": ("scene", "demo", "--out", "{}/scene.sdf"),
    "bench": ("bench", "--out", "{}/bench"),
}


@pytest.mark.parametrize("name", COMMANDS)
def test_commands_do_not_write_into_a_data_set(name, data_set, rejects):
    before = files_of(data_set)
    for inside in ("", "/colour"):
        rejects("data set", *(word.format(f"{data_set}{inside}") for word in COMMANDS[name]))
    assert files_of(data_set) == before


def test_folders_of_all_commands_are_checked(data_set, tmp_path):
    # All commands that write check their folder or their files with these functions.
    for folder in (data_set, data_set / "new", data_set / "colour" / "deep" / "er"):
        with pytest.raises(OutputError, match="the data set"):
            check_can_create(folder)
        with pytest.raises(OutputError, match="the data set"):
            check_can_write(folder, ["a.txt"])
    check_can_create(data_set, is_data_set=True)
    check_can_create(data_set.parent / "beside")
    # A link into a data set is one, too.
    (tmp_path / "link").symlink_to(data_set)
    with pytest.raises(OutputError, match="the data set"):
        check_can_create(tmp_path / "link" / "new")
    # A file of that name alone makes no data set.
    (tmp_path / "dataset.json").write_text("{}")
    check_can_create(tmp_path / "new")


def fail(*_args, **_kwargs):
    raise OSError(errno.EMFILE, os.strerror(errno.EMFILE), "/some/file")


def fail_silently(*_args):
    raise TimeoutError


def test_a_system_error_names_its_number_and_file_and_has_a_traceback_on_demand(command, monkeypatch):
    monkeypatch.setattr(building, "parse_outputs", fail)
    monkeypatch.delenv("PEPPERSCENE_TRACEBACK", raising=False)
    result = command("render", "demo", "--out", "out")
    assert result.exit_code == EXIT_BAD_INPUT
    assert result.stderr.count("\n") == 1
    assert result.stderr.startswith("error: /some/file: Too many open files")
    assert str(int(errno.EMFILE)) in result.stderr
    assert "PEPPERSCENE_TRACEBACK=1" in result.stderr
    monkeypatch.setenv("PEPPERSCENE_TRACEBACK", "1")
    result = command("render", "demo", "--out", "out")
    assert result.exit_code == EXIT_BAD_INPUT
    assert "Traceback (most recent call last)" in result.stderr
    assert "in fail" in result.stderr
    monkeypatch.delenv("PEPPERSCENE_TRACEBACK")
    monkeypatch.setattr(building, "parse_outputs", fail_silently)
    assert command("render", "demo", "--out", "out").stderr.startswith("error: TimeoutError")
