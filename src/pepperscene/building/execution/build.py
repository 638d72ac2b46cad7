"""Build a data set: render the missing frames, each completely or not at all."""

from __future__ import annotations

import shutil
import time
from collections import Counter, deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from pepperscene.atomic import write_errors
from pepperscene.building.execution.executor import (
    MAX_WORKERS,
    Dispatcher,
    Executor,
    ProcessExecutor,
    SerialExecutor,
    work_units,
)
from pepperscene.building.execution.job import BuildJob, BuildOptions, FrameDone
from pepperscene.dataset.store.dataset import Dataset
from pepperscene.dataset.store.folder import OutputFolder, check_output_folder
from pepperscene.dataset.store.images import unlit_bands
from pepperscene.dataset.store.journal import append_timings
from pepperscene.dataset.store.manifest import Row
from pepperscene.errors import ArgumentError, OutputError
from pepperscene.frame import RenderingErrors
from pepperscene.notebook_view import VIEWABLE, frames_html
from pepperscene.outputs import DEFAULT_OUTPUTS
from pepperscene.recipe.recipe import Recipe
from pepperscene.recipe.resolve.resolved import ResolvedRecipe

_RATE_FRAMES: Final = 200  # chosen: frames that the rate is averaged over, so that it follows changes
_RATE_S: Final = 120.0  # chosen: seconds that it is averaged over, likewise


class Throughput:
    """Rate and remaining time of a build of `total` frames; existing frames do not count for the rate."""

    def __init__(self, total: int, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock, self._total = clock, total
        self.done = 0
        self._times = deque([clock()], maxlen=_RATE_FRAMES)

    def count(self, made: bool) -> None:
        """Count one more complete frame."""
        self.done += 1
        if made:
            self._times.append(self._clock())
            while len(self._times) > 2 and self._times[-1] - self._times[0] > _RATE_S:
                self._times.popleft()
        elif len(self._times) == 1:
            # The time spent on verifying existing frames does not count.
            self._times[0] = self._clock()

    @property
    def frames_per_s(self) -> float | None:
        """Recent rate; None before the first frame."""
        duration = self._times[-1] - self._times[0]
        return (len(self._times) - 1) / duration if duration > 0 else None

    @property
    def left_s(self) -> float | None:
        """Seconds for the remaining frames at this rate, if none exists; None before the first frame."""
        rate = self.frames_per_s
        return None if rate is None else (self._total - self.done) / rate


@dataclass(frozen=True)
class BuildProgress:
    """Progress after each frame.

    Attributes:
        index: of the frame.
        done: number of frames so far, including this one.
        total: number of frames requested.
        made: False if the frame existed already.
        frames_per_s: recent rate; None before the first frame that is made.
        left_s: estimated seconds for the remaining frames, likewise.
        picture: a file of the frame that any viewer shows, or None.
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
    """Result of a build.

    Attributes:
        dataset: the data set in its folder.
        made: indices of the frames that were rendered, or got further outputs.
        kept: indices of the frames that existed already.
        notes: sentences for the user, such as that the rendering error is above its target.
    """

    dataset: Dataset
    made: tuple[int, ...]
    kept: tuple[int, ...]
    notes: tuple[str, ...] = ()

    def __repr__(self) -> str:
        return f"BuildResult({len(self.made)} frames made, {len(self.kept)} kept, {self.dataset!r})"

    def _repr_html_(self) -> str:
        """Some frames, small, and the notes, for notebooks."""
        return frames_html(repr(self), self.dataset.indices(), self.dataset.path, self.notes)


def build(
    recipe: Recipe | ResolvedRecipe | str | Path,
    out: str | Path,
    frames: str | Sequence[int] | None = None,
    outputs: Sequence[str] = DEFAULT_OUTPUTS,
    options: BuildOptions = BuildOptions(),  # noqa: B008 - frozen
    on_frame: Callable[[BuildProgress], None] | None = None,
) -> BuildResult:
    """Render the frames of a recipe into a folder.

    Existing frames and outputs are kept if their checksums are right, so a build can be interrupted, resumed
    and extended. A frame's bytes depend on the recipe, the version, the quality and its index alone.

    Args:
        recipe: a recipe, the name of a shipped one, or a path.
        out: folder of the data set; made if missing.
        frames: indices, or "A:B" (0-based, half-open); None for the recipe's selection.
        outputs: names from `OUTPUTS`.
        options: quality, seed, workers and so on.
        on_frame: called in this thread after every frame, once it is complete; by then the next one may be
            rendered. In the order of the indices, unless several workers make frames.

    Raises:
        InputError: an argument, the recipe or a file that it names is not valid; nothing is written.
        OutputError: the folder holds something else than this data set, or cannot be written to.
        SetupError: the machine cannot render, or an extra is missing; nothing is written.
        WorkerError: workers were lost repeatedly, or the cluster cannot be reached.
    """
    # Check all arguments before the first file is touched.
    executor = choose_executor(options)
    job = BuildJob.create(recipe, out, outputs, options)
    job.recipe.check_code()
    indices = job.recipe.recipe.plan.select_indices(frames)
    if executor.local_processes:
        job.check_memory(min(executor.local_processes, len(indices)))
    check_output_folder(Path(out), job.info)
    if options.on_start is not None:
        options.on_start(len(indices), job.recipe.recipe.plan.count)

    # Make the frames. The tables are also written when a build is interrupted.
    on_notice = options.on_notice or (lambda _: None)
    folder = OutputFolder(Path(out), job.info)
    reporter = _Reporter(job, folder.dataset, len(indices), on_frame or (lambda _: None), on_notice)
    try:
        units = work_units(job.recipe.recipe.plan, indices, executor.size)
        executor.make(job, Dispatcher(units, reporter.report, on_notice))
        _finish(folder, reporter.rows, indices, job.outputs)
    except BaseException:
        with suppress(OutputError, OSError):
            folder.remove_temporary_files()
            folder.undo()
            _write_tables(folder.dataset, reporter.rows)
        raise
    made = sorted(reporter.rows)
    kept = set(indices).difference(made)
    spectra = job.recipe.spectra_notes
    notes = (*spectra, *reporter.errors.notes(), *_unlit_notes(folder.dataset, made, job.outputs))
    return BuildResult(folder.dataset, tuple(made), tuple(sorted(kept)), notes)


def choose_executor(options: BuildOptions) -> Executor:
    """The executor of the one option that names one; this process by default. Errors as of `build`."""
    names = [name for name in ("workers", "scheduler", "slurm") if getattr(options, name) is not None]
    if len(names) > 1:
        raise ArgumentError(names[1], f"cannot be combined with {names[0]}")
    if options.scheduler is not None:
        from pepperscene.building.execution.dask_executor import DaskExecutor

        return DaskExecutor(options.scheduler)
    if options.slurm is not None:
        from pepperscene.building.execution.slurm import SlurmExecutor

        return SlurmExecutor(Path(options.slurm))
    if options.workers is None:
        return SerialExecutor()
    if not 1 <= options.workers <= MAX_WORKERS:
        raise ArgumentError("workers", f"must be between 1 and {MAX_WORKERS}, not {options.workers}")
    return ProcessExecutor(options.workers)


class _Reporter:
    """Logs and reports each complete frame, and keeps the rows of the frames that were made."""

    def __init__(
        self,
        job: BuildJob,
        dataset: Dataset,
        total: int,
        on_frame: Callable[[BuildProgress], None],
        on_notice: Callable[[str], None],
    ) -> None:
        self._dataset, self._total = dataset, total
        self._on_frame, self._on_notice = on_frame, on_notice
        self._throughput = Throughput(total)
        self._preview = next((name for name in VIEWABLE if name in job.outputs), None)
        self._target = job.resolved_quality.target
        self.errors = RenderingErrors()
        self.rows: dict[int, Row] = {}  # by index

    def report(self, done: FrameDone) -> None:
        """Log and report one frame; raises `OutputError` if the journal cannot be written."""
        throughput = self._throughput
        throughput.count(done.made)
        self.errors.add(self._target, done.row.get("error_codes"), done.row.get("noise_codes"))
        if done.made:
            with write_errors(self._dataset.folder):
                append_timings(self._dataset.folder, done.row)
            self.rows[done.index] = done.row
            if len(self.rows) == 1:
                self._check_disk((self._total - throughput.done) * int(done.row["bytes"]))
        picture = None if self._preview is None else self._dataset.path(done.index, self._preview)
        rate, left_s = throughput.frames_per_s, throughput.left_s
        self._on_frame(
            BuildProgress(done.index, throughput.done, self._total, done.made, rate, left_s, picture)
        )

    def _check_disk(self, needed: int) -> None:
        """Notify if the disk is too small for the remaining frames, if they are like the first one."""
        free = shutil.disk_usage(self._dataset.folder).free
        if needed > free:
            self._on_notice(
                f"{self._dataset.folder}: the remaining frames need {needed / 1e9:.1f} GB, "
                f"but only {free / 1e9:.1f} GB are free"
            )


def _finish(
    folder: OutputFolder, rows: Mapping[int, Row], indices: Sequence[int], outputs: tuple[str, ...]
) -> None:
    """Complete the folder of a build that has made all its frames.

    Raises `OutputError` if another program has removed some of them.
    """
    # What was removed while the build ran and is known completely is written again.
    with write_errors(folder.dataset.folder):
        folder.prepare(())
    _write_tables(folder.dataset, rows)
    lost = folder.lost_frames(indices, outputs)
    if lost:
        raise OutputError(
            f"{folder.dataset.folder}: {len(lost)} of {len(indices)} frames were removed during the build, "
            f"the first is {lost[0]:06d}; the same command builds them again"
        )


def _unlit_notes(dataset: Dataset, indices: Sequence[int], outputs: tuple[str, ...]) -> Iterator[str]:
    """Yield at most one note about bands without light, in which the reflectance is not a number."""
    if "reflectance" not in outputs:
        return
    counts = Counter(band for index in indices for band in unlit_bands(dataset.metadata(index)))
    if counts:
        bands = ", ".join(str(band + 1) for band in sorted(counts))
        yield (
            f"in {max(counts.values())} of {len(indices)} frames the white reference has too little light "
            f"in band{'' if len(counts) == 1 else 's'} {bands}: the reflectance is nan there"
        )


def _write_tables(dataset: Dataset, rows: Mapping[int, Row]) -> None:
    if dataset.indices():
        dataset.write_tables(rows)
