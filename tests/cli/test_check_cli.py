from __future__ import annotations

import json
import os
import pty
import subprocess
import sys

import numpy as np
import pytest

from pepperscene.dataset import write_image

BUILD = (
    "build", "demo", "--frames", "0:3", "--outputs", "class,instance", "--set", "cultivar=kaite_february",
    "--set", "row.plants_front=1", "--set", "row.plants_back=0",
)  # fmt: skip


@pytest.fixture
def folder(command, tmp_path, monkeypatch):
    """Three frames whose class image shows nothing; a stand-in renders them."""
    from pepperscene.dataset.scenes.frame_renderer import AssembledScene, FrameRenderer
    from pepperscene.geometry import rectangle
    from pepperscene.scene import assemble_scene

    scene = assemble_scene(rectangle((0, 0, 1), (1, 0, 0), (0, 0, 1)))
    monkeypatch.setattr(FrameRenderer, "assemble", lambda *_args, **_kwargs: AssembledScene(scene, {}))
    done = command(
        *BUILD, "--outputs", "class,instance", "--set", "cultivar=kaite_february", "--out", tmp_path / "set"
    )
    assert done.exit_code == 0, done.output
    # The stand-in's pictures are of four by four pixels, the camera's are not.
    for path in sorted((tmp_path / "set" / "frames").glob("*.json")):
        shrunk(path)
    from pepperscene.dataset.store.dataset import open_dataset

    (tmp_path / "set" / "journal.jsonl").unlink(missing_ok=True)
    open_dataset(tmp_path / "set").write_tables()
    return tmp_path / "set"


def shrunk(path):
    from pepperscene.dataset.store.atomic import write_json
    from pepperscene.dataset.store.dataset import checksum_of

    facts = json.loads(path.read_text())
    facts["camera"] |= {"width": 4, "height": 4}
    facts["checksum"] = checksum_of(facts)
    write_json(path, facts)


def test_one_line_when_all_is_well(command, folder):
    done = command("check", folder)
    assert done.exit_code == 0, done.output
    assert done.stdout == f"{folder}: 3 frames without a fault\n"


def test_a_table_and_exit_code_1_when_it_is_not(command, folder):
    (folder / "class/000001.png").unlink()
    for name in "abcde":
        (folder / f"{name}.txt").write_bytes(b"")
    done = command("check", folder, "--rows", 2)
    assert done.exit_code == 1
    heading, *rows, end = done.stdout.splitlines()
    assert heading.split() == ["kind", "frame", "file", "what", "is", "wrong"]
    assert [row.split()[0] for row in rows] == ["missing", "extra", "extra", "extra"]
    assert rows[0].split()[1:3] == ["000001", "class/000001.png"]
    assert rows[-1].split(maxsplit=1)[1] == "... and 3 more"
    assert end == f"{folder}: 3 frames, 6 faults: 1 missing, 5 extra"
    # Columns stand below each other.
    place = heading.index("what")
    assert all(row[place - 1] == " " and row[place] != " " for row in rows)


def test_json_for_scripts(command, folder):
    assert json.loads(command("check", folder, "--json").stdout) == {
        "good": True, "frames": 3, "counts": {}, "findings": [], "notes": [],
    }  # fmt: skip
    write_image(folder / "class/000002.png", np.full((4, 4), 8, np.uint8), "class")
    done = command("check", folder, "--json", "--workers", 1)
    assert done.exit_code == 1
    told = json.loads(done.stdout)
    assert told["counts"] == {"checksum": 1}
    assert {one["index"] for one in told["findings"]} == {2}
    assert {"kind", "index", "file", "what"} == set(told["findings"][0])


def test_frames_that_must_be_there(command, folder):
    assert command("check", folder, "--frames", "0:3").exit_code == 0
    done = command("check", folder, "--frames", "0:4")
    assert done.exit_code == 1
    assert "frames/000003.json" in done.stdout


@pytest.mark.parametrize("arguments", [("nowhere",), (".", "--workers", "0")])
def test_what_cannot_be_checked_is_told_in_one_line(command, folder, monkeypatch, arguments):
    monkeypatch.chdir(folder)
    done = command("check", *arguments)
    assert done.exit_code == 2
    assert len(done.stderr.splitlines()) == 1


def test_markup_in_names_is_shown_as_it_is_on_a_terminal(folder):
    (folder / "[bold]x.txt").write_bytes(b"")
    ours, theirs = pty.openpty()
    code = "import sys; from pepperscene.cli import main; main()"
    child = subprocess.Popen(
        [sys.executable, "-c", code, "check", str(folder)],
        stdout=theirs,
        stderr=subprocess.DEVNULL,
        env={**os.environ, "COLUMNS": "120", "TERM": "xterm"},
    )
    os.close(theirs)
    shown = b""
    while True:
        try:
            part = os.read(ours, 4096)
        except OSError:
            break
        if not part:
            break
        shown += part
    os.close(ours)
    assert child.wait() == 1
    text = shown.decode()
    assert "[bold]x.txt" in text
    assert "┃" in text
