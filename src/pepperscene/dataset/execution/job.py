"""What a build asks of whoever makes its frames, and how frames are made, wherever that is."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from types import TracebackType
from typing import Any, Final, Self

from numpy.typing import NDArray

from pepperscene.dataset.recipe.recipe import Recipe
from pepperscene.dataset.scenes.frame_renderer import FrameRenderer, RendererFactory
from pepperscene.dataset.scenes.viewpoints import check_partner
from pepperscene.dataset.store.dataset import FORMAT, FrameStatus
from pepperscene.dataset.store.folder import OutputFolder
from pepperscene.dataset.store.metadata import dataset_info, frame_metadata
from pepperscene.dataset.store.rows import Row, row_of
from pepperscene.errors import OutputError

_AT_ONCE: Final = 4
"""Chosen: images that are written at a time. More than there are processors often are, because each waits for
the disk a third of its time."""


@dataclass(frozen=True, eq=False)
class Addition:
    """What is to be added of one frame.

    Attributes:
        index: of the frame.
        images: arrays by output name.
        facts: makes the whole JSON but for its `outputs`; called in the background.
        kept: entries of the outputs that are there already.
    """

    index: int
    images: Mapping[str, NDArray[Any]]
    facts: Callable[[], Mapping[str, Any]]
    kept: Mapping[str, Any]


@dataclass(frozen=True, eq=False)
class Written:
    """A frame that is whole.

    Attributes:
        standing: what is there of it now.
        seconds: that writing took.
    """

    standing: FrameStatus
    seconds: float


class FrameWriter:
    """Writes one frame at a time behind the caller's back; none begins before the last one is whole.

    So memory holds the images of two frames, and the order in which frames come to count is the caller's. On
    leaving the `with` block, also by an exception, the frame that is being written is finished first.

    Args:
        folder: of the data set.
        eager: tell of a frame in the thread that writes it, as soon as it is whole, not by `finish`.
    """

    def __init__(self, folder: OutputFolder, *, eager: bool = False) -> None:
        self._folder, self._eager = folder, eager
        self._frames = ThreadPoolExecutor(1, "frame")
        self._images = ThreadPoolExecutor(_AT_ONCE, "image")
        self._prepared: set[str] = set()
        self._under_way: tuple[Future[Written], Callable[[Written], None]] | None = None

    def __enter__(self) -> FrameWriter:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, fault: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._frames.shutdown()
        self._images.shutdown()

    def start(self, addition: Addition, then: Callable[[Written], None]) -> None:
        """Begin to write, once the frame before has been finished.

        Args:
            addition: what is written.
            then: called when the frame is whole.

        Raises:
            OutputError: the frame before could not be written.
        """
        self.finish()
        self._under_way = self._frames.submit(self._done, addition, then), then

    def finish(self) -> None:
        """Wait until the frame that is being written is whole, if there is one.

        Raises:
            OutputError: it could not be written; nothing of it is left.
        """
        if self._under_way is None:
            return
        (written, then), self._under_way = self._under_way, None
        whole = written.result()
        if not self._eager:
            then(whole)

    def _done(self, addition: Addition, then: Callable[[Written], None]) -> Written:
        whole = self._write(addition)
        if self._eager:
            then(whole)
        return whole

    def _write(self, addition: Addition) -> Written:
        dataset, begun = self._folder.dataset, time.perf_counter()
        try:
            # Folders are made and swept once in a build, not once a frame: sweeping reads them whole.
            new = [name for name in addition.images if name not in self._prepared]
            if new:
                self._folder.prepare(tuple(new))
                self._prepared.update(new)
            standing = dataset.commit(
                addition.index, addition.images, addition.facts(), addition.kept, self._images
            )
        except OSError as fault:
            where = fault.filename or dataset.folder
            raise OutputError(f"{where}: cannot be written ({fault.strerror or fault})") from None
        return Written(standing, time.perf_counter() - begun)


@dataclass(frozen=True)
class BuildJob:
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
        FrameRenderer(self.recipe, self.renderer)

    def about(self) -> dict[str, Any]:
        """What `dataset.json` is to say."""
        return dataset_info(self.recipe, self.quality, FORMAT, self.target_error)


@dataclass(frozen=True)
class FrameDone:
    """What is told of a frame once it is whole.

    Attributes:
        index: of the frame.
        made: False when it was there already.
        row: of the manifest.
    """

    index: int
    made: bool
    row: Row


Tell = Callable[[FrameDone], None]


class FrameMaker:
    """Makes frames of a job in this process, one after the other; each is written while the next is rendered.

    Args:
        job: what is asked for.
        worker: who makes them, for the manifest.
        eager: tell of a frame as soon as it is whole, in another thread, while the next one is rendered.
    """

    def __init__(self, job: BuildJob, worker: str = "", *, eager: bool = False) -> None:
        from pepperscene.render import resolve_quality

        self._job, self._worker = job, worker
        self._effort = resolve_quality(job.quality, job.target_error)
        self._stage = FrameRenderer(job.recipe, job.renderer)
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
                tell(FrameDone(index, False, row_of(there)))
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
        shot = self._job.recipe.plan.frame(index)
        frame = self._stage.render(shot, missing, self._effort)

        def facts() -> dict[str, Any]:
            new = frame_metadata(frame, shot, self._job.recipe.seed)
            if not new.get("instances"):
                # Without labels the renderer does not know what is in view; an earlier build may.
                new["instances"] = before.get("instances", {})
            return {**before, **new}

        return Addition(index, {name: frame.images[name] for name in missing}, facts, there)

    def _told(self, tell: Tell, index: int, render_s: float, written: Written) -> None:
        timed = {"render_s": render_s, "write_s": written.seconds, "worker": self._worker}
        tell(FrameDone(index, True, {**row_of(written.standing), **timed}))
