"""Frames examined one by one, here or by several processes, and told in their order."""

from __future__ import annotations

import pickle
import queue
from collections import deque
from collections.abc import Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import ExitStack, suppress
from typing import Final

from pepperscene.dataset.check.one_frame import Examined, examine
from pepperscene.dataset.child import THREADS, Child, listening, say
from pepperscene.dataset.second import cores
from pepperscene.dataset.store import Dataset
from pepperscene.errors import InputError, WorkerError

MOST_WORKERS: Final = 256  # chosen: more would wait for the disk
_WORTH: Final = 64  # chosen: frames for which it pays to start a process, which takes half a second
_AT_A_TIME: Final = 16  # chosen: frames that a process is asked for
_AHEAD: Final = 2  # chosen: such parts for each process that may wait to be told, so that memory stays flat
_ONE_THREAD: Final = dict.fromkeys(THREADS, "1")


def examined(dataset: Dataset, indices: Sequence[int], workers: int | None) -> Iterator[Examined]:
    """Every frame examined, in the order of the indices.

    Args:
        dataset: whose frames are examined.
        indices: of the frames.
        workers: processes; None for one for each core, and none beside this one for a few frames.

    Raises:
        InputError: workers are not 1 to 256.
        WorkerError: a process was lost.
    """
    if workers is not None and not 1 <= workers <= MOST_WORKERS:
        raise InputError("--workers", "", None, f"{workers} must be 1 to {MOST_WORKERS}")
    wanted = cores() if workers is None else workers
    many = min(wanted, -(-len(indices) // _WORTH))
    if many <= 1:
        return (examine(dataset, index) for index in indices)
    return _by_many(dataset, indices, many)


def _by_many(dataset: Dataset, indices: Sequence[int], many: int) -> Iterator[Examined]:
    parts = [indices[place : place + _AT_A_TIME] for place in range(0, len(indices), _AT_A_TIME)]
    idle: queue.SimpleQueue[Child] = queue.SimpleQueue()
    with ExitStack() as stack:
        for _ in range(many):
            idle.put(_started(dataset, stack))
        # A thread for each process waits for what it says; the processes end before the threads.
        pool = stack.enter_context(ThreadPoolExecutor(many))
        waiting: deque[Future[list[Examined]]] = deque()
        for part in parts:
            waiting.append(pool.submit(_asked, idle, part))
            if len(waiting) > _AHEAD * many:
                yield from waiting.popleft().result()
        while waiting:
            yield from waiting.popleft().result()


def _started(dataset: Dataset, stack: ExitStack) -> Child:
    try:
        child = Child(__name__, _ONE_THREAD)
        stack.callback(_end, child)
        child.hear()
        child.say(dataset)
    except (OSError, EOFError) as fault:
        raise WorkerError(f"no process can be started ({fault}); try --workers 1") from None
    return child


def _asked(idle: queue.SimpleQueue[Child], part: Sequence[int]) -> list[Examined]:
    child = idle.get()
    try:
        child.say(list(part))
        found: list[Examined] = child.hear()
    except (OSError, EOFError):
        words = child.last_words().splitlines()
        raise WorkerError(
            f"a process that examined frames {part[0]} to {part[-1]} was lost"
            f"{f' ({words[-1]})' if words else ', as happens without memory'}; try fewer --workers"
        ) from None
    finally:
        # The others find out for themselves that it is lost.
        idle.put(child)
    return found


def _end(child: Child) -> None:
    child.dismiss()
    if child.ended() is None:
        child.kill()
        child.ended()
    child.close()


def serve() -> None:
    """The other side: examines what it is asked for until its input ends."""
    asked, told = listening()
    with told, suppress(EOFError, OSError):
        dataset: Dataset = pickle.load(asked)
        while True:
            say(told, [examine(dataset, index) for index in pickle.load(asked)])
