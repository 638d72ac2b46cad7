"""Building a data set: the frames that are missing, each whole or not at all."""

from __future__ import annotations

import shutil
import time
from collections import deque
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from pepperscene.dataset.execution.executor import Executor, work_units
from pepperscene.dataset.execution.job import BuildJob, FrameDone
from pepperscene.dataset.execution.local import MOST_WORKERS, ProcessExecutor, SerialExecutor
from pepperscene.dataset.recipe.load import load_recipe
from pepperscene.dataset.recipe.recipe import Recipe
from pepperscene.dataset.scenes.frame_renderer import RendererFactory
from pepperscene.dataset.store.dataset import Dataset
from pepperscene.dataset.store.folder import OutputFolder, check_output_folder
from pepperscene.dataset.store.journal import Journal
from pepperscene.dataset.store.manifest import write_manifest
from pepperscene.errors import ArgumentError, OutputError
from pepperscene.frame import DEFAULT_OUTPUTS, check_outputs

_WINDOW: Final = 200  # chosen: frames that the rate is taken over, so that it follows changes
_SPAN_S: Final = 120.0  # chosen: seconds that it is taken over, likewise


class Throughput:
    """Counts frames; those that were there already do not count for the rate.

    Args:
        total: frames that are wanted.
        clock: seconds, steadily increasing.
    """

    def __init__(self, total: int, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock, self._total = clock, total
        self.done = 0
        self._made = deque([clock()], maxlen=_WINDOW)

    def count(self, made: bool) -> None:
        """One more frame is there."""
        self.done += 1
        if made:
            self._made.append(self._clock())
            while len(self._made) > 2 and self._made[-1] - self._made[0] > _SPAN_S:
                self._made.popleft()
        elif len(self._made) == 1:
            # Looking at what is there takes time that no frame was made in.
            self._made[0] = self._clock()

    @property
    def frames_per_s(self) -> float | None:
        """Frames made in a second, lately; None before the first."""
        took = self._made[-1] - self._made[0]
        return (len(self._made) - 1) / took if took > 0 else None

    @property
    def left_s(self) -> float | None:
        """Seconds for the rest at this rate, were none of it there; None before the first frame."""
        rate = self.frames_per_s
        return None if rate is None else (self._total - self.done) / rate


def choose_executor(
    workers: int | None = None, scheduler: str | None = None, slurm: str | Path | None = None
) -> Executor:
    """This process when nothing is said; else the one of the three that is.

    Raises:
        InputError: more than one is said, or the number or the file is not valid.
        SetupError: the extra `cluster` is not installed.
    """
    said = {"workers": workers, "scheduler": scheduler, "slurm": slurm}
    named = [name for name, value in said.items() if value is not None]
    if len(named) > 1:
        raise ArgumentError(named[1], f"cannot be combined with {named[0]}")
    if scheduler is not None:
        from pepperscene.dataset.execution.dask_cluster import DaskExecutor

        return DaskExecutor(scheduler)
    if slurm is not None:
        from pepperscene.dataset.execution.slurm import SlurmExecutor

        return SlurmExecutor(Path(slurm))
    if workers is None:
        return SerialExecutor()
    if not 1 <= workers <= MOST_WORKERS:
        raise ArgumentError("workers", f"must be 1 to {MOST_WORKERS}, not {workers}")
    return ProcessExecutor(workers)


_SHOWN: Final = ("colour", "class_colour", "class", "instance", "distance_code", "raw")
"""Outputs that any viewer shows, the best first."""


@dataclass(frozen=True)
class BuildProgress:
    """Told after each frame.

    Attributes:
        index: of the frame.
        done: frames so far, this one included.
        total: frames wanted.
        made: False when it was there already.
        frames_per_s: that are made, lately; None before the first.
        left_s: seconds that are left at this rate; None before the first.
        picture: the frame's file that a viewer can show, or None.
    """

    index: int
    done: int
    total: int
    made: bool
    frames_per_s: float | None = None
    left_s: float | None = None
    picture: Path | None = None


@dataclass(frozen=True)
class BuildResult:
    """What a build did.

    Attributes:
        dataset: the data set in its folder.
        made: indices of the frames that were rendered, or given further outputs.
        kept: indices of those that were there already.
    """

    dataset: Dataset
    made: tuple[int, ...]
    kept: tuple[int, ...]


def build(
    recipe: Recipe | str | Path,
    out: str | Path,
    frames: str | Sequence[int] | None = None,
    outputs: Sequence[str] = DEFAULT_OUTPUTS,
    quality: str = "standard",
    seed: int | None = None,
    on_frame: Callable[[BuildProgress], None] | None = None,
    renderer: RendererFactory | None = None,
    target_error: float | None = None,
    workers: int | None = None,
    scheduler: str | None = None,
    slurm: str | Path | None = None,
    on_notice: Callable[[str], None] | None = None,
) -> BuildResult:
    """Render the frames of a recipe into a folder.

    Frames and outputs that are there already are kept, if their checksums are right, so that a build can be
    interrupted, continued and widened. A frame's bytes depend on the recipe, the version and its index alone.

    Args:
        recipe: or the name of a shipped one, or a path.
        out: folder of the data set; made when missing.
        frames: indices, or "A:B" (0-based, half-open); None for those that the recipe selects.
        outputs: names out of `OUTPUTS`.
        quality: "draft", "standard" or "reference".
        seed: instead of the recipe's.
        on_frame: called in this thread after every frame, once it is whole; by then the next one may be
            rendered. In the order of the indices, unless several workers make frames.
        renderer: makes the renderer of a scene; None for Mitsuba. Workers need one that can be pickled.
        target_error: of the traced light over the sensor's noise, at which sampling stops, instead of the
            quality's own; see `pepperscene.render.render`.
        workers: processes on this machine, each with its share of the cores, one scene each; None makes all
            frames in this process, with all cores.
        scheduler: address of a running Dask scheduler, whose workers see `out` under the same path; needs the
            extra `cluster`.
        slurm: TOML file that tells what jobs to ask Slurm for; needs the extra `cluster`.
        on_notice: called with a sentence for the user, such as that a worker was lost.

    Raises:
        InputError: an argument, the recipe or a file that it names is not valid; nothing is written.
        OutputError: the folder holds something else than this data set, or cannot be written to.
        SetupError: the machine cannot render, or an extra is missing; nothing is written.
        WorkerError: workers were lost again and again, or the cluster cannot be reached.
    """
    # All that can be wrong with the arguments comes to light before the first file is touched.
    from pepperscene.render import resolve_quality

    wanted = check_outputs(outputs)
    resolve_quality(quality, target_error)
    crew = choose_executor(workers, scheduler, slurm)
    told = (recipe if isinstance(recipe, Recipe) else load_recipe(recipe)).with_seed(seed)
    indices = told.plan.select_indices(frames)
    job = BuildJob(told, Path(out).absolute(), wanted, quality, target_error, renderer)
    job.check()
    check_output_folder(Path(out), job.about())
    return _built(job, Path(out), indices, crew, on_frame or _unheard, on_notice or _unheard)


def _built(
    job: BuildJob,
    out: Path,
    indices: Sequence[int],
    crew: Executor,
    on_frame: Callable[[BuildProgress], None],
    on_notice: Callable[[str], None],
) -> BuildResult:
    folder = OutputFolder(out, job.about())
    made: list[int] = []
    pace = Throughput(len(indices))
    picture = next((name for name in _SHOWN if name in job.outputs), None)
    room = _Room(out, len(indices), on_notice)

    with Journal(out) as journal:

        def tell(done: FrameDone) -> None:
            _noted(journal, done, () if pace.done else indices)
            made.extend([done.index] if done.made else [])
            pace.count(done.made)
            room.look(done, pace.done)
            file = None if picture is None else folder.dataset.path(done.index, picture)
            rate, left = pace.frames_per_s, pace.left_s
            on_frame(BuildProgress(done.index, pace.done, len(indices), done.made, rate, left, file))

        try:
            crew.make(job, work_units(job.recipe.plan, indices, crew.size), tell, on_notice)
        except BaseException:
            with suppress(OutputError, OSError):
                folder.sweep()
                folder.undo()
                _tabulate(folder.dataset, journal)
            raise
        _tabulate(folder.dataset, journal)
    folder.sweep()
    kept = tuple(sorted(set(indices).difference(made)))
    return BuildResult(folder.dataset, tuple(sorted(made)), kept)


def _noted(journal: Journal, done: FrameDone, wanted: Sequence[int]) -> None:
    """Note a frame, and before the first one, when there is a folder, which are wanted."""
    try:
        journal.want(wanted)
        journal.add(done.row)
    except OSError as fault:
        raise OutputError(f"the journal cannot be written ({fault.strerror or fault})") from None


def _tabulate(dataset: Dataset, journal: Journal) -> None:
    """Write the tables, also of a build that was ended early."""
    if not dataset.indices():
        return
    try:
        write_manifest(dataset, journal)
    except OSError as fault:
        raise OutputError(
            f"{dataset.folder}: the manifest cannot be written ({fault.strerror or fault}), the frames stay"
        ) from None


class _Room:
    """Looks ahead, once, whether the disk has room for all frames."""

    def __init__(self, folder: Path, total: int, notice: Callable[[str], None]) -> None:
        self._folder, self._total, self._notice = folder, total, notice
        self._asked = False

    def look(self, done: FrameDone, count: int) -> None:
        """After a frame: what the rest will take, if it is like this one."""
        if self._asked or not done.made:
            return
        self._asked = True
        needed = (self._total - count) * int(done.row["bytes"])
        free = shutil.disk_usage(self._folder).free
        if needed > free:
            self._notice(
                f"{self._folder}: the rest needs {needed / 1e9:.1f} GB, but {free / 1e9:.1f} GB are free"
            )


def _unheard(_: object) -> None:
    """Nobody listens."""
