"""A single frame of a recipe in a folder of its own, to look at or to try a setting."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any, Final

from numpy.typing import NDArray

from pepperscene.dataset.recipe.load import load_recipe
from pepperscene.dataset.recipe.recipe import Recipe
from pepperscene.dataset.scenes.frame_renderer import FrameRenderer, RendererFactory
from pepperscene.dataset.scenes.viewpoints import check_partner
from pepperscene.dataset.store.atomic import atomic_write, canonical_json, digest
from pepperscene.dataset.store.dataset import MARK, read_json, written_image
from pepperscene.dataset.store.folder import check_can_create, make_folder, remove
from pepperscene.dataset.store.metadata import dataset_info, frame_metadata
from pepperscene.errors import InputError, OutputError
from pepperscene.frame import DEFAULT_OUTPUTS, OUTPUTS, check_outputs

FORMAT: Final = "pepperscene frame 1"
FACTS: Final = "frame.json"


def render_frame(
    recipe: Recipe | str | Path,
    out: str | Path,
    index: int | None = None,
    outputs: Sequence[str] = DEFAULT_OUTPUTS,
    quality: str = "standard",
    seed: int | None = None,
    renderer: RendererFactory | None = None,
    target_error: float | None = None,
) -> tuple[Path, ...]:
    """Render one frame into a folder: an image for each output, and `frame.json`.

    The images are those that a build makes of this frame, bit for bit. Those that an earlier call left in the
    folder are replaced, or removed where this call makes none of that name: the folder shows one frame.

    Args:
        recipe: or the name of a shipped one, or a path.
        out: the folder; made when missing. Files that are none of a frame's are left alone.
        index: of the frame; None for the first that the recipe selects.
        outputs: names out of `OUTPUTS`.
        quality: "draft", "standard" or "reference".
        seed: instead of the recipe's.
        target_error: of the traced light over the sensor's noise, at which sampling stops, instead of the
            quality's own; see `pepperscene.render.render`.
        renderer: makes the renderer of a scene; None for Mitsuba.

    Returns:
        The files, the images in the order of `OUTPUTS` and `frame.json` at the end.

    Raises:
        InputError: an argument, the recipe or a file that it names is not valid; nothing is written.
        OutputError: the folder belongs to a data set, or cannot be written to.
        SetupError: the machine cannot render; nothing is written.
    """
    # All that can be wrong with the arguments comes to light before light is traced.
    from pepperscene.render import resolve_quality

    wanted = check_outputs(outputs)
    effort = quality if target_error is None else resolve_quality(quality, target_error)
    resolve_quality(effort)
    told = (recipe if isinstance(recipe, Recipe) else load_recipe(recipe)).with_seed(seed)
    chosen = told.plan.select_indices(None if index is None else [index], "frame")
    shot = told.plan.frame(chosen[0])
    folder = Path(out)
    check_partner(told, wanted)
    _examine(folder, wanted)

    frame = FrameRenderer(told, renderer).render(shot, wanted, effort)
    facts = {**dataset_info(told, quality, FORMAT, target_error), **frame_metadata(frame, shot, told.seed)}
    try:
        return _write(folder, {name: frame.images[name] for name in wanted}, facts)
    except OSError as fault:
        where = fault.filename or folder
        raise OutputError(f"{where}: cannot be written ({fault.strerror or fault})") from None


def _examine(folder: Path, outputs: Sequence[str]) -> None:
    """Raise the `OutputError` that tells why the folder cannot take these images, if there is a reason."""
    check_can_create(folder)
    for place in (folder, folder.absolute().parent):
        if (place / MARK).exists():
            raise OutputError(
                f"{folder}: belongs to a data set; `build` adds frames to it, or choose another"
            )
    for name in (*(_file(output) for output in outputs), FACTS):
        if (folder / name).is_dir():
            raise OutputError(f"{folder / name}: is a folder where a file is to be written")


def _write(folder: Path, images: Mapping[str, NDArray[Any]], facts: Mapping[str, Any]) -> tuple[Path, ...]:
    """Write all files under other names, and only when all are whole let them take their places."""
    made: list[Path] = []
    try:
        make_folder(folder, made)
        before, entries = _earlier(folder), {}
        with ExitStack() as stack:
            # The stack unwinds from its end: `frame.json` comes last, and stands beside whole files only.
            told = stack.enter_context(atomic_write(folder / FACTS))
            for output, image in images.items():
                temporary = stack.enter_context(atomic_write(folder / _file(output)))
                entries[output] = written_image(temporary, image, output, _file(output))
            told.write_bytes(canonical_json({**facts, "outputs": entries}))
            (folder / FACTS).unlink(missing_ok=True)
            for path in before:
                if path.name not in {_file(output) for output in images}:
                    path.unlink(missing_ok=True)
    except BaseException:
        remove(made)
        raise
    return (*(folder / _file(output) for output in images), folder / FACTS)


def _earlier(folder: Path) -> list[Path]:
    """The images of an earlier call, as far as they are still what it wrote."""
    try:
        told = read_json(folder / FACTS)["outputs"]
        names = {output: folder / _file(output) for output in OUTPUTS if output in told}
        return [path for output, path in names.items() if digest(path) == told[output]["sha256"]]
    except (InputError, KeyError, TypeError, OSError):
        return []


def _file(output: str) -> str:
    return f"{output}{OUTPUTS[output].suffix}"
