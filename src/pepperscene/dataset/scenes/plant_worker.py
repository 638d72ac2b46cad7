"""A second process that makes plants of a set while this one makes others: plants depend on nothing but
their address, so that it does not matter who makes which.
"""

from __future__ import annotations

import os
import pickle
import sys
import threading
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from types import TracebackType
from typing import TYPE_CHECKING, Final, Self

from pepperscene.dataset.subprocess_rpc import WorkerProcess, listening, say
from pepperscene.errors import InputError

if TYPE_CHECKING:
    from pepperscene.cultivar import Cultivar
    from pepperscene.dataset.recipe.recipe import Recipe
    from pepperscene.dataset.scenes.scene_builder import PlacedPlant


VARIABLE: Final = "PEPPERSCENE_PROCESSES"
"""Environment variable that says in how many processes plants are made: 1 or 2. Where several builds share a
machine, 1 is right."""

_LEAST: Final = 6  # plants of a set, chosen: starting a process takes as long as making three


def processes(wanted: int | None = None) -> int:
    """In how many processes plants are made: as wanted, or as the environment says, or one for each core.

    Raises:
        InputError: neither 1 nor 2 is wanted.
    """
    told = str(wanted) if wanted is not None else os.environ.get(VARIABLE, "").strip()
    if told in ("1", "2"):
        return int(told)
    if told:
        raise InputError(VARIABLE, f"must be 1 or 2, not {told}")
    # A worker of somebody's pool has its core, and no more.
    worker = "multiprocessing" in sys.modules and sys.modules["multiprocessing"].parent_process() is not None
    return 1 if worker or available_cores() < 2 else 2


def make_plants_in_two_processes(
    recipe: Recipe, cultivar: Cultivar, which: int, count: int, make: Callable[[int, int], PlacedPlant]
) -> list[PlacedPlant]:
    """The plants of a set, some made here and some in a second process; the same as if all were made here.

    Args:
        recipe: of the set.
        cultivar: of the plants.
        which: set.
        count: plants of it.
        make: makes a plant here, by set and number.
    """
    if count < _LEAST:
        return [make(which, number) for number in range(count)]
    left, made = deque(range(count)), dict[int, "PlacedPlant"]()
    with _Second(recipe, cultivar, which, left) as second:
        while (number := _next(left.popleft)) is not None:
            made[number] = make(which, number)
        made |= second.made()
    # What the second process failed at is tried here, where it is told what is wrong.
    return [made[number] if number in made else make(which, number) for number in range(count)]


class _Second:
    """The second process and the thread that talks to it.

    Args:
        recipe: of the set.
        cultivar: of the plants.
        which: set.
        left: numbers of the plants that nobody has begun; the second process takes them from the end.
    """

    def __init__(self, recipe: Recipe, cultivar: Cultivar, which: int, left: deque[int]) -> None:
        self._asked, self._which, self._left = (recipe, cultivar), which, left
        self._made: dict[int, PlacedPlant] = {}
        self._child: WorkerProcess | None = None
        self._thread = threading.Thread(target=self._talk, name="second process", daemon=True)

    def __enter__(self) -> Self:
        with suppress(OSError):
            self._child = WorkerProcess(__name__)
            self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, fault: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._child is None:
            return
        self._left.clear()
        if self._thread.is_alive():
            # Only where this process has failed or was told to stop.
            self._child.kill()
        self._thread.join()
        self._child.close()

    def made(self) -> dict[int, PlacedPlant]:
        """The plants that it made, by their numbers; waits for the last."""
        if self._child is not None:
            self._thread.join()
        return self._made

    def _talk(self) -> None:
        child = self._child
        if child is None:
            return
        with suppress(OSError, EOFError):
            if not child.same():
                return
            child.say(self._asked)
            while (number := _next(self._left.pop)) is not None:
                child.say((self._which, number))
                self._made[number] = child.hear()


def _next(take: Callable[[], int]) -> int | None:
    """The next number, or None where none is left."""
    try:
        return take()
    except IndexError:
        return None


def available_cores() -> int:
    """Processor cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def serve() -> None:
    """The second process: makes the plants that it is asked for until its input ends."""
    asked, told = listening()
    with told, suppress(EOFError, BrokenPipeError):
        from pepperscene.dataset.scenes.scene_builder import SceneBuilder

        recipe, cultivar = pickle.load(asked)
        planting = SceneBuilder(recipe, cultivar, in_processes=1)
        while True:
            which, number = pickle.load(asked)
            say(told, planting.plant(which, number))
