"""`pepperscene check`: results as a line, a table or JSON, and exit codes."""

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
    """Three frames with empty class images, by the stub renderer."""
    from pepperscene.dataset.scenes.frame_renderer import AssembledScene, FrameRenderer
    from pepperscene.geometry import rectangle
    from pepperscene.scene import assemble_scene

    scene = assemble_scene(rectangle((0, 0, 1), (1, 0, 0), (0, 0, 1)))
    monkeypatch.setattr(FrameRenderer, "assemble", lambda *_args, **_kwargs: AssembledScene(scene, {}))
    done = command(
        *BUILD, "--outputs", "class,instance", "--set", "cultivar=kaite_february", "--out", tmp_path / "set"
    )
    assert done.exit_code == 0, done.output
    # The images of the stub renderer have four by four pixels.
    for path in sorted((tmp_path / "set" / "frames").glob("*.json")):
        set_camera_size(path)
    from pepperscene.dataset.store.dataset import open_dataset

    (tmp_path / "set" / "journal.jsonl").unlink(missing_ok=True)
    open_dataset(tmp_path / "set").write_tables()
    return tmp_path / "set"


def set_camera_size(path):
    from pepperscene.dataset.store.atomic import write_json
    from pepperscene.dataset.store.dataset import checksum_of

    facts = json.loads(path.read_text())
    facts["camera"] |= {"width": 4, "height": 4}
    facts["checksum"] = checksum_of(facts)
    write_json(path, facts)


def test_valid_set_gives_one_line(command, folder):
    done = command("check", folder)
    assert done.exit_code == 0, done.output
    assert done.stdout == f"{folder}: 3 frames, no faults\n"


def test_faults_give_a_table_and_exit_code_1(command, folder):
    (folder / "class/000001.png").unlink()
    for name in "abcde":
        (folder / f"{name}.txt").write_bytes(b"")
    done = command("check", folder, "--rows", 2)
    assert done.exit_code == 1
    heading, *rows, end = done.stdout.splitlines()
    assert heading.split() == ["kind", "frame", "file", "problem"]
    assert [row.split()[0] for row in rows] == ["missing", "extra", "extra", "extra"]
    assert rows[0].split()[1:3] == ["000001", "class/000001.png"]
    assert rows[-1].split(maxsplit=1)[1] == "... and 3 more"
    assert end == f"{folder}: 3 frames, 6 faults: 1 missing, 5 extra"
    # Columns are aligned.
    place = heading.index("problem")
    assert all(row[place - 1] == " " and row[place] != " " for row in rows)


def test_json_output(command, folder):
    assert json.loads(command("check", folder, "--json").stdout) == {
        "good": True, "frames": 3, "counts": {}, "findings": [], "notes": [],
    }  # fmt: skip
    write_image(folder / "class/000002.png", np.full((4, 4), 8, np.uint8), "class")
    done = command("check", folder, "--json", "--workers", 1)
    assert done.exit_code == 1
    result = json.loads(done.stdout)
    assert result["counts"] == {"checksum": 1}
    assert {finding["index"] for finding in result["findings"]} == {2}
    assert {"kind", "index", "file", "what"} == set(result["findings"][0])


def test_reports_missing_frames(command, folder):
    assert command("check", folder, "--frames", "0:3").exit_code == 0
    done = command("check", folder, "--frames", "0:4")
    assert done.exit_code == 1
    assert "frames/000003.json" in done.stdout


@pytest.mark.parametrize("arguments", [("nowhere",), (".", "--workers", "0")])
def test_invalid_arguments_give_one_line(command, folder, monkeypatch, arguments):
    monkeypatch.chdir(folder)
    done = command("check", *arguments)
    assert done.exit_code == 2
    assert len(done.stderr.splitlines()) == 1


def test_terminal_does_not_interpret_markup_in_file_names(folder):
    (folder / "[bold]x.txt").write_bytes(b"")
    master, terminal = pty.openpty()
    code = "import sys; from pepperscene.cli import main; main()"
    child = subprocess.Popen(
        [sys.executable, "-c", code, "check", str(folder)],
        stdout=terminal,
        stderr=subprocess.DEVNULL,
        env={**os.environ, "COLUMNS": "120", "TERM": "xterm"},
    )
    os.close(terminal)
    output = b""
    while True:
        try:
            part = os.read(master, 4096)
        except OSError:
            break
        if not part:
            break
        output += part
    os.close(master)
    assert child.wait() == 1
    text = output.decode()
    assert "[bold]x.txt" in text
    assert "┃" in text
