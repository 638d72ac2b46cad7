"""A progress bar for builds, on a terminal and in notebooks."""

from __future__ import annotations

from types import TracebackType
from typing import TYPE_CHECKING, Any, Self, final

from pepperscene.units import format_duration, format_rate

if TYPE_CHECKING:
    from rich.console import Console

    from pepperscene.building.execution.build import BuildProgress


@final
class ProgressBar:
    """Shows the frames of a build, their rate, the time left and the path of the latest image.

        pepperscene.build("demo", "out/demo", on_frame=pepperscene.ProgressBar())

    It appears with the first frame and ends with the last one. As a context manager it appears at once, and
    also ends when the build fails.

    Args:
        console: of Rich; None for standard output or the notebook.
    """

    def __init__(self, console: Console | None = None) -> None:
        from rich import progress

        columns = (
            progress.TextColumn("{task.description}"),
            progress.BarColumn(),
            progress.MofNCompleteColumn(),
            progress.TextColumn("{task.fields[rate]}"),
            progress.TextColumn("{task.fields[left]}"),
            progress.TextColumn("[dim]{task.fields[picture]}"),
        )
        self._bar = progress.Progress(*columns, console=console)
        self._task: Any = None

    def __call__(self, progress: BuildProgress) -> None:
        """Advance the bar by a frame."""
        self._start()
        self._bar.update(
            self._task,
            completed=progress.done,
            total=progress.total,
            description=f"frame {progress.index:06d}",
            rate="" if progress.frames_per_s is None else format_rate(progress.frames_per_s),
            left="" if progress.left_s is None else f"{format_duration(progress.left_s)} left",
            picture="" if progress.picture is None else str(progress.picture),
        )
        if progress.done == progress.total:
            self._stop()

    def notice(self, text: str) -> None:
        """Print a line above the bar."""
        self._bar.console.print(f"note: {text}", markup=False, highlight=False)

    def __enter__(self) -> Self:
        self._start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self._stop()

    def _start(self) -> None:
        if self._task is None:
            self._task = self._bar.add_task("growing plants", total=None, rate="", left="", picture="")
            self._bar.start()

    def _stop(self) -> None:
        self._bar.stop()
