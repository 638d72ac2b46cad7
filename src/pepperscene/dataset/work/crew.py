"""The interface of all who make frames."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Callable, Sequence
from typing import Final

from pepperscene.dataset.work.job import Job, Tell
from pepperscene.dataset.work.units import Unit
from pepperscene.errors import WorkerError

Notice = Callable[[str], None]
"""Called with a sentence for the user, such as that a worker was lost."""

MOST_LOSSES: Final = 3
"""Chosen: a frame that ends a third worker would end the next one, too."""


class Crew(ABC):
    """Makes the frames of a job."""

    @property
    @abstractmethod
    def size(self) -> int:
        """How many frames are made at a time."""

    @abstractmethod
    def make(self, job: Job, units: Sequence[Unit], tell: Tell, notice: Notice) -> None:
        """Make all that is missing.

        Args:
            job: what is asked for.
            units: the frames.
            tell: called in this thread for each frame, once it is whole.
            notice: called for what the user should know.

        Raises:
            PepperError: frames cannot be made; those that were told are whole.
        """


class Losses:
    """Counts the workers that were lost over each frame."""

    def __init__(self) -> None:
        self._over: Counter[int] = Counter()

    def note(self, index: int, how: str) -> str:
        """The sentence that tells of a lost worker.

        Args:
            index: the first frame that the worker had not told of.
            how: it ended.

        Raises:
            WorkerError: it is the third over this frame.
        """
        self._over[index] += 1
        if self._over[index] >= MOST_LOSSES:
            raise WorkerError(
                f"frame {index:06d} ended {MOST_LOSSES} workers, the last one {how}; the frames that are "
                "whole are kept, and the same command goes on: with fewer workers if memory ran out"
            )
        return f"a worker was lost over frame {index:06d} ({how}); its frames go to another one"
