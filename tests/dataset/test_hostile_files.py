"""Devices, pipes, endless, expanding and misplaced files: one sentence or a finding, in little memory."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from hostile_files import CONTENTS, SET_FILES, TARGETS

from pepperscene.camera.optics.calibration import read_calibration
from pepperscene.camera.pose_files.formats import read_poses
from pepperscene.dataset.readers.pictures import read_photo
from pepperscene.dataset.store.journal import JOURNAL
from pepperscene.document import read_toml
from pepperscene.errors import InputError, PepperError
from pepperscene.recipe.resolve.load import load_recipe

NAMED = [f"{target.__name__} as " for target in TARGETS]
DAMAGED = ["device", "pipe", "sparse", "outside"]
FOLDERS = [name for name in SET_FILES if "/" in name]
READ_BY = {
    "report": ("dataset.json", *FOLDERS[:2]),
    "export": ("dataset.json", "frames/000000.json"),
    "read": ("dataset.json", *FOLDERS),
    "tables": ("dataset.json",),
}
"""The files of a set that each operation needs, of which it says what is wrong."""


def is_sentence(message):
    return bool(message) and "\n" not in message and len(message) < 2000


@pytest.fixture(scope="module")
def outcomes(tmp_path_factory, small):
    """What came of each case, by its name, in a process that may use 300 MB."""
    folder = tmp_path_factory.mktemp("hostile")
    shutil.copytree(small.folder, folder / "set")
    program = Path(__file__).parents[1] / "support" / "hostile_files.py"
    result = subprocess.run(
        [sys.executable, program], cwd=folder, capture_output=True, text=True, timeout=300
    )
    lines = [json.loads(line) for line in result.stdout.splitlines()]
    assert result.returncode == 0, f"after {lines[-1:]}: {result.stderr[-2000:]}"
    return {line["name"]: line for line in lines}


@pytest.mark.long
def test_every_case_ends_in_one_sentence(outcomes):
    assert [case for case in outcomes.values() if "fault" in case] == []
    named = [name for name in outcomes if name.startswith(tuple(NAMED))]
    assert len(named) > 20 * len(NAMED)
    needed = [
        f"{operation} with {target} as {file}"
        for operation, files in READ_BY.items()
        for target in (*DAMAGED, "outside_folder")
        for file in files
        if target != "outside_folder" or file in FOLDERS
    ]
    for name in (*named, *CONTENTS, *needed):
        assert is_sentence(outcomes[name].get("error")), name
    assert all(name.partition(".")[0] in outcomes[name]["error"] for name in CONTENTS)


@pytest.mark.long
def test_check_names_a_file_that_is_none_of_the_set(outcomes):
    reasons = {"sparse": "is longer than", "pipe": "regular file"}
    # Nothing depends on the journal, so the check does not read it.
    files = [file for file in SET_FILES if file != JOURNAL]
    cases = [(target, file) for target in DAMAGED for file in files]
    for target, file in (*cases, *(("outside_folder", file) for file in FOLDERS)):
        case = outcomes[f"check with {target} as {file}"]
        findings = case["result"] if "result" in case else [case["error"]]
        reason = reasons.get(target, "leads out of")
        assert any(file in finding and reason in finding for finding in findings), (target, file)


@pytest.mark.parametrize("target", TARGETS)
def test_what_is_no_regular_file_or_too_long_is_refused(target, tmp_path):
    path = tmp_path / "a.toml"
    target(path)
    reason = "longer than|Is a directory" if target.__name__ in ("sparse", "folder") else "regular file"
    for read in (read_toml, read_photo):
        with pytest.raises(InputError, match=reason):
            read(path)


@pytest.mark.parametrize("name", ["aliases.yaml", "deep.json", "key.toml"])
def test_content_that_expands_is_refused(name, tmp_path):
    path = tmp_path / name
    path.write_text(CONTENTS[name])
    read = {".yaml": read_calibration, ".json": read_poses, ".toml": read_toml}[path.suffix]
    with pytest.raises(InputError) as caught:
        read(path)
    assert is_sentence(str(caught.value))


@pytest.mark.parametrize("name", ["class", "frames", "dataset.json", "frames/000000.json"])
def test_build_refuses_a_set_that_leads_elsewhere(build_small, tmp_path, name):
    build_small(frames="0:1")
    path = tmp_path / "set" / name
    elsewhere = path.rename(tmp_path / "elsewhere")
    path.symlink_to(elsewhere)
    with pytest.raises(PepperError, match="leads out of the data set"):
        build_small(frames="0:2")


def test_links_inside_a_set_are_followed(build_small, tmp_path):
    dataset = build_small(frames="0:1").dataset
    path = dataset.path(0, "class")
    path.rename(tmp_path / "set" / "class" / "kept.png")
    path.symlink_to("kept.png")
    assert dataset.image(0, "class").dtype == "uint8"


def test_files_that_a_user_names_may_be_links(tmp_path):
    (tmp_path / "a.toml").write_text("key = 1\n", encoding="utf-8")
    (tmp_path / "b.toml").symlink_to(tmp_path / "a.toml")
    assert read_toml(tmp_path / "b.toml") == {"key": 1}


def test_each_number_of_a_long_list_is_checked(write_recipe):
    numbers = [100 + number / 1000 for number in range(2_000)]
    recipe = load_recipe(write_recipe(camera={"exposure_us": {"in_turn": numbers}}))
    assert recipe.variation[0].value(0.0, 1_999) == numbers[-1]
    numbers[1_234] = -5.0
    with pytest.raises(InputError, match=r"camera.exposure_us = -5.0: must be"):
        load_recipe(write_recipe(camera={"exposure_us": {"in_turn": numbers}}))


@pytest.mark.parametrize("shared", [["x"] * 12, {"a": 1, "b": 2}, ("x",) * 12], ids=["list", "dict", "tuple"])
def test_messages_show_the_beginning_of_a_value_without_its_whole_repr(shared):
    value = shared
    for _ in range(20):
        value = [value] * 12
    assert "k = [[[[[[[[" in str(InputError("f", "must be a number", key="k", value=value))
