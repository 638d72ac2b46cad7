"""A dry run of a build: its plan, its cost, a picture of its camera places, and their poses."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final

from pepperscene.atomic import check_can_write, write_files
from pepperscene.building.execution.build import choose_executor
from pepperscene.building.execution.job import BuildJob, BuildOptions
from pepperscene.building.scenes.frame_renderer import FrameRenderer
from pepperscene.errors import ArgumentError
from pepperscene.outputs import DEFAULT_OUTPUTS
from pepperscene.recipe.resolve.resolved import ResolvedRecipe
from pepperscene.review.preview.cost import CostEstimate, estimate_cost
from pepperscene.review.preview.places import (
    check_can_write_poses,
    pose_format,
    scene_places,
    write_selected_poses,
)
from pepperscene.review.preview.summary import PlanSummary, summarise_plan

_PICTURE_SUFFIX: Final = ".png"


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
        (options.on_notice or _ignore)(f"frame {indices[0]} is rendered to estimate the cost")
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


def _ignore(_: object) -> None:
    """Ignore a notice."""
