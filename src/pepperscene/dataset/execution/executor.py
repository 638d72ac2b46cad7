"""Which frames are made together: a scene's, because they share what is costly."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import Counter, deque
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from itertools import groupby
from typing import Final

from pepperscene.dataset.execution.job import BuildJob, Tell
from pepperscene.dataset.recipe.plan import Plan
from pepperscene.errors import WorkerError


@dataclass(frozen=True)
class WorkUnit:
    """Frames of one scene.

    Attributes:
        set, rotation: the scene.
        indices: of the frames, ascending.
    """

    set: int
    rotation: int
    indices: tuple[int, ...]

    def after(self, told: Iterable[int]) -> WorkUnit:
        """What is left of it once some frames are whole."""
        whole = set(told)
        return WorkUnit(self.set, self.rotation, tuple(i for i in self.indices if i not in whole))


def work_units(plan: Plan, indices: Sequence[int], workers: int) -> list[WorkUnit]:
    """The frames by scenes; where there are fewer scenes than workers, in parts of scenes.

    A scene is made ready anew by everybody who has a part of it, which takes as long as tens of frames'
    labels; so scenes are parted only where somebody would stand idle.

    Args:
        plan: of the data set.
        indices: ascending.
        workers: that are to have something to do.
    """
    shots = [plan.frame(index) for index in indices]
    scenes = [
        WorkUnit(*key, tuple(shot.index for shot in group))
        for key, group in groupby(shots, lambda shot: (shot.set, shot.rotation))
    ]
    while 0 < len(scenes) < workers:
        longest = max(range(len(scenes)), key=lambda place: len(scenes[place].indices))
        unit = scenes[longest]
        half = -(-len(unit.indices) // 2)
        if half == len(unit.indices):
            break
        parts = (unit.indices[:half], unit.indices[half:])
        scenes[longest : longest + 1] = [WorkUnit(unit.set, unit.rotation, part) for part in parts]
    return scenes


class UnitQueue:
    """Hands units out so that plants of a set are grown as few times as may be."""

    def __init__(self, units: Iterable[WorkUnit]) -> None:
        self._left: dict[int, deque[WorkUnit]] = {}
        for unit in units:
            self._left.setdefault(unit.set, deque()).append(unit)
        self._begun: set[int] = set()

    def __bool__(self) -> bool:
        return bool(self._left)

    def next(self, last: WorkUnit | None) -> WorkUnit | None:
        """The next unit of somebody whose last one is given; None when none is left."""
        if not self._left:
            return None
        if last is not None and last.set in self._left:
            return self._taken(last.set, first=True)
        untouched = [which for which in self._left if which not in self._begun]
        if untouched:
            return self._taken(untouched[0], first=True)
        # Whoever is at the set with the most to do is helped from its end.
        return self._taken(max(self._left, key=lambda which: len(self._left[which])), first=False)

    def put_back(self, unit: WorkUnit) -> None:
        """A unit, or the rest of one, that was not finished."""
        if unit.indices:
            self._left.setdefault(unit.set, deque()).appendleft(unit)

    def _taken(self, which: int, *, first: bool) -> WorkUnit:
        self._begun.add(which)
        units = self._left[which]
        unit = units.popleft() if first else units.pop()
        if not units:
            del self._left[which]
        return unit


Notice = Callable[[str], None]
"""Called with a sentence for the user, such as that a worker was lost."""

MOST_LOSSES: Final = 3
"""Chosen: a frame that ends a third worker would end the next one, too."""


class Executor(ABC):
    """Makes the frames of a job."""

    @property
    @abstractmethod
    def size(self) -> int:
        """How many frames are made at a time."""

    @abstractmethod
    def make(self, job: BuildJob, units: Sequence[WorkUnit], tell: Tell, notice: Notice) -> None:
        """Make all that is missing.

        Args:
            job: what is asked for.
            units: the frames.
            tell: called in this thread for each frame, once it is whole.
            notice: called for what the user should know.

        Raises:
            PepperError: frames cannot be made; those that were told are whole.
        """


class LostWorkers:
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
