"""Building a data set: the frames that are missing, each whole or not at all."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from pepperscene.dataset.facts import about, frame_facts
from pepperscene.dataset.folder import OutputFolder
from pepperscene.dataset.plan import Shot
from pepperscene.dataset.recipe import Recipe
from pepperscene.dataset.recipe_file import load_recipe
from pepperscene.dataset.stage import RendererFactory, Stage
from pepperscene.dataset.store import FORMAT, Dataset
from pepperscene.errors import OutputError
from pepperscene.frame import DEFAULT_OUTPUTS, check_outputs


@dataclass(frozen=True)
class Progress:
    """Told after each frame.

    Attributes:
        index: of the frame.
        done: frames so far, this one included.
        total: frames wanted.
        made: False when it was there already.
    """

    index: int
    done: int
    total: int
    made: bool


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
    on_frame: Callable[[Progress], None] | None = None,
    renderer: RendererFactory | None = None,
) -> BuildResult:
    """Render the frames of a recipe into a folder.

    Frames and outputs that are there already are kept, so that a build can be interrupted, continued and
    widened. A frame's bytes depend on the recipe, the version and its index alone.

    Args:
        recipe: or the name of a shipped one, or a path.
        out: folder of the data set; made when missing.
        frames: indices, or "A:B" (0-based, half-open); None for those that the recipe selects.
        outputs: names out of `OUTPUTS`.
        quality: "draft", "standard" or "reference".
        seed: instead of the recipe's.
        on_frame: called after every frame.
        renderer: makes the renderer of a scene; None for Mitsuba.

    Raises:
        InputError: an argument, the recipe or a file that it names is not valid; nothing is written.
        OutputError: the folder holds something else than this data set, or cannot be written to.
        SetupError: the machine cannot render; nothing is written.
    """
    # All that can be wrong with the arguments comes to light before the first file is touched.
    from pepperscene.render import quality_named

    wanted = check_outputs(outputs)
    quality_named(quality)
    told = (recipe if isinstance(recipe, Recipe) else load_recipe(recipe)).with_seed(seed)
    indices = told.plan.chosen(frames)
    stage = Stage(told, renderer)
    folder = OutputFolder(Path(out), about(told, quality, FORMAT))

    made: list[int] = []
    try:
        for done, index in enumerate(indices, 1):
            new = _build_frame(stage, folder, told.plan.shot(index), wanted, quality)
            made += [index] if new else []
            if on_frame is not None:
                on_frame(Progress(index, done, len(indices), new))
    except BaseException:
        folder.undo()
        raise
    kept = tuple(sorted(set(indices).difference(made)))
    return BuildResult(folder.dataset, tuple(made), kept)


def _build_frame(
    stage: Stage, folder: OutputFolder, shot: Shot, outputs: Sequence[str], quality: str
) -> bool:
    """Add what is missing of one frame; False when nothing is."""
    facts, there = folder.dataset.intact(shot.index)
    missing = [name for name in outputs if name not in there]
    if not missing:
        return False
    frame = stage.render(shot, missing, quality)
    new = frame_facts(frame, shot, stage.recipe.seed)
    if not new.get("instances"):
        # Without labels the renderer does not know what is in view; an earlier build may.
        new["instances"] = facts.get("instances", {})
    images = {name: frame.images[name] for name in missing}
    try:
        folder.prepare(tuple(missing))
        folder.dataset.commit(shot.index, images, {**facts, **new}, there)
    except OSError as fault:
        where = fault.filename or folder.dataset.folder
        raise OutputError(f"{where}: cannot be written ({fault.strerror or fault})") from None
    return True
