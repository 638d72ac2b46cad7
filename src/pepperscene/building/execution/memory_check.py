"""Checks that the frames of a build fit into memory, before the renderer is imported or a file is written."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

from pepperscene.building.execution.job import BuildJob
from pepperscene.building.execution.memory import (
    MEMORY,
    MemoryLimit,
    format_size,
    least,
    memory_limits,
    shortage,
)
from pepperscene.building.scenes.plant_size import plant_triangles
from pepperscene.building.scenes.scene_size import scene_triangles
from pepperscene.errors import ArgumentError, PepperError, SetupError
from pepperscene.recipe.resolve.frame_setups import frame_values
from pepperscene.recipe.resolve.load_camera import load_camera
from pepperscene.recipe.views_tables import RandomViews

if TYPE_CHECKING:
    from pepperscene.camera import Camera
    from pepperscene.recipe.recipe import Recipe

_SAMPLE: Final = 32
"""Chosen: evenly spaced frames whose cameras are compared, if cameras differ between frames."""
_SEARCH_TREE_BYTES: Final = 110  # per triangle, of the search trees of random views; measured 105
_OR: Final = f", or set {MEMORY} if the estimate is wrong"


def check_memory(job: BuildJob, processes: int = 1, frames: int = 1) -> None:
    """Raise an error if processes of this machine cannot make the frames of a job.

    Jobs with a renderer of their own are not checked.

    Args:
        job: of the build.
        processes: that make a frame each at a time.
        frames: number of all frames; with several, one is written while the next is rendered.

    Raises:
        ArgumentError: fewer processes would fit.
        SetupError: not even one process fits.
        InputError: the environment variable `MEMORY` is not valid.
    """
    _check_limits(job, min(processes, frames), frames, memory_limits())


def check_worker_memory(job: BuildJob, allowed: int | None = None) -> None:
    """Raise `SetupError` if a worker of a cluster cannot make the frames of a job.

    Args:
        job: of the build.
        allowed: bytes that the cluster allows the worker; None if it sets no limit.
    """
    limits = memory_limits()
    if allowed and limits:
        limits += (MemoryLimit(int(allowed), "allowed for this worker by the cluster"),)
    _check_limits(job, 1, 2, limits)


def process_memory(job: BuildJob, frames: int = 1) -> int:
    """Bytes that one process takes at most to make frames of a job.

    The plants of the first set are drawn for the estimate, but not built.
    """
    row = job.recipe.recipe.row
    plants = row.plants_front + row.plants_back
    largest = plant_triangles(job.recipe.cultivar, job.recipe.recipe.seed, plants)
    return _process_memory(job, scene_triangles(job.recipe, largest), frames)


def _check_limits(job: BuildJob, processes: int, frames: int, limits: tuple[MemoryLimit, ...]) -> None:
    if job.renderer is not None or not limits:
        return
    problem = _problem(job, process_memory(job, frames), processes, limits)
    if problem is not None:
        raise problem


def _process_memory(job: BuildJob, triangles: int, frames: int) -> int:
    """Bytes that one process takes at most."""
    from pepperscene.render import resolve_quality
    from pepperscene.render.memory import depth_memory, frame_memory, written_memory

    quality, cameras = resolve_quality(job.quality, job.target_error), _cameras(job)
    needed = max(frame_memory(camera, job.outputs, quality, triangles) for camera in cameras)
    if job.recipe.depth_camera is not None:
        depth_camera = job.recipe.depth_camera
        needed = max(needed, depth_memory(depth_camera, job.outputs, quality, triangles))
    if isinstance(job.recipe.recipe.views, RandomViews):
        needed += _SEARCH_TREE_BYTES * triangles
    return needed + (max(written_memory(camera, job.outputs) for camera in cameras) if frames > 1 else 0)


def _cameras(job: BuildJob) -> list[Camera]:
    """The different cameras of a sample of the frames; the only camera if nothing is varied."""
    recipe = job.recipe.recipe
    if not (recipe.variation or recipe.twins or recipe.rig):
        return [job.recipe.camera]
    plan = recipe.plan
    every_camera, every_twin = range(plan.cameras), range(0, plan.scene_frames, plan.frames * plan.cameras)
    evenly_spaced = range(0, plan.count, math.ceil(plan.count / _SAMPLE))
    indices = {*every_camera, *every_twin, *evenly_spaced}
    tables: dict[object, Recipe] = {}
    for index in sorted(indices):
        values = frame_values(recipe, plan.frame(index)).recipe
        tables.setdefault((values.camera, values.developing), values)
    return [load_camera(values) for values in tables.values()]


def _problem(
    job: BuildJob, needed: int, processes: int, limits: tuple[MemoryLimit, ...]
) -> PepperError | None:
    """The error if processes that take `needed` bytes each exceed a limit."""
    from pepperscene.render.memory import reserved_address_space

    missing = shortage(needed, reserved_address_space(), limits)
    if missing is not None:
        return SetupError(
            f"{_describe_frame(job)} needs {missing}; use a smaller sensor or fewer outputs{_OR}"
        )
    shared = least(limits, is_shared=True)
    if shared is None or needed * processes <= shared.size:
        return None
    return ArgumentError(
        "workers",
        f"{processes} need about {format_size(processes * needed)} of memory, {format_size(needed)} each, "
        f"and {format_size(shared.size)} are {shared.reason}; use at most {shared.size // needed}{_OR}",
    )


def _describe_frame(job: BuildJob) -> str:
    camera, row = job.recipe.camera, job.recipe.recipe.row
    return (
        f"{job.recipe.recipe.name}: a frame of {camera.width} x {camera.height} pixels and "
        f"{row.plants_front + row.plants_back} plants with the outputs {', '.join(job.outputs)}"
    )
