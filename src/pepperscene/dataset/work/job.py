"""What a build asks of whoever makes its frames, and how frames are made, wherever that is."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from pepperscene.dataset.facts import about, frame_facts
from pepperscene.dataset.folder import OutputFolder
from pepperscene.dataset.recipe import Recipe
from pepperscene.dataset.rows import Row, row_of
from pepperscene.dataset.stage import RendererFactory, Stage
from pepperscene.dataset.store import FORMAT
from pepperscene.dataset.viewpoints import check_partner
from pepperscene.dataset.writer import Addition, FrameWriter, Written


@dataclass(frozen=True)
class Job:
    """All that the frames of a build depend on but for their indices; it can be pickled.

    Attributes:
        recipe: what is shown.
        folder: of the data set.
        outputs: names out of `OUTPUTS`.
        quality: "draft", "standard" or "reference".
        target_error: instead of the quality's own, or None.
        renderer: makes the renderer of a scene; None for Mitsuba.
    """

    recipe: Recipe
    folder: Path
    outputs: tuple[str, ...]
    quality: str = "standard"
    target_error: float | None = None
    renderer: RendererFactory | None = None

    def check(self) -> None:
        """Raise the `InputError` that tells what the recipe lacks, or what of its files is not valid."""
        check_partner(self.recipe, self.outputs)
        Stage(self.recipe, self.renderer)

    def about(self) -> dict[str, Any]:
        """What `dataset.json` is to say."""
        return about(self.recipe, self.quality, FORMAT, self.target_error)


@dataclass(frozen=True)
class Done:
    """What is told of a frame once it is whole.

    Attributes:
        index: of the frame.
        made: False when it was there already.
        row: of the manifest.
    """

    index: int
    made: bool
    row: Row


Tell = Callable[[Done], None]


class Maker:
    """Makes frames of a job in this process, one after the other; each is written while the next is rendered.

    Args:
        job: what is asked for.
        worker: who makes them, for the manifest.
        eager: tell of a frame as soon as it is whole, in another thread, while the next one is rendered.
    """

    def __init__(self, job: Job, worker: str = "", *, eager: bool = False) -> None:
        from pepperscene.render import quality_of

        self._job, self._worker = job, worker
        self._effort = quality_of(job.quality, job.target_error)
        self._stage = Stage(job.recipe, job.renderer)
        self._folder = OutputFolder(job.folder, job.about())
        self._writer = FrameWriter(self._folder, eager=eager)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, fault: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._writer.__exit__(kind, fault, trace)

    def make(self, indices: Iterable[int], tell: Tell, stop: Callable[[], bool] = lambda: False) -> None:
        """Make what is missing of some frames.

        Args:
            indices: of the frames.
            tell: called for each frame in order, once it is whole.
            stop: asked before each frame; True ends the work, with all begun frames whole.

        Raises:
            PepperError: a frame cannot be rendered or written; those before it are whole.
        """
        for index in indices:
            if stop():
                break
            # While this frame is rendered, the one before is written.
            begun = time.perf_counter()
            there = self._folder.dataset.intact(index)
            missing = tuple(name for name in self._job.outputs if name not in there.outputs)
            if not missing:
                self._writer.finish()
                tell(Done(index, False, row_of(there)))
                continue
            addition = self._addition(index, missing, there.facts, there.outputs)
            took = time.perf_counter() - begun
            self._writer.finish()
            self._writer.start(addition, partial(self._told, tell, index, took))
        self._writer.finish()

    def _addition(
        self, index: int, missing: tuple[str, ...], before: dict[str, Any], there: dict[str, Any]
    ) -> Addition:
        """What is missing of one frame, rendered."""
        shot = self._job.recipe.plan.shot(index)
        frame = self._stage.render(shot, missing, self._effort)

        def facts() -> dict[str, Any]:
            new = frame_facts(frame, shot, self._job.recipe.seed)
            if not new.get("instances"):
                # Without labels the renderer does not know what is in view; an earlier build may.
                new["instances"] = before.get("instances", {})
            return {**before, **new}

        return Addition(index, {name: frame.images[name] for name in missing}, facts, there)

    def _told(self, tell: Tell, index: int, render_s: float, written: Written) -> None:
        timed = {"render_s": render_s, "write_s": written.seconds, "worker": self._worker}
        tell(Done(index, True, {**row_of(written.standing), **timed}))
