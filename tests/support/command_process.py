"""Starts the command line in processes of its own, as users do, and finds everything that they started."""

from __future__ import annotations

import itertools
import os
import signal
import subprocess
import sys
import time
from contextlib import contextmanager
from pathlib import Path

import pepperscene

SOURCES = str(Path(pepperscene.__file__).parents[1])
STAND_IN = str(Path(__file__).resolve().parents[1] / "support")
ENTRY = ("-m", "pepperscene")
FAST_ENTRY = (
    "-c",
    "import pepperscene.building.scenes.frame_renderer as frame_renderer, stand_in\n"
    "from pepperscene.geometry import rectangle\n"
    "from pepperscene.scene import assemble_scene\n"
    "scene = assemble_scene(rectangle((0, 0, 1), (1, 0, 0), (0, 0, 1)))\n"
    "assembled = frame_renderer.AssembledScene(scene, {})\n"
    "frame_renderer.FrameRenderer.assemble = lambda *_args, **_kwargs: assembled\n"
    "frame_renderer.mitsuba_renderer = stand_in.StandIn\n"
    "from pepperscene.__main__ import main; main()\n",
)
"""The command line with scenes without plants, and a renderer that draws noise."""
SEPARATOR = "--then"
TOGETHER = (
    "-c",
    "import sys\n"
    "from pepperscene.cli import app\n"
    "from pepperscene.cli.application import protect_streams\n"
    "protect_streams()\n"
    "words = sys.argv[1:]\n"
    "while words:\n"
    f"    end = words.index({SEPARATOR!r})\n"
    "    code = app(words[:end], standalone_mode=False)\n"
    "    assert not code, (code, words[:end])\n"
    "    print('\\0', end='', flush=True)\n"
    "    del words[: end + 1]\n",
)
"""Commands one after the other in one process, each followed by `SEPARATOR`; a NUL ends each output."""

ONE_PLANT = (
    "--set", "plan.sets=1", "--set", "plan.rotations=1", "--set", "plan.frames=2", "--set",
    "row={plants_front=1, plants_back=0}", "--set", "cultivar=kaite_february",
)  # fmt: skip

_MARK = "PEPPERSCENE_TEST_MARK"
_numbers = itertools.count()


class Command:
    """A running command.

    Args:
        arguments: of the command line.
        entry: how Python is started.
        environment: further variables; None removes one.
        options: of `subprocess.Popen`.
    """

    def __init__(self, *arguments, entry=ENTRY, environment=None, **options):
        self._mark = f"{_MARK}={os.getpid()}-{next(_numbers)}"
        path = os.pathsep.join((SOURCES, STAND_IN))
        variables = {**os.environ, "PYTHONPATH": path, _MARK: self._mark.partition("=")[2]}
        variables |= environment or {}
        streams = dict.fromkeys(("stdin", "stdout", "stderr"), subprocess.PIPE)
        streams["stdin"] = subprocess.DEVNULL
        with _default_interrupts():
            self.process = subprocess.Popen(
                [sys.executable, *entry, *arguments],
                env={name: value for name, value in variables.items() if value is not None},
                **{**streams, **options},
            )

    def wait_for_handlers(self):
        """Wait until signals are handled: the start of Python itself takes some milliseconds."""
        status = Path(f"/proc/{self.process.pid}/status")
        end = time.monotonic() + 30
        while self.process.poll() is None and time.monotonic() < end:
            caught = next(line for line in status.read_text().splitlines() if line.startswith("SigCgt"))
            if int(caught.split()[1], 16) >> (signal.SIGTERM - 1) & 1:
                return
            time.sleep(0.001)

    def finish(self, timeout_s=90):
        """Exit code, standard output and standard error, when the command has ended."""
        output, errors = self.process.communicate(timeout=timeout_s)
        return self.process.returncode, output or b"", errors or b""

    def remaining(self, patience_s=10.0):
        """Command lines of processes that the command started and that have not ended after some seconds."""
        end = time.monotonic() + patience_s
        while (found := list(self._members())) and time.monotonic() < end:
            time.sleep(0.05)
        return found

    def _members(self):
        for folder in Path("/proc").glob("[0-9]*"):
            try:
                if self._mark.encode() in (folder / "environ").read_bytes().split(b"\0"):
                    yield (folder / "cmdline").read_bytes()
            except OSError:
                continue


@contextmanager
def _default_interrupts():
    """Shells without job control make background processes ignore Ctrl-C, and processes inherit that."""
    previous = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, previous)


def messages(errors):
    """Lines on standard error that report no progress."""
    lines = errors.decode().splitlines()
    return [line for line in lines if not line.startswith("frame ")]
