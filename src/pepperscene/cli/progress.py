"""How a build's progress is shown: a bar on a terminal, plain lines elsewhere, JSON lines for scripts."""

from __future__ import annotations

import json
import sys
import time
from abc import ABC, abstractmethod
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, final

import typer

if TYPE_CHECKING:
    from rich.progress import Progress as Bar
    from rich.progress import TaskID

    from pepperscene.dataset import BuildProgress, BuildResult


_FEW: Final = 200  # chosen: frames that are told a line each
_EVERY_S: Final = 5.0  # chosen: of more frames, how often a line is told


class ProgressReporter(ABC):
    """Tells of a build."""

    @abstractmethod
    def frame(self, told: BuildProgress) -> None:
        """A frame is whole."""

    @abstractmethod
    def notice(self, text: str) -> None:
        """Something that the user should know."""

    @abstractmethod
    def end(self, result: BuildResult, out: Path) -> None:
        """The build is done."""


@contextmanager
def progress_reporter(as_json: bool) -> Iterator[ProgressReporter]:
    """Who tells of a build: for a script, for a terminal, or for a log."""
    if as_json:
        yield Scripted()
    elif sys.stderr.isatty():
        with _bar() as (bar, task):
            yield OnTerminal(bar, task)
    else:
        yield Plain()


@final
class Scripted(ProgressReporter):
    """One JSON object a line on standard output: `frame`, `notice` and `end` by their key `event`."""

    def frame(self, told: BuildProgress) -> None:
        """See `ProgressReporter`."""
        self._line(
            event="frame",
            index=told.index,
            made=told.made,
            done=told.done,
            total=told.total,
            frames_per_s=told.frames_per_s,
            left_s=told.left_s,
            picture=None if told.picture is None else str(told.picture),
        )

    def notice(self, text: str) -> None:
        """See `ProgressReporter`."""
        self._line(event="notice", text=text)

    def end(self, result: BuildResult, out: Path) -> None:
        """See `ProgressReporter`."""
        self._line(event="end", made=len(result.made), kept=len(result.kept), folder=str(out))

    @staticmethod
    def _line(**told: Any) -> None:
        typer.echo(json.dumps(told))


class _Worded(ProgressReporter):
    """Words for people."""

    def end(self, result: BuildResult, out: Path) -> None:
        """See `ProgressReporter`."""
        kept = f", {len(result.kept)} were there already" if result.kept else ""
        made = len(result.made)
        typer.echo(f"{made} frame{'' if made == 1 else 's'} built{kept}: {out}")


@final
class Plain(_Worded):
    """A line each for few frames, now and then for many."""

    def __init__(self) -> None:
        self._last = float("-inf")

    def frame(self, told: BuildProgress) -> None:
        """See `ProgressReporter`."""
        now = time.monotonic()
        if told.total > _FEW and told.done < told.total and now - self._last < _EVERY_S:
            return
        self._last = now
        state = "built" if told.made else "kept"
        rate = "" if told.frames_per_s is None else f", {_rate(told.frames_per_s)}"
        left = "" if told.left_s is None or told.done == told.total else f", {_duration(told.left_s)} left"
        typer.echo(f"frame {told.index:06d} {state} ({told.done} of {told.total}{rate}{left})", err=True)

    def notice(self, text: str) -> None:
        """See `ProgressReporter`."""
        typer.echo(f"note: {text}", err=True)


@final
class OnTerminal(_Worded):
    """A bar with rate, time left and the last picture's path.

    Args:
        bar: Rich's.
        task: its only one.
    """

    def __init__(self, bar: Bar, task: TaskID) -> None:
        self._bar, self._task = bar, task

    def frame(self, told: BuildProgress) -> None:
        """See `ProgressReporter`."""
        self._bar.update(
            self._task,
            completed=told.done,
            total=told.total,
            description=f"frame {told.index:06d}",
            rate="" if told.frames_per_s is None else _rate(told.frames_per_s),
            left="" if told.left_s is None else f"{_duration(told.left_s)} left",
            picture="" if told.picture is None else str(told.picture),
        )

    def notice(self, text: str) -> None:
        """See `ProgressReporter`."""
        self._bar.console.print(f"note: {text}", markup=False, highlight=False)


@contextmanager
def _bar() -> Iterator[tuple[Bar, TaskID]]:
    from rich import progress
    from rich.console import Console

    columns = (
        progress.TextColumn("{task.description}"),
        progress.BarColumn(),
        progress.MofNCompleteColumn(),
        progress.TextColumn("{task.fields[rate]}"),
        progress.TextColumn("{task.fields[left]}"),
        progress.TextColumn("[dim]{task.fields[picture]}"),
    )
    with progress.Progress(*columns, console=Console(stderr=True)) as bar:
        yield bar, bar.add_task("growing plants", total=None, rate="", left="", picture="")


def _rate(frames_per_s: float) -> str:
    """Frames in a second, or seconds for a frame."""
    return f"{frames_per_s:.1f} frames/s" if frames_per_s >= 1 else f"{1 / frames_per_s:.1f} s a frame"


def _duration(seconds: float) -> str:
    """Hours, minutes or seconds, of two units at most."""
    whole = round(seconds)
    if whole >= 3600:
        return f"{whole // 3600} h {whole % 3600 // 60} min"
    return f"{whole // 60} min {whole % 60} s" if whole >= 60 else f"{whole} s"
