"""Progress of commands: a bar on a terminal, plain lines elsewhere, JSON lines for scripts."""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, final

import typer

from pepperscene.interrupts import raise_if_interrupted
from pepperscene.units import format_duration, format_rate

if TYPE_CHECKING:
    from rich.progress import Progress, TaskID

    from pepperscene.building.execution.build import BuildProgress, BuildResult
    from pepperscene.building.execution.progress_bar import ProgressBar
    from pepperscene.learning.options import TrainingProgress

_EVERY_LINE: Final = 200  # chosen: up to so many frames, each is printed
_INTERVAL_S: Final = 5.0  # chosen: seconds between lines for more frames
_IMAGES_PER_LINE: Final = 200  # chosen: measured images between lines, some seconds


def echo_progress(text: str) -> None:
    """Print a line of progress to standard error."""
    typer.echo(text, err=True)


def echo_note(text: str) -> None:
    """Print something that the user should know to standard error."""
    echo_progress(f"note: {text}")


def echo_measured(done: int, total: int) -> None:
    """Print the number of measured images from time to time."""
    raise_if_interrupted()
    if total > _IMAGES_PER_LINE and (done % _IMAGES_PER_LINE == 0 or done == total):
        echo_progress(f"{done:,} of {total:,} images measured")


class Throttle:
    """Every line for few frames, one line every few seconds for many."""

    def __init__(self) -> None:
        self._last = float("-inf")

    def is_due(self, done: int, total: int) -> bool:
        """Whether to print a line now."""
        return self.allows(total <= _EVERY_LINE or done == total)

    def allows(self, always: bool) -> bool:
        """Whether to print a line that is `always` printed, or else only some time after the last one."""
        raise_if_interrupted()
        now = time.monotonic()
        due = always or now - self._last >= _INTERVAL_S
        self._last = now if due else self._last
        return due


# --- building -----------------------------------------------------------------------------------------------


class ProgressReporter:
    """Reports the progress of a build by plain lines on standard error."""

    def __init__(self) -> None:
        self._throttle = Throttle()

    def frame(self, progress: BuildProgress) -> None:
        """Report a finished frame, unless the last line is recent."""
        if not self._throttle.is_due(progress.done, progress.total):
            return
        parts = [f"{progress.done} of {progress.total}"]
        if progress.frames_per_s is not None:
            parts.append(format_rate(progress.frames_per_s))
        if progress.left_s is not None and progress.done < progress.total:
            parts.append(f"{format_duration(progress.left_s)} left")
        state = "built" if progress.made else "kept"
        echo_progress(f"frame {progress.index:06d} {state} ({', '.join(parts)})")

    def notice(self, text: str) -> None:
        """Report something that the user should know."""
        echo_note(text)

    def selected(self, frames: int, planned: int) -> None:
        """Report how many frames of a plan its recipe selects, unless it selects all."""
        if frames < planned:
            self.notice(f"{frames:,} of {planned:,} frames selected")

    def end(self, result: BuildResult, out: Path) -> None:
        """Report the end of the build."""
        made, kept = len(result.made), len(result.kept)
        skipped = f", {kept} already there" if kept else ""
        typer.echo(f"{made} frame{'' if made == 1 else 's'} built{skipped}: {out}")


@final
class JsonReporter(ProgressReporter):
    """One JSON object a line on standard output, with the key `event`: `frame`, `notice` or `end`."""

    def frame(self, progress: BuildProgress) -> None:
        """Print the event `frame`."""
        picture = None if progress.picture is None else str(progress.picture)
        names = ("index", "made", "done", "total", "frames_per_s", "left_s")
        self._print("frame", **{name: getattr(progress, name) for name in names}, picture=picture)

    def selected(self, frames: int, planned: int) -> None:
        """Print nothing, because the events `frame` contain the number of frames."""

    def notice(self, text: str) -> None:
        """Print the event `notice`."""
        self._print("notice", text=text)

    def end(self, result: BuildResult, out: Path) -> None:
        """Print the event `end`."""
        self._print("end", made=len(result.made), kept=len(result.kept), folder=str(out))

    @staticmethod
    def _print(event: str, **values: Any) -> None:
        typer.echo(json.dumps({"event": event, **values}, allow_nan=False))


@final
class BarReporter(ProgressReporter):
    """A progress bar."""

    def __init__(self, bar: ProgressBar) -> None:
        self.frame, self.notice = bar, bar.notice  # type: ignore[method-assign]


@contextmanager
def progress_reporter(as_json: bool) -> Iterator[ProgressReporter]:
    """The reporter for scripts, for a terminal, or for a log."""
    if as_json:
        yield JsonReporter()
    elif sys.stderr.isatty():
        from rich.console import Console

        from pepperscene.building.execution.progress_bar import ProgressBar

        with ProgressBar(Console(stderr=True)) as bar:
            yield BarReporter(bar)
    else:
        yield ProgressReporter()


@contextmanager
def render_status() -> Iterator[Callable[[str], None]]:
    """Callback for each stage of a single frame: a line with a spinner on a terminal, lines elsewhere."""
    if not sys.stderr.isatty():
        yield echo_progress
        return
    from rich.console import Console

    with Console(stderr=True).status("") as status:
        yield status.update


# --- checking and exporting ---------------------------------------------------------------------------------


@contextmanager
def check_progress() -> Iterator[Callable[[int, int], None] | None]:
    """Callback for each checked frame: a bar on a terminal, None elsewhere."""
    with _bar("checking", transient=True) as update:
        yield update


@contextmanager
def export_progress() -> Iterator[Callable[[int, int, int], None]]:
    """Callback for each exported frame: a bar on a terminal, lines elsewhere."""
    throttle = Throttle()
    with _bar("exporting") as update:

        def show(index: int, done: int, total: int) -> None:
            if update is not None:
                update(done, total, description=f"frame {index:06d}")
            elif throttle.is_due(done, total):
                echo_progress(f"frame {index:06d} ({done} of {total})")

        yield show


@contextmanager
def image_progress(verb: str, noun: str = "images") -> Iterator[Callable[[int, int], None]]:
    """Callback for each image of a set: a bar on a terminal, lines elsewhere.

    Args:
        verb: what is done with an image, as a participle ("evaluated").
        noun: what is done, if not images.
    """
    throttle = Throttle()

    def print_line(done: int, total: int) -> None:
        if total > _EVERY_LINE and throttle.is_due(done, total):
            echo_progress(f"{done:,} of {total:,} {noun} {verb}")

    with _bar(verb, transient=True) as update:
        yield update or print_line


@contextmanager
def _bar(description: str, *, transient: bool = False) -> Iterator[Callable[..., None] | None]:
    """Callback that updates a bar to a number of so many; None where there is no terminal."""
    if not sys.stderr.isatty():
        yield None
        return
    from rich.console import Console
    from rich.progress import Progress

    with Progress(console=Console(stderr=True), transient=transient) as bar:
        task = bar.add_task(description, total=None)
        yield lambda done, total, **fields: bar.update(task, completed=done, total=total, **fields)


# --- training -----------------------------------------------------------------------------------------------


@contextmanager
def training_progress() -> Iterator[Callable[[TrainingProgress], None]]:
    """Callback for each step of a training: a bar on a terminal, a line every few seconds elsewhere.

    The result of each validation is a line in both cases.
    """
    with _training_bar() if sys.stderr.isatty() else nullcontext() as bar:
        throttle = Throttle()

        def show(progress: TrainingProgress) -> None:
            raise_if_interrupted()
            rate = f"{progress.images_per_s:.1f} images/s, {format_duration(progress.left_s)} left"
            text = f"step {progress.step:,} of {progress.steps:,}: loss {progress.loss:.3f}"
            if bar is not None:
                bar[0].update(
                    bar[1], completed=progress.step, total=progress.steps, description=text, rate=rate
                )
            if progress.quality:
                text += f", {progress.quality}"
                if bar is not None:
                    bar[0].console.print(text, markup=False, highlight=False)
            if bar is None and (throttle.is_due(progress.step, progress.steps) or progress.quality):
                echo_progress(f"{text} ({rate})")

        yield show


@contextmanager
def _training_bar() -> Iterator[tuple[Progress, TaskID]]:
    from rich import progress
    from rich.console import Console

    columns = (
        progress.TextColumn("{task.description}"),
        progress.BarColumn(),
        progress.TextColumn("{task.fields[rate]}"),
    )
    with progress.Progress(*columns, console=Console(stderr=True)) as bar:
        yield bar, bar.add_task("reading images", total=None, rate="")
