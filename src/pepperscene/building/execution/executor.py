"""Executors on this machine, the units of work of all executors, and the dispatch of units to workers.

The pool of processes is not Dask's `LocalCluster`; `docs/explanation/architecture.md` has the measurements.
"""

from __future__ import annotations

import os
import platform
import queue
import threading
from abc import ABC, abstractmethod
from collections import Counter, deque
from collections.abc import Callable, Hashable, Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import chain, groupby
from typing import Any, Final, Self, final

from pepperscene.building.execution.job import BuildJob, FrameDone, FrameMaker, OnFrame
from pepperscene.building.memory import report_memory_errors
from pepperscene.building.scenes.plants import PROCESSES
from pepperscene.building.subprocess_rpc import Connection, WorkerProcess, available_cores
from pepperscene.errors import PepperError, WorkerError
from pepperscene.interrupts import raise_if_interrupted
from pepperscene.recipe.plan import Plan

MAX_LOSSES: Final = 3
"""Chosen: a frame that ends a third worker would end the next one, too."""

MAX_LOSSES_ALONE: Final = 2
"""Chosen: the same for a worker that is the only one, as no other one leaves it more memory the next time."""


@dataclass(frozen=True)
class WorkUnit:
    """Frames of one scene, ascending, and the number of its set of plants."""

    set: int
    indices: tuple[int, ...]


def work_units(plan: Plan, indices: Sequence[int], workers: int) -> list[WorkUnit]:
    """Group ascending indices by scene; with fewer scenes than workers, scenes are divided.

    Every worker that makes a part of a scene has to set it up, which takes as long as the labels of tens of
    frames. So scenes are divided only where workers would be idle.
    """
    specs = [plan.frame(index) for index in indices]
    units = [
        WorkUnit(set_index, tuple(spec.index for spec in group))
        for (set_index, _), group in groupby(specs, lambda spec: (spec.set, spec.rotation))
    ]
    while 0 < len(units) < workers:
        longest = max(range(len(units)), key=lambda position: len(units[position].indices))
        unit = units[longest]
        half = -(-len(unit.indices) // 2)
        if half == len(unit.indices):
            break
        parts = (unit.indices[:half], unit.indices[half:])
        units[longest : longest + 1] = [WorkUnit(unit.set, part) for part in parts]
    return units


class Dispatcher:
    """Assigns units to workers, requeues those of lost workers, and reports every frame once.

    Plants of a set are grown as few times as possible: a worker stays with its set, then takes one that
    no worker has started, then helps with the set that has most units left.

    Attributes:
        running: the unit of each worker that has one.
        on_notice: called with a sentence for the user, such as that a worker was lost.
    """

    def __init__(
        self, units: Iterable[WorkUnit], on_frame: OnFrame, on_notice: Callable[[str], None]
    ) -> None:
        self._on_frame, self.on_notice = on_frame, on_notice
        self._pending: dict[int, deque[WorkUnit]] = {}
        for unit in units:
            self._pending.setdefault(unit.set, deque()).append(unit)
        self.running: dict[Hashable, WorkUnit] = {}
        self._last_set: dict[Hashable, int] = {}
        self._reported: set[int] = set()
        self._losses: Counter[int] = Counter()

    def __bool__(self) -> bool:
        """Whether a unit is pending or running."""
        return bool(self._pending or self.running)

    @property
    def pending(self) -> int:
        """Number of pending units."""
        return sum(map(len, self._pending.values()))

    def assign(self, worker: Hashable) -> tuple[int, ...]:
        """Assign the next unit to a worker that has none; returns its frames, none if no unit is pending."""
        while self._pending:
            unit = self._remaining(self._take(worker))
            if unit.indices:
                self.running[worker] = unit
                self._last_set[worker] = unit.set
                return unit.indices
        return ()

    def report(self, done: FrameDone) -> None:
        """Report a complete frame, unless it was: a worker that was taken for lost may go on."""
        if done.index not in self._reported:
            self._reported.add(done.index)
            self._on_frame(done)

    def is_complete(self, worker: Hashable) -> bool:
        """Whether all frames of a worker's unit were reported."""
        return not self._remaining(self.running[worker]).indices

    def release(self, worker: Hashable) -> tuple[int, ...]:
        """End a worker's unit; returns the frames that were not reported, which are pending again."""
        unit = self._remaining(self.running.pop(worker))
        if unit.indices:
            self._pending.setdefault(unit.set, deque()).appendleft(unit)
        return unit.indices

    def lose(self, worker: Hashable, reason: str, *, is_only: bool = False) -> None:
        """Requeue the unfinished frames of a lost worker.

        `is_only`: whether the build has no other worker, which could have taken the memory.

        Raises:
            WorkerError: its first unfinished frame has ended as many workers as are allowed.
        """
        frames = self.release(worker)
        if not frames:
            return
        self._losses[frames[0]] += 1
        most = MAX_LOSSES_ALONE if is_only else MAX_LOSSES
        if self._losses[frames[0]] >= most:
            advice = "a smaller sensor or fewer outputs" if is_only else "fewer workers"
            raise WorkerError(
                f"frame {frames[0]:06d} ended {most} workers, the last one {reason}; complete frames "
                f"are kept, and the same command resumes the build: use {advice} if memory ran out"
            )
        self.on_notice(
            f"a worker was lost over frame {frames[0]:06d} ({reason}); another one makes its frames"
        )

    def _take(self, worker: Hashable) -> WorkUnit:
        last, started = self._last_set.get(worker), {*self._last_set.values()}
        untouched = [set_index for set_index in self._pending if set_index not in started]
        if last is not None and last in self._pending:
            set_index, unit = last, self._pending[last].popleft()
        elif untouched:
            set_index, unit = untouched[0], self._pending[untouched[0]].popleft()
        else:
            # From the end: the workers of this set reach it last.
            set_index = max(self._pending, key=lambda set_index: len(self._pending[set_index]))
            unit = self._pending[set_index].pop()
        if not self._pending[set_index]:
            del self._pending[set_index]
        return unit

    def _remaining(self, unit: WorkUnit) -> WorkUnit:
        return replace(unit, indices=tuple(index for index in unit.indices if index not in self._reported))


class Executor(ABC):
    """Makes the frames of a job.

    Attributes:
        local_processes: number of processes that make frames on this machine; 0 for clusters.
    """

    local_processes: int = 0

    @property
    @abstractmethod
    def size(self) -> int:
        """Number of frames that are made at a time."""

    @abstractmethod
    def make(self, job: BuildJob, dispatcher: Dispatcher) -> None:
        """Make what is missing of all frames of a dispatcher, and report them to it, in this thread.

        Raises:
            PepperError: frames cannot be made; those that were reported are complete.
        """


MAX_WORKERS: Final = 1024  # chosen: more than a machine has cores

_CHECK_S: Final = 0.2  # chosen: interval of the checks for signals while workers render

_PATIENCE_S: Final = 60.0
"""Chosen: how long the other workers may take to finish their frames when one has failed."""


@final
class SerialExecutor(Executor):
    """This process, with all cores and the memory of one scene."""

    size = local_processes = 1

    def make(self, job: BuildJob, dispatcher: Dispatcher) -> None:
        """See `Executor.make`; frames are reported in ascending order."""
        units = iter(lambda: dispatcher.assign(0), ())
        with report_memory_errors(), FrameMaker(job, platform.node()) as maker:
            maker.make(chain.from_iterable(units), dispatcher.report)


@final
class ProcessExecutor(Executor):
    """Worker processes, each with an equal part of the machine's cores, at least one.

    A worker that is lost (killed, out of memory) is replaced, and its frames are made by another one. Workers
    end with this process, after their current frame.

    Args:
        workers: number of them.
    """

    def __init__(self, workers: int) -> None:
        self._workers = self.local_processes = workers

    @property
    def size(self) -> int:
        """Number of workers."""
        return self._workers

    def make(self, job: BuildJob, dispatcher: Dispatcher) -> None:
        """See `Executor.make`; frames are reported as they become complete."""
        from pepperscene.render import wanted_threads

        threads = wanted_threads() or max(1, available_cores() // self._workers)
        with _Pool(job, threads, dispatcher) as pool:
            pool.run(min(self._workers, dispatcher.pending))


class _Pool:
    """The workers of one build, by slot: a replacement takes the slot of the worker that was lost.

    Each worker has a thread that receives its messages: frames, None after each unit, an error, and
    `EOFError` at its end.
    """

    def __init__(self, job: BuildJob, threads: int, dispatcher: Dispatcher) -> None:
        self._job, self._threads, self._dispatcher = job, threads, dispatcher
        self._workers: dict[int, WorkerProcess] = {}
        self._messages: queue.SimpleQueue[tuple[int, Any]] = queue.SimpleQueue()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        for worker in self._workers.values():
            worker.finish()
        for worker in self._workers.values():
            worker.close(_PATIENCE_S if error is None or isinstance(error, PepperError) else 0.0)

    def run(self, size: int) -> None:
        """Make all frames with this number of workers."""
        # All start before the first receives the job.
        for slot in range(size):
            self._start(slot)
        for slot in range(size):
            self._send(slot, self._job)
            self._assign(slot)
        while self._dispatcher:
            raise_if_interrupted()
            try:
                slot, message = self._messages.get(timeout=_CHECK_S)
            except queue.Empty:
                continue
            if isinstance(message, FrameDone):
                self._dispatcher.report(message)
            elif isinstance(message, PepperError):
                raise message
            elif slot in self._dispatcher.running:
                if message is None:
                    self._dispatcher.release(slot)
                else:
                    reason = self._workers.pop(slot).close()
                    self._dispatcher.lose(slot, reason, is_only=size == 1)
                    self._start(slot)
                    self._send(slot, self._job)
                self._assign(slot)

    def _start(self, slot: int) -> None:
        processes = {PROCESSES: "2" if self._threads > 1 else "1"}
        try:
            worker = self._workers[slot] = WorkerProcess(__name__, self._threads, processes)
        except OSError as error:
            raise WorkerError(f"no worker can be started ({error.strerror or error})") from None

        def receive() -> None:
            for message in worker:
                self._messages.put((slot, message))
            self._messages.put((slot, EOFError))

        threading.Thread(target=receive, name="worker", daemon=True).start()

    def _assign(self, slot: int) -> None:
        indices = self._dispatcher.assign(slot)
        if indices:
            self._send(slot, indices)

    def _send(self, slot: int, message: Any) -> None:
        # The thread that receives messages notices that a worker has ended.
        with suppress(OSError):
            self._workers[slot].send(message)


def serve(connection: Connection) -> None:
    """Make the requested units, in a worker process."""
    name = f"{platform.node()}-{os.getpid()}"
    lost = WorkerError("a worker ran out of memory; use fewer workers, complete frames are kept")
    try:
        with report_memory_errors(lost), FrameMaker(connection.state, name, eager=True) as maker:
            for indices in connection:
                maker.make(indices, connection.send, connection.closed.is_set)
                connection.send(None)
    except PepperError as error:
        connection.send(error)
