"""Frames are written while the next one is made."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from types import TracebackType
from typing import Any, Final

from numpy.typing import NDArray

from pepperscene.dataset.folder import OutputFolder
from pepperscene.dataset.store import Standing
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

    standing: Standing
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
