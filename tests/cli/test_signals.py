"""Signals at any moment: one line, 128 plus the number of the signal, complete files, no process left."""

from __future__ import annotations

import json
import os
import pty
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from command_process import FAST_ENTRY, ONE_PLANT, SOURCES, Command, messages

from pepperscene.dataset.store.dataset import open_dataset
from pepperscene.review.check import check_dataset

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="finds processes in /proc"),
]

LABELS = (*ONE_PLANT, "--outputs", "class,instance")
COLOUR = (*ONE_PLANT, "--outputs", "class,colour", "--quality", "draft")


def interrupt(command, number, after_s=0.0):
    """Send a signal some seconds after the handlers are there; returns exit code and standard error."""
    command.wait_for_handlers()
    time.sleep(after_s)
    command.process.send_signal(number)
    code, _, errors = command.finish()
    return code, errors


def check_interrupted(command, code, errors, number):
    """An interrupted command has its exit code and one line, and leaves no process."""
    lines = messages(errors)
    assert code == 128 + number, errors.decode()
    assert len(lines) == 1, errors.decode()
    assert lines[0].startswith("interrupted")
    assert command.remaining() == []


def test_a_signal_at_any_moment_gives_one_line_and_its_exit_code(tmp_path):
    moments = np.geomspace(0.02, 2.5, 4)
    for number, group in zip((signal.SIGINT, signal.SIGTERM), np.array_split(moments, 2), strict=True):
        commands = [
            Command("build", "demo", "--out", str(tmp_path / str(n)), "--frames", "0:2", "--outputs", "class")
            for n in range(len(group))
        ]
        start = time.monotonic()
        for command, moment in zip(commands, group, strict=True):
            time.sleep(max(0.0, start + moment - time.monotonic()))
            command.wait_for_handlers()
            command.process.send_signal(number)
        for command in commands:
            code, _, errors = command.finish()
            check_interrupted(command, code, errors, number)
        assert not any(path.is_dir() for path in tmp_path.iterdir())


@pytest.mark.parametrize(
    "arguments", [("--help",), ("bench", "--out", "b", "--quick")], ids=lambda arguments: arguments[0]
)
def test_every_command_ends_at_a_signal_while_it_is_imported(arguments, tmp_path):
    command = Command(*arguments, cwd=tmp_path)
    code, errors = interrupt(command, signal.SIGTERM, 0.01)
    check_interrupted(command, code, errors, signal.SIGTERM)
    assert list(tmp_path.iterdir()) == []


def test_a_terminal_that_is_closed_ends_a_command_and_nohup_prevents_it():
    # The tests themselves may run under nohup.
    previous = signal.signal(signal.SIGHUP, signal.SIG_DFL)
    try:
        command = Command("cultivars")
        signal.signal(signal.SIGHUP, signal.SIG_IGN)
        protected = Command("cultivars")
    finally:
        signal.signal(signal.SIGHUP, previous)
    code, errors = interrupt(command, signal.SIGHUP)
    check_interrupted(command, code, errors, signal.SIGHUP)
    assert interrupt(protected, signal.SIGHUP) == (0, b"")


@pytest.mark.parametrize(
    "workers",
    [pytest.param((), id="serial"), pytest.param(("--workers", "2"), id="workers", marks=pytest.mark.long)],
)
def test_an_interrupted_build_keeps_its_frames_and_is_resumed(tmp_path, workers):
    folder = tmp_path / "set"
    arguments = ("build", "barth2018", "--out", str(folder), *LABELS, "--set", "plan.frames=40", *workers)
    options = {} if workers else {"entry": FAST_ENTRY, "environment": {"STAND_IN_S": "0.05"}}
    command = Command(*arguments, "--json", **options)
    assert json.loads(command.process.stdout.readline())["event"] == "frame"
    code, errors = interrupt(command, signal.SIGTERM)
    check_interrupted(command, code, errors, signal.SIGTERM)
    assert b"run the same command again" in errors
    kept = len(open_dataset(folder).indices())
    assert 0 < kept < 40
    assert (folder / "manifest.parquet").is_file()
    assert not list(folder.rglob("*.tmp"))
    code, output, errors = Command(*arguments, "--json", **options).finish()
    assert code == 0, errors.decode()
    end = json.loads(output.splitlines()[-1])
    assert (end["made"], end["kept"]) == (40 - kept, kept)


def test_an_interrupt_restores_the_terminal(tmp_path):
    parent, child = pty.openpty()
    command = Command(
        "build", "barth2018", "--out", str(tmp_path / "set"), *LABELS, "--set", "plan.frames=200",
        entry=FAST_ENTRY, environment={"STAND_IN_S": "0.1", "TERM": "xterm", "COLUMNS": "200"}, stderr=child,
    )  # fmt: skip
    os.close(child)
    shown = b""
    while b"/200" not in shown:
        shown += os.read(parent, 4096)
    command.process.send_signal(signal.SIGINT)
    while b"interrupted" not in shown:
        shown += os.read(parent, 4096)
    os.set_blocking(parent, False)
    assert command.finish()[0] == 130
    os.close(parent)
    # The cursor is hidden while the bar is shown.
    assert shown.rindex(b"\x1b[?25h") > shown.rindex(b"\x1b[?25l")


_COMMAND = """
import sys, threading
import typer
from pepperscene.cli.application import app, handle_errors, main
from pepperscene.interrupts import raise_if_interrupted
wait = threading.Event().wait
def wait_for_signal():
    while True:
        wait(0.01)
        raise_if_interrupted()
@app.command()
@handle_errors
def wait_for_signals():
{body}
main()
"""


def start_waiting(body):
    """A command with this code; it prints `ready` when it waits for a signal."""
    code = _COMMAND.format(body="\n".join(f"    {line}" for line in body.splitlines()))
    command = Command("wait-for-signals", entry=("-c", code), environment={"PYTHONPATH": SOURCES})
    assert command.process.stdout.readline() == b"ready\n"
    return command


CLEANUP = (
    "try:\n"
    "    print('ready', flush=True)\n"
    "    wait_for_signal()\n"
    "finally:\n"
    "    print('cleaning', flush=True)\n"
    "    wait(1)\n"
    "    print('clean', flush=True)"
)


@pytest.mark.parametrize(("signals", "rest"), [(2, b"clean\n"), (3, b"")])
def test_a_second_signal_does_not_break_the_cleanup_and_a_third_ends_it(signals, rest):
    command = start_waiting(CLEANUP)
    command.process.send_signal(signal.SIGTERM)
    assert command.process.stdout.readline() == b"cleaning\n"
    for _ in range(signals - 1):
        command.process.send_signal(signal.SIGTERM)
        time.sleep(0.1)
    code, output, _ = command.finish()
    # Without the start of `pepperscene.__main__` the third signal has its usual effect.
    assert code == (143 if rest else -signal.SIGTERM)
    assert output == rest


@pytest.mark.long
def test_programs_that_import_the_package_keep_their_signal_handlers(tmp_path):
    code = (
        "import signal, sys, stand_in\n"
        "names = ('SIGINT', 'SIGTERM', 'SIGHUP', 'SIGALRM', 'SIGPIPE')\n"
        "handlers = lambda: [signal.getsignal(getattr(signal, name)) for name in names]\n"
        "before, streams = handlers(), (sys.stdout, sys.stderr)\n"
        "import pepperscene, pepperscene.cli, pepperscene.__main__\n"
        "for name in pepperscene.__all__: getattr(pepperscene, name)\n"
        "from pepperscene import BuildOptions, build, load_recipe\n"
        "changes = {'plan.sets': 1, 'plan.rotations': 1, 'plan.frames': 1, 'row.plants_front': 1,\n"
        "    'row.plants_back': 0, 'cultivar': 'kaite_february'}\n"
        "def check(_): assert handlers() == before\n"
        "options = BuildOptions(renderer=stand_in.StandIn)\n"
        "build(load_recipe('barth2018', changes), sys.argv[1], None, ('class',), options, check)\n"
        "assert handlers() == before and (sys.stdout, sys.stderr) == streams\n"
    )
    command = Command(str(tmp_path / "set"), entry=("-c", code))
    assert command.finish() == (0, b"", b"")


@pytest.mark.long
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_signals_at_random_moments_of_a_build(tmp_path, number):
    """Of the start, of builds with and without workers, and of the end; every set can be completed."""
    rng = np.random.default_rng(int(number))
    expected = tmp_path / "expected"
    arguments = ("build", "barth2018", *COLOUR, "--set", "plan.frames=4", "--out")
    assert Command(*arguments, str(expected)).finish()[0] == 0
    folder = tmp_path / "set"
    for _ in range(25):
        workers = ("--workers", "2") if rng.integers(2) else ()
        command = Command(*arguments, str(folder), *workers)
        code, errors = interrupt(command, number, rng.uniform(0.0, 7.0))
        if code == 0:
            assert messages(errors) == []
            assert contents(folder) == contents(expected)
            shutil.rmtree(folder)
        else:
            check_interrupted(command, code, errors, number)
        assert not list(tmp_path.rglob("*.tmp"))
        if folder.exists():
            # A worker that is killed may leave an image of a frame that is not complete.
            assert check_dataset(folder, frames=None).counts().keys() <= {"incomplete", "extra"}
    assert Command(*arguments, str(folder)).finish()[0] == 0
    assert contents(folder) == contents(expected)


def contents(folder):
    """Bytes of the images and of the JSON files of all frames, by path."""
    return {
        path.relative_to(folder): path.read_bytes()
        for path in folder.rglob("*")
        if path.suffix in (".png", ".exr", ".json")
    }


PROGRESS = ("start ", "figure: ", "growing plants", "rendering frame ", "writing files")


@pytest.mark.long
@pytest.mark.parametrize(
    "arguments",
    [
        "render demo --out one --outputs class,colour --quality draft",
        "plant kaite --out plant.glb --quality draft",
        "report set",
        "check set",
        "export set --format coco --out coco",
        "compare set set --figure figure.png",
        "tune demo --fit leaf.chlorophyll --patches set --out tuned",
        "doctor",
        "recipes",
    ],
)
def test_signals_at_random_moments_of_other_commands(tmp_path, arguments):
    rng = np.random.default_rng(len(arguments))
    assert Command("build", "barth2018", "--out", "set", *COLOUR, cwd=tmp_path).finish()[0] == 0
    before = {path for path in tmp_path.rglob("*") if path.is_file()}
    for number in (signal.SIGINT, signal.SIGTERM) * 2:
        command = Command(*arguments.split(), cwd=tmp_path)
        code, errors = interrupt(command, number, rng.uniform(0.0, 5.0))
        if code < 128:
            assert b"Traceback" not in errors
            continue
        lines = [line for line in messages(errors) if not line.startswith(PROGRESS)]
        assert (code, len(lines)) == (128 + number, 1), errors.decode()
        assert lines[0].startswith("interrupted")
        assert command.remaining() == []
        after = {path for path in tmp_path.rglob("*") if path.is_file()}
        assert not [path for path in after - before if path.suffix == ".tmp"]


def test_the_console_script_is_the_entry_that_handles_signals():
    text = (Path(__file__).resolve().parents[2] / "pyproject.toml").read_text(encoding="utf-8")
    assert 'pepperscene = "pepperscene.__main__:main"' in text
    # Everything that is imported before the handlers delays them.
    code = (
        "import signal, sys\n"
        "def stop(*_): print(*sys.modules); sys.exit()\n"
        "signal.signal = stop\n"
        "from pepperscene.__main__ import main; main()\n"
    )
    loaded = subprocess.check_output([sys.executable, "-c", code], text=True).split()
    assert not {"typer", "numpy", "pydantic", "pepperscene.cli"} & {*loaded}
