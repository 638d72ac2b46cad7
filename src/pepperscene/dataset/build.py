"""Building a data set: the frames that are missing, each whole or not at all."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pepperscene.dataset.facts import about, frame_facts
from pepperscene.dataset.folder import OutputFolder
from pepperscene.dataset.plan import Shot
from pepperscene.dataset.recipe import Recipe
from pepperscene.dataset.recipe_file import load_recipe
from pepperscene.dataset.stage import RendererFactory, Stage
from pepperscene.dataset.store import FORMAT, Dataset
from pepperscene.dataset.writer import Addition, FrameWriter
from pepperscene.frame import DEFAULT_OUTPUTS, check_outputs

if TYPE_CHECKING:
    from pepperscene.render import Quality


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
    target_error: float | None = None,
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
        target_error: of the traced light over the sensor's noise, at which sampling stops, instead of the
            quality's own; see `pepperscene.render.render`.
        on_frame: called after every frame, in order, once it is whole; by then the next one may be rendered.
        renderer: makes the renderer of a scene; None for Mitsuba.

    Raises:
        InputError: an argument, the recipe or a file that it names is not valid; nothing is written.
        OutputError: the folder holds something else than this data set, or cannot be written to.
        SetupError: the machine cannot render; nothing is written.
    """
    # All that can be wrong with the arguments comes to light before the first file is touched.
    from pepperscene.render import quality_of

    wanted = check_outputs(outputs)
    effort = quality if target_error is None else quality_of(quality, target_error)
    quality_of(effort)
    told = (recipe if isinstance(recipe, Recipe) else load_recipe(recipe)).with_seed(seed)
    indices = told.plan.chosen(frames)
    stage = Stage(told, renderer)
    folder = OutputFolder(Path(out), about(told, quality, FORMAT, target_error))

    made: list[int] = []
    told_of = itertools.count(1)

    def tell(index: int, new: bool) -> None:
        made.extend([index] if new else [])
        done = next(told_of)
        if on_frame is not None:
            on_frame(Progress(index, done, len(indices), new))

    try:
        with FrameWriter(folder) as writer:
            for index in indices:
                # While this frame is rendered, the one before is written.
                addition = _addition(stage, folder.dataset, told.plan.shot(index), wanted, effort)
                writer.finish()
                if addition is None:
                    tell(index, False)
                else:
                    writer.start(addition, partial(tell, index, True))
            writer.finish()
    except BaseException:
        folder.undo()
        raise
    kept = tuple(sorted(set(indices).difference(made)))
    return BuildResult(folder.dataset, tuple(made), kept)


def _addition(
    stage: Stage, dataset: Dataset, shot: Shot, outputs: Sequence[str], quality: str | Quality
) -> Addition | None:
    """What is missing of one frame, rendered; None when nothing is."""
    before, there = dataset.intact(shot.index)
    missing = [name for name in outputs if name not in there]
    if not missing:
        return None
    frame = stage.render(shot, missing, quality)

    def facts() -> dict[str, Any]:
        new = frame_facts(frame, shot, stage.recipe.seed)
        if not new.get("instances"):
            # Without labels the renderer does not know what is in view; an earlier build may.
            new["instances"] = before.get("instances", {})
        return {**before, **new}

    return Addition(shot.index, {name: frame.images[name] for name in missing}, facts, there)
