"""Frames made in this very process, with all of its cores."""

from __future__ import annotations

import os
import pickle
import platform
import queue
import signal
import sys
import threading
import traceback
from collections.abc import Sequence
from contextlib import suppress
from itertools import chain
from typing import IO, Any, Final, final

from pepperscene.dataset.execution.executor import Executor, LostWorkers, Notice, UnitQueue, WorkUnit
from pepperscene.dataset.execution.job import BuildJob, FrameDone, FrameMaker, Tell
from pepperscene.dataset.scenes.plant_worker import VARIABLE as PROCESSES
from pepperscene.dataset.scenes.plant_worker import available_cores
from pepperscene.dataset.subprocess_rpc import THREADS, WorkerProcess, listening, say
from pepperscene.errors import PepperError, WorkerError


@final
class SerialExecutor(Executor):
    """This process. It shares frames' work out to all cores, and needs the memory of one."""

    size = 1

    def make(self, job: BuildJob, units: Sequence[WorkUnit], tell: Tell, notice: Notice) -> None:
        """See `Executor.make`; frames are told in ascending order."""
        with FrameMaker(job, platform.node()) as maker:
            maker.make(chain.from_iterable(unit.indices for unit in units), tell)


MOST_WORKERS: Final = 1024  # chosen: more than one machine has cores

_PATIENCE_S: Final = 60.0
"""Chosen: how long the others may take to finish the frames that they are at when one has failed."""


@final
class ProcessExecutor(Executor):
    """A number of workers, each a process with its share of the machine's cores, at least one.

    A worker that is lost (killed, out of memory) is replaced, and what it had not finished goes on. Workers
    end with this process, after the frame that they are at.

    Args:
        workers: how many.
    """

    def __init__(self, workers: int) -> None:
        self._workers = workers

    @property
    def size(self) -> int:
        """Number of workers."""
        return self._workers

    def make(self, job: BuildJob, units: Sequence[WorkUnit], tell: Tell, notice: Notice) -> None:
        """See `Executor.make`; the frames of different workers are told as they come."""
        from pepperscene.render import wanted_threads

        pickle.dumps(job)  # what cannot be sent is told here
        threads = wanted_threads() or max(1, available_cores() // self._workers)
        with _Shift(job, units, min(self._workers, len(units)), threads) as shift:
            shift.run(tell, notice)


class _Worker:
    """A worker as the pool sees it: its process, the thread that listens to it, and what it is at."""

    def __init__(self, job: BuildJob, threads: int, events: queue.SimpleQueue[tuple[_Worker, Any]]) -> None:
        environment = {**dict.fromkeys(THREADS, str(threads)), PROCESSES: "2" if threads > 1 else "1"}
        self.unit: WorkUnit | None = None
        self.told: set[int] = set()
        self._events = events
        self.child = WorkerProcess(__name__, environment)
        with suppress(OSError):
            self.child.say(job)
        self._thread = threading.Thread(target=self._listen, name="worker", daemon=True)
        self._thread.start()

    def give(self, unit: WorkUnit) -> None:
        """The next unit; whether the worker still lives shows in its events."""
        self.unit, self.told = unit, set()
        with suppress(OSError):
            self.child.say(unit.indices)

    def _listen(self) -> None:
        try:
            if not self.child.same():
                raise EOFError
            while True:
                self._events.put((self, self.child.hear()))
        except EOFError:
            self._events.put((self, EOFError))

    def end(self, patience_s: float) -> None:
        """Let it finish its frame, for as long as there is patience."""
        if self.child.ended(patience_s) is None:
            self.child.kill()
        self.child.ended()
        self._thread.join()
        self.child.close()


class _Shift:
    """The workers of one build, and the units that are left."""

    def __init__(self, job: BuildJob, units: Sequence[WorkUnit], size: int, threads: int) -> None:
        self._job, self._threads = job, threads
        self._queue, self._losses = UnitQueue(units), LostWorkers()
        self._events: queue.SimpleQueue[tuple[_Worker, Any]] = queue.SimpleQueue()
        self._workers: list[_Worker] = []
        self._patience = 0.0
        self._size = size

    def __enter__(self) -> _Shift:
        return self

    def __exit__(self, *_: object) -> None:
        for worker in self._workers:
            worker.child.dismiss()
        for worker in self._workers:
            worker.end(self._patience)

    def run(self, tell: Tell, notice: Notice) -> None:
        """Hand out units until all are done."""
        try:
            for _ in range(self._size):
                self._hire(None)
            while any(worker.unit is not None for worker in self._workers):
                worker, event = self._events.get()
                if isinstance(event, FrameDone):
                    worker.told.add(event.index)
                    tell(event)
                elif event is None:
                    self._next(worker)
                elif isinstance(event, PepperError):
                    raise event
                elif worker in self._workers:
                    self._replace(worker, notice)
        except PepperError:
            # The others finish the frames that they are at.
            self._patience = _PATIENCE_S
            raise
        self._patience = _PATIENCE_S

    def _hire(self, last: WorkUnit | None) -> None:
        unit = self._queue.next(last)
        if unit is None:
            return
        try:
            worker = _Worker(self._job, self._threads, self._events)
        except OSError as fault:
            self._queue.put_back(unit)
            raise WorkerError(f"no worker can be started ({fault.strerror or fault})") from None
        self._workers.append(worker)
        worker.give(unit)

    def _next(self, worker: _Worker) -> None:
        last, worker.unit = worker.unit, None
        unit = self._queue.next(last)
        if unit is not None:
            worker.give(unit)

    def _replace(self, worker: _Worker, notice: Notice) -> None:
        """Another worker for one that has ended before its time."""
        self._workers.remove(worker)
        lost, worker.unit = worker.unit, None
        how = _how(worker.child)
        worker.end(0.0)
        if lost is None:
            return
        left = lost.after(worker.told)
        if left.indices:
            notice(self._losses.note(left.indices[0], how))
            self._queue.put_back(left)
        self._hire(lost)


def _how(child: WorkerProcess) -> str:
    """How a child ended, in words."""
    status = child.ended()
    words = child.last_words().splitlines()
    if status is not None and status < 0:
        name = signal.Signals(-status).name if -status in set(signal.Signals) else f"signal {-status}"
        return f"killed by {name}" + (", as a machine does that runs out of memory" if status == -9 else "")
    return f"exit code {status}" + (f": {words[-1]}" if words else "")


def serve() -> None:
    """A worker: makes the units that it is asked for until its input ends."""
    status = 1
    try:
        _serve()
        status = 0
    except Exception:
        traceback.print_exc()
    finally:
        # The thread that waits for input holds it, and Python would wait for that thread.
        sys.stderr.flush()
        os._exit(status)


def _serve() -> None:
    asked, told = listening()
    with told, suppress(EOFError, BrokenPipeError):
        job: BuildJob = pickle.load(asked)
        wanted: queue.SimpleQueue[tuple[int, ...] | None] = queue.SimpleQueue()
        ended = threading.Event()
        threading.Thread(target=_asked, args=(asked, wanted, ended), daemon=True).start()
        try:
            with FrameMaker(job, f"{platform.node()}-{os.getpid()}", eager=True) as maker:
                while (indices := wanted.get()) is not None:
                    maker.make(indices, lambda done: say(told, done), ended.is_set)
                    say(told, None)
        except PepperError as fault:
            say(told, fault)
        except MemoryError:
            say(told, WorkerError("a worker ran out of memory; take fewer, the frames so far are kept"))


def _asked(
    asked: IO[bytes], wanted: queue.SimpleQueue[tuple[int, ...] | None], ended: threading.Event
) -> None:
    """Take what is asked for, also while frames are made, so that the end of the input is seen at once."""
    with suppress(EOFError, OSError, pickle.UnpicklingError):
        while True:
            wanted.put(pickle.load(asked))
    ended.set()
    wanted.put(None)
