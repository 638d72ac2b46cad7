"""Render a single frame of a recipe into a folder, to try settings."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Final

from pepperscene.atomic import canonical_json, check_can_write, digest, write_files
from pepperscene.building.execution.job import BuildJob, BuildOptions
from pepperscene.building.memory import report_memory_errors
from pepperscene.building.scenes.frame_renderer import FrameRenderer
from pepperscene.dataset.store.dataset import MARK
from pepperscene.dataset.store.frame_json import file_entry, read_json
from pepperscene.dataset.store.images import NO_PHOTO, encode_image, recorded_bands
from pepperscene.errors import ArgumentError, InputError, OutputError
from pepperscene.outputs import DEFAULT_OUTPUTS, OUTPUTS
from pepperscene.recipe.recipe import Recipe
from pepperscene.recipe.resolve.resolved import ResolvedRecipe

FORMAT: Final = "pepperscene frame 1"
METADATA: Final = "frame.json"


def render_frame(
    recipe: Recipe | ResolvedRecipe | str | Path,
    out: str | Path,
    index: int | None = None,
    outputs: Sequence[str] = DEFAULT_OUTPUTS,
    options: BuildOptions = BuildOptions(),  # noqa: B008 - frozen
    on_stage: Callable[[str], None] | None = None,
) -> tuple[Path, ...]:
    """Render one frame into a folder: an image for each output, and `frame.json`.

    The images are those that a build makes of this frame, bit for bit. Images of an earlier call are
    replaced, or removed if this call makes none of that name: the folder shows one frame.

    Args:
        recipe: a recipe, the name of a shipped one, or a path.
        out: the folder; made if missing. Other files in it are left alone.
        index: of the frame; None for the first that the recipe selects.
        outputs: names from `OUTPUTS`.
        options: quality, target error, seed, renderer and `allow_code`; the others are for builds and must be
            None.
        on_stage: called with the name of each stage when it begins.

    Returns:
        The files: the images in the order of `OUTPUTS`, then `frame.json`.

    Raises:
        InputError: an argument, the recipe or a file that it names is not valid; nothing is written.
        OutputError: the folder belongs to a data set, or cannot be written to.
        SetupError: the machine cannot render; nothing is written.
    """
    # Check all arguments before light is traced.
    for name in ("workers", "scheduler", "slurm"):
        if getattr(options, name) is not None:
            raise ArgumentError(name, "applies to builds, not to a single frame")
    job = BuildJob.create(recipe, out, outputs, options)
    job.recipe.check_code()
    spec = job.recipe.recipe.plan.first_frame(index)
    folder = Path(out)
    for path in (folder, folder.absolute().parent):
        if (path / MARK).exists():
            raise OutputError(
                f"{folder}: belongs to a data set; add frames to it with `build`, or choose another folder"
            )
    names = {output: f"{output}{OUTPUTS[output].suffix}" for output in job.outputs}
    job.check_memory()
    check_can_write(folder, [*names.values(), METADATA])

    # Render, encode, and write all files or none.
    with report_memory_errors():
        renderer = FrameRenderer(job.recipe, job.renderer, on_stage=on_stage)
        frame = renderer.render(spec, job.outputs, job.resolved_quality)
        if on_stage is not None:
            on_stage("writing files")
        details = recorded_bands(frame.metadata), frame.metadata.get("photo", NO_PHOTO)
        files = {name: encode_image(frame.images[output], output, *details) for output, name in names.items()}
    entries = {output: file_entry(name, files[name]) for output, name in names.items()}
    metadata = {**job.info, "format": FORMAT, **job.frame_metadata(frame, spec), "outputs": entries}
    files[METADATA] = canonical_json(metadata)
    return write_files(folder, files, obsolete=[folder / METADATA, *_earlier_images(folder)])


def _earlier_images(folder: Path) -> list[Path]:
    """The images of an earlier call, unless they were changed since."""
    try:
        entries = read_json(folder / METADATA)["outputs"]
        paths = {
            output: folder / f"{output}{OUTPUTS[output].suffix}" for output in OUTPUTS if output in entries
        }
        return [
            path
            for output, path in paths.items()
            if digest(path, OUTPUTS[output].file_kind) == entries[output]["sha256"]
        ]
    except (InputError, KeyError, TypeError, OSError):
        return []
