"""What a build costs, estimated from a probe: one frame that is rendered into a temporary folder."""

from __future__ import annotations

import heapq
import os
import tempfile
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

from pepperscene.atomic import write_error
from pepperscene.building.execution.executor import work_units
from pepperscene.building.execution.job import BuildJob
from pepperscene.building.memory import report_memory_errors
from pepperscene.building.scenes.frame_renderer import FrameRenderer
from pepperscene.building.subprocess_rpc import THREADS, available_cores
from pepperscene.dataset.store.dataset import MARK
from pepperscene.dataset.store.folder import OutputFolder
from pepperscene.frame import Frame
from pepperscene.recipe.plan import FrameSpec, Plan
from pepperscene.review.preview.summary import count_scenes, varies_plants_per_frame


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
    """Measure the cost of a frame; a second frame of the same scene is rendered without the set-up."""
    from pepperscene.render import resolve_quality

    quality = resolve_quality(job.quality, job.target_error)
    start = time.perf_counter()
    frame = renderer.render(spec, job.outputs, quality)
    first_s = time.perf_counter() - start
    with tempfile.TemporaryDirectory(prefix="pepperscene_plan_") as folder:
        start = time.perf_counter()
        frame_bytes = _write_frame(replace(job, folder=Path(folder)), frame, spec)
        write_s = time.perf_counter() - start
    # Frames whose plants differ share no scene, so the same frame is rendered again.
    recipe = job.recipe.recipe
    other = spec if varies_plants_per_frame(recipe) else _neighbour(recipe.plan, spec)
    start = time.perf_counter()
    renderer.render(other, job.outputs, quality)
    further_s = time.perf_counter() - start
    # A frame is written while the next one is rendered.
    return ProbeFrame(max(first_s - further_s, 0.0), max(further_s, write_s), frame_bytes)


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


def _write_frame(job: BuildJob, frame: Frame, spec: FrameSpec) -> int:
    """Write a frame as a build does; returns the bytes of its files."""
    folder = OutputFolder(job.folder, job.info)
    try:
        folder.prepare(job.outputs)
        dataset = folder.dataset
        images = {name: frame.images[name] for name in job.outputs}
        with ThreadPoolExecutor(len(images)) as pool:
            metadata = job.frame_metadata(frame, spec)
            dataset.commit(spec.index, images, metadata, dataset.intact(spec.index), pool)
        files = [path for path in job.folder.rglob("*") if path.is_file() and path.name != MARK]
        return sum(path.stat().st_size for path in files)
    except OSError as error:
        raise write_error(error, job.folder) from None


@contextmanager
def _threads_of_worker(workers: int | None) -> Iterator[None]:
    """Give this process as many threads as each of some workers has, unless the environment sets a number.

    It has no effect if the renderer has already started in this process.
    """
    from pepperscene.render import wanted_threads

    if workers is None or wanted_threads() is not None:
        yield
        return
    before = {name: os.environ.get(name) for name in THREADS}
    os.environ.update(dict.fromkeys(THREADS, str(max(1, available_cores() // workers))))
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value
