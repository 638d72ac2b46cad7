"""Progress of a training: a bar on a terminal, plain lines elsewhere."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from typing import TYPE_CHECKING

from pepperscene.cli.progress import Throttle, echo_progress
from pepperscene.durations import format_duration

if TYPE_CHECKING:
    from rich.progress import Progress, TaskID

    from pepperscene.learning.training.progress import TrainingProgress


@contextmanager
def training_progress() -> Iterator[Callable[[TrainingProgress], None]]:
    """Callback for each step of a training: a bar on a terminal, a line every few seconds elsewhere.

    The result of each validation is a line in both cases.
    """
    with _training_bar() if sys.stderr.isatty() else nullcontext() as bar:
        throttle = Throttle()

        def show(progress: TrainingProgress) -> None:
            rate = f"{progress.images_per_s:.1f} images/s, {format_duration(progress.left_s)} left"
            text = f"step {progress.step:,} of {progress.steps:,}: loss {progress.loss:.3f}"
            if bar is not None:
                bar[0].update(
                    bar[1], completed=progress.step, total=progress.steps, description=text, rate=rate
                )
            if progress.mean_iou is not None:
                text += f", mean IoU {progress.mean_iou:.3f}"
                if bar is not None:
                    bar[0].console.print(text, markup=False, highlight=False)
            if bar is None and (
                throttle.is_due(progress.step, progress.steps) or progress.mean_iou is not None
            ):
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
