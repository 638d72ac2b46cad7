"""A dry run of a build: its plan, its cost, a picture of its camera places, and their poses.

The cost is estimated from a probe: one frame that is made in a temporary folder.
"""

from __future__ import annotations

import heapq
import os
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Final

from pepperscene.atomic import check_can_write, write_files
from pepperscene.building.execution.build import choose_executor
from pepperscene.building.execution.executor import work_units
from pepperscene.building.execution.job import BuildJob, BuildOptions, FrameMaker
from pepperscene.building.memory import report_memory_errors
from pepperscene.building.scenes.frame_renderer import FrameRenderer
from pepperscene.building.subprocess_rpc import THREADS, available_cores
from pepperscene.dataset.store.dataset import MARK
from pepperscene.dataset.store.manifest import Row
from pepperscene.errors import ArgumentError
from pepperscene.outputs import DEFAULT_OUTPUTS
from pepperscene.recipe.plan import FrameSpec, Plan
from pepperscene.recipe.resolve.resolved import ResolvedRecipe
from pepperscene.review.preview.places import (
    check_can_write_poses,
    pose_format,
    scene_places,
    write_selected_poses,
)
from pepperscene.review.preview.summary import (
    PlanSummary,
    count_scenes,
    summarise_plan,
    varies_plants_per_frame,
)

_PICTURE_SUFFIX: Final = ".png"


@dataclass(frozen=True)
class ProbeFrame:
    """The cost of one frame.

    Attributes:
        setup_s: additional time of the first frame of a scene: starting the renderer, plants, compiling.
        frame_s: time of each further frame.
        frame_bytes: size of its files.
    """

    setup_s: float
    frame_s: float
    frame_bytes: int


@dataclass(frozen=True)
class CostEstimate:
    """The cost of a build on this machine.

    Attributes:
        index: of the frame that was rendered for the estimate.
        outputs, quality: of the frames.
        frames, scenes: numbers of frames and of scenes.
        processes: number of processes that render at the same time.
        setup_s, frame_s: time to set up one scene and to make one frame, in one process.
        total_s: duration of the build.
        memory_bytes: memory of one process.
        frame_bytes, disk_bytes: size of the files of one frame, and of all frames.
    """

    index: int
    outputs: tuple[str, ...]
    quality: str
    frames: int
    scenes: int
    processes: int
    setup_s: float
    frame_s: float
    total_s: float
    memory_bytes: int
    frame_bytes: int
    disk_bytes: int


@dataclass(frozen=True)
class PlanPreview:
    """Result of a dry run.

    Attributes:
        summary: what the plan contains.
        cost: of a build; None without a probe frame.
        files: that were written.
    """

    summary: PlanSummary
    cost: CostEstimate | None
    files: tuple[Path, ...]

    def to_json(self) -> dict[str, Any]:
        """The result, ready for JSON; only TOML dates among its values have no JSON type."""
        cost = None if self.cost is None else asdict(self.cost)
        return {**asdict(self.summary), "estimate": cost, "files": [str(path) for path in self.files]}


def preview_plan(
    recipe: ResolvedRecipe,
    outputs: tuple[str, ...] = DEFAULT_OUTPUTS,
    options: BuildOptions = BuildOptions(),  # noqa: B008 - frozen
    *,
    probe: bool = True,
    picture: Path | None = None,
    poses: Path | None = None,
) -> PlanPreview:
    """Describe what a build of a recipe's selected frames would make, without making it.

    Args:
        recipe: with its files.
        outputs: names from `OUTPUTS`, for the cost.
        options: quality, seed, workers and renderer of the build.
        probe: whether to render the first selected frame for the cost; without it, nothing is rendered and no
            plant is grown.
        picture: PNG file, or an existing folder for `NAME_plan.png`, to draw camera places into.
        poses: file or folder for the poses of the selected frames; see `pose_format`.

    Raises:
        PepperError: an argument is not valid, the machine cannot render, or a file cannot be written; nothing
            is written.
    """
    # Check all arguments before anything takes time.
    executor = choose_executor(options)
    job = BuildJob.create(recipe, Path(), outputs, options)
    if probe:
        job.recipe.check_code()
    name, indices = job.recipe.recipe.name, job.recipe.recipe.plan.select_indices(None)
    renderer = FrameRenderer(job.recipe, job.renderer)
    picture_file = None if picture is None else _picture_file(picture, name)
    if poses is not None:
        check_can_write_poses(renderer, indices, grown=probe)
        if pose_format(poses) == "colmap":
            check_can_write(poses, ())
        else:
            check_can_write(poses.absolute().parent, [poses.name])

    summary = summarise_plan(job.recipe, indices)
    cost = None
    if probe:
        if executor.local_processes:
            job.check_memory(min(executor.local_processes, len(indices)))
        if options.on_notice is not None:
            options.on_notice(f"frame {indices[0]} is rendered to estimate the cost")
        cost = estimate_cost(job, indices, options.workers, renderer)

    # Draw before the first file is written.
    drawing = b""
    if picture_file is not None:
        from pepperscene.review.preview.picture import draw_plan, row_geometry

        places = scene_places(renderer, indices, grown=probe)
        rows = row_geometry(renderer.setups.at(places.spec), places.spec.set)
        drawing = draw_plan(name, rows, places)
    files: tuple[Path, ...] = ()
    if poses is not None:
        write_selected_poses(poses, renderer, indices)
        files = (poses,)
    if picture_file is not None:
        files = (*write_files(picture_file.parent, {picture_file.name: drawing}), *files)
    return PlanPreview(summary, cost, files)


def _picture_file(path: Path, name: str) -> Path:
    """The file to draw into; raises `PepperError` if it cannot be written."""
    file = path / f"{Path(name).name}_plan{_PICTURE_SUFFIX}" if path.is_dir() else path
    if file.suffix.lower() != _PICTURE_SUFFIX:
        raise ArgumentError(
            "picture", f"{str(path)!r} must end in {_PICTURE_SUFFIX}, or be a folder that exists"
        )
    check_can_write(file.absolute().parent, [file.name])
    return file


def estimate_cost(
    job: BuildJob, indices: Sequence[int], workers: int | None, renderer: FrameRenderer
) -> CostEstimate:
    """Render the first of some frames, and estimate the cost of all.

    Args:
        job: of the build; its folder is not used.
        indices: of the frames, ascending.
        workers: processes of the build; None for one that uses all cores.
        renderer: of the job's recipe; it holds the scene of the first frame afterwards.

    Raises:
        PepperError: the frame cannot be rendered.
    """
    recipe = job.recipe.recipe
    with _threads_of_worker(workers), report_memory_errors():
        probe = render_probe(job, renderer, recipe.plan.frame(indices[0]))
    scenes, processes = count_scenes(recipe, indices), min(workers or 1, len(indices))
    return CostEstimate(
        index=indices[0],
        outputs=job.outputs,
        quality=job.quality,
        frames=len(indices),
        scenes=scenes,
        processes=processes,
        setup_s=probe.setup_s,
        frame_s=probe.frame_s,
        total_s=build_seconds(job, indices, processes, probe),
        memory_bytes=int(job.memory_bytes),
        frame_bytes=probe.frame_bytes,
        disk_bytes=probe.frame_bytes * len(indices),
    )


def render_probe(job: BuildJob, renderer: FrameRenderer, spec: FrameSpec) -> ProbeFrame:
    """Measure the cost of a frame, and of another one of the same scene, which takes no set-up."""
    # Frames whose plants differ share no scene, so the same frame is made again.
    recipe = job.recipe.recipe
    other = spec if varies_plants_per_frame(recipe) else _neighbour(recipe.plan, spec)
    rows: list[Row] = []
    with tempfile.TemporaryDirectory(prefix="pepperscene_plan_") as name:
        for folder, one in ((Path(name, "first"), spec), (Path(name, "further"), other)):
            with FrameMaker(replace(job, folder=folder), renderer=renderer) as maker:
                maker.make([one.index], lambda done: rows.append(done.row))
        files = [path for path in Path(name, "first").rglob("*") if path.is_file() and path.name != MARK]
        frame_bytes = sum(path.stat().st_size for path in files)
    first, further = rows
    # A frame is written while the next one is rendered.
    frame_s = max(further["render_s"], first["write_s"])
    return ProbeFrame(max(first["render_s"] - further["render_s"], 0.0), frame_s, frame_bytes)


def build_seconds(job: BuildJob, indices: Sequence[int], processes: int, probe: ProbeFrame) -> float:
    """Duration of a build: the longest of its processes, each of which takes a unit when it is idle.

    Every process that makes a part of a scene sets it up.
    """
    recipe = job.recipe.recipe
    busy_s = [0.0] * processes
    for unit in work_units(recipe.plan, indices, processes):
        seconds = probe.setup_s * count_scenes(recipe, unit.indices) + probe.frame_s * len(unit.indices)
        heapq.heapreplace(busy_s, busy_s[0] + seconds)
    return max(busy_s)


def _neighbour(plan: Plan, spec: FrameSpec) -> FrameSpec:
    """The next or the previous view of the same scene, twin and camera; the frame itself if there is none."""
    if spec.step + 1 < plan.frames:
        return plan.frame(spec.index + plan.cameras)
    return plan.frame(spec.index - plan.cameras) if spec.step else spec


@contextmanager
def _threads_of_worker(workers: int | None) -> Iterator[None]:
    """Give this process as many threads as each of some workers has, unless the environment sets a number.

    It has no effect if the renderer has already started in this process.
    """
    from pepperscene.render import wanted_threads

    before = dict(os.environ)
    if workers is not None and wanted_threads() is None:
        os.environ.update(dict.fromkeys(THREADS, str(max(1, available_cores() // workers))))
    try:
        yield
    finally:
        os.environ.clear()
        os.environ.update(before)
