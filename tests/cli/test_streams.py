"""Streams that are closed, full or without a reader, odd environments, and names that are not UTF-8."""

from __future__ import annotations

import json
import os
import pty
import shlex
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

import pytest
from command_process import ENTRY, FAST_ENTRY, ONE_PLANT, SEPARATOR, TOGETHER, Command

from pepperscene.dataset.store.dataset import open_dataset

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full and a POSIX shell"),
]

FULL = b"error: standard output: cannot be written (No space left on device)\n"
NO_READER = 141


def shell(redirections, *arguments, entry=ENTRY):
    """Run a command with redirections of the shell; returns exit code, standard output and error."""
    command = Command(
        "-c", f"exec {shlex.join([sys.executable, *entry, *arguments])} {redirections}",
        entry=("-c", "import os, sys; os.execv('/bin/sh', ['sh', *sys.argv[1:]])"),
    )  # fmt: skip
    return command.finish()


def build(folder, *more):
    return ("build", "barth2018", "--out", str(folder), *ONE_PLANT, "--outputs", "class", *more)


@pytest.mark.long
@pytest.mark.parametrize(
    "redirections",
    ["1>&-", "--workers 2 0<&- 1>&- 2>&-", "2>/dev/full", "1</dev/null 2</dev/null", "--json 2>&-"],
)
def test_builds_whose_messages_cannot_be_written_are_complete(tmp_path, redirections):
    entry = ENTRY if "--workers" in redirections else FAST_ENTRY
    code, output, _ = shell(redirections, *build(tmp_path / "set"), entry=entry)
    # A standard output that refuses the result is an error, but only after the build.
    assert code == (2 if "1<" in redirections else 0)
    dataset = open_dataset(tmp_path / "set")
    assert dataset.manifest()["index"].to_pylist() == [0, 1]
    assert all(dataset.intact(index).outputs for index in (0, 1))
    if "--json" in redirections:
        assert [json.loads(line)["event"] for line in output.splitlines()] == ["frame", "frame", "end"]
    # No message was written into a file that was opened instead of a stream.
    assert not [path for path in tmp_path.rglob("*.json*") if b"built" in path.read_bytes()]


def test_a_full_standard_output_is_one_sentence_and_keeps_frames(tmp_path):
    assert shell(">/dev/full", *build(tmp_path / "set", "--json"), entry=FAST_ENTRY) == (2, b"", FULL)
    assert 0 < len(open_dataset(tmp_path / "set").manifest()) <= 2


def test_every_full_standard_output_is_one_sentence():
    assert shell(">/dev/full", "--help") == (2, b"", FULL)


@pytest.mark.parametrize("stream", ["stdout", pytest.param("stderr", marks=pytest.mark.long)])
def test_a_build_whose_progress_has_no_reader_stops_and_keeps_frames(tmp_path, stream):
    more = ("--json",) if stream == "stdout" else ()
    arguments = build(tmp_path / "set", "--set", "plan.frames=100", *more)
    command = Command(*arguments, entry=FAST_ENTRY, environment={"STAND_IN_S": "0.05"})
    pipe = getattr(command.process, stream)
    assert b"frame" in pipe.readline()
    pipe.close()
    setattr(command.process, stream, None)
    code, output, errors = command.finish()
    assert (code, output, errors) == (NO_READER, b"", b"")
    assert 0 < len(open_dataset(tmp_path / "set").manifest()) < 100
    assert command.remaining() == []


def test_a_list_without_a_reader_ends_quietly():
    command = Command("recipes")
    command.process.stdout.close()
    command.process.stdout = None
    assert command.finish() == (NO_READER, b"", b"")


HOSTILE = {
    "HOME": "/proc/none", "TMPDIR": "/proc/none", "LC_ALL": "C", "LANG": None, "TERM": None, "COLUMNS": "0",
    "PYTHONUNBUFFERED": "1", "PYTHONIOENCODING": "ascii",
}  # fmt: skip


@pytest.mark.long
def test_an_odd_environment_changes_nothing(tmp_path):
    folder = tmp_path / "Bärenklau √2"
    code, output, errors = Command(*build(folder), environment=HOSTILE).finish()
    assert code == 0, errors.decode()
    assert output.decode() == f"2 frames built: {folder}\n"
    arguments = ("report", str(folder), "--limit", "1")
    code, _, errors = Command(*arguments, environment={"HOME": None, "COLUMNS": "x", "TERM": "dumb"}).finish()
    assert (code, errors) == (0, b"")


@pytest.mark.parametrize(
    ("encoding", "expected"), [("latin-1", b"\\u221a\xe9\xe9\n"), ("utf-8:strict", "√é".encode() + b"\xe9\n")]
)
def test_characters_that_an_encoding_lacks_are_no_error(encoding, expected):
    code = (
        "import typer\n"
        "from pepperscene.cli.application import protect_streams\n"
        "protect_streams()\n"
        "typer.echo('√' + 'é' + chr(0xdce9))"
    )
    command = Command(entry=("-c", code), environment={"PYTHONIOENCODING": encoding})
    assert command.finish() == (0, expected, b"")


@pytest.mark.long
@pytest.mark.parametrize(
    "environment",
    [{"TERM": "dumb", "COLUMNS": "x"}, {"TERM": None}, {"TERM": "xterm", "COLUMNS": "0"}],
    ids=str,
)
def test_a_terminal_of_any_kind_shows_progress(tmp_path, environment):
    parent, child = pty.openpty()
    command = Command(*build(tmp_path / "set"), entry=FAST_ENTRY, environment=environment, stderr=child)
    os.close(child)
    shown = b""
    # A terminal reports its end as an error.
    with suppress(OSError):
        while part := os.read(parent, 4096):
            shown += part
    os.close(parent)
    code, output, _ = command.finish()
    assert (code, output.decode()) == (0, f"2 frames built: {tmp_path / 'set'}\n")
    assert b"Traceback" not in shown


@pytest.mark.long
def test_a_terminal_that_disappears_does_not_stop_a_build(tmp_path):
    parent, child = pty.openpty()
    arguments = build(tmp_path / "set", "--set", "plan.frames=5")
    command = Command(*arguments, entry=FAST_ENTRY, environment={"STAND_IN_S": "0.1"}, stderr=child)
    os.close(child)
    os.close(parent)
    assert command.finish()[0] == 0
    assert len(open_dataset(tmp_path / "set").manifest()) == 5


def test_a_removed_current_folder_is_one_sentence(tmp_path):
    script = 'mkdir gone && cd gone && rmdir ../gone && exec "$@"'
    folder = str(tmp_path / "set")
    command = ["sh", "-c", script, "sh", sys.executable, "-m", "pepperscene", "render", "--out", folder]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True)
    assert done.returncode == 2
    assert done.stderr.startswith(b"error: the current folder does not exist any more")
    assert done.stderr.count(b"\n") == 1
    assert list(tmp_path.iterdir()) == []


NAME = b"caf\xe9"
SMALL = ("--set", "camera.width=200", "--set", "camera.height=150")


@pytest.mark.long
def test_names_that_are_not_utf8(tmp_path):
    """Standard output has the bytes of the names."""
    folder = os.path.join(os.fsencode(tmp_path), NAME)
    forms = ("published", "coco", "yolo", "webdataset", "huggingface", "nerfstudio", "colmap", "ply", "rgbd")
    options = ("--outputs", "colour,class,instance,distance", "--quality", "draft", *SMALL)
    commands = [
        build(os.fsdecode(folder), *options),
        (*build(os.fsdecode(folder), *options), "--json"),
        ("check", folder),
        ("report", folder, "--beside", folder),
        ("compare", folder, folder, "--figure", folder + b".svg"),
        ("render", "barth2018", *ONE_PLANT, "--outputs", "class,distance", "--out", folder + b"_one"),
        ("plant", "kaite_february", "--detail", "0.3", "--no-picture", "--out", folder + b".obj"),
        *(("export", folder, "--format", form, "--out", folder + form.encode()) for form in forms),
    ]
    words = [word for arguments in commands for word in (*arguments, SEPARATOR)]
    code, output, errors = Command(*words, entry=TOGETHER).finish()
    assert code == 0, errors.decode()
    made, again, checked, reported, _, one, grown, *exported, rest = output.split(b"\0")
    assert (made, rest) == (b"2 frames built: " + folder + b"\n", b"")
    assert json.loads(again.splitlines()[-1])["folder"] == os.fsdecode(folder)
    assert checked == folder + b": 2 frames, no faults\n"
    assert folder + b"/index.html" in reported
    assert rb"caf\udce9" in Path(os.fsdecode(folder), "index.html").read_bytes()
    assert os.path.getsize(folder + b".svg")
    assert one.splitlines()[0] == folder + b"_one/class.png"
    assert grown.splitlines()[-2:] == [folder + b".obj", folder + b".mtl"]
    assert b"mtllib " + NAME + b".mtl\n" in Path(os.fsdecode(folder + b".obj")).read_bytes()
    for text, form in zip(exported, forms, strict=True):
        assert text.endswith(b": " + folder + form.encode() + b"\n")
        assert os.listdir(folder + form.encode())
    # A recipe is a TOML file, which is UTF-8.
    tune = ("tune", "demo", "--fit", "leaf.chlorophyll", "--patches", folder, "--out", folder + b"_tuned")
    missing = ("check", folder + b"x")
    for arguments, message in (
        (tune, b"--out: must be a name in UTF-8"),
        (missing, rb"caf\udce9x: holds no"),
    ):
        code, output, errors = Command(*arguments).finish()
        assert (code, output) == (2, b"")
        assert message in errors
