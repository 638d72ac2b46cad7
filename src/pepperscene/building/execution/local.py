"""Executors on this machine: this process, or a pool of worker processes.

The pool is not Dask's `LocalCluster`, which was measured (two workers of one core, 40 label frames of
`barth2018`): it takes 2.6 s to start instead of 0.8 and makes 3.2 frames/s instead of 5.4, needs 80 MiB more
memory before the first frame and 20 further packages (38 MiB), and fails in scripts without a `__main__`
guard. Both replace a worker that is killed, and make the same files. In loky's pool, a worker that is killed
ends the tasks of all others.
"""

from __future__ import annotations

import os
import platform
import queue
import threading
from contextlib import suppress
from itertools import chain
from typing import Any, Final, Self, final

from pepperscene.building.execution.executor import Dispatcher, Executor
from pepperscene.building.execution.job import BuildJob, FrameDone, FrameMaker
from pepperscene.building.memory import report_memory_errors
from pepperscene.building.scenes.plants import PROCESSES
from pepperscene.building.subprocess_rpc import Connection, WorkerProcess, available_cores
from pepperscene.errors import PepperError, WorkerError, is_out_of_memory
from pepperscene.interrupts import raise_if_interrupted

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
    try:
        with FrameMaker(connection.state, f"{platform.node()}-{os.getpid()}", eager=True) as maker:
            for indices in connection:
                maker.make(indices, connection.send, connection.closed.is_set)
                connection.send(None)
    except PepperError as error:
        connection.send(error)
    except (MemoryError, RuntimeError) as error:
        if not is_out_of_memory(error):
            raise
        connection.send(
            WorkerError("a worker ran out of memory; use fewer workers, complete frames are kept")
        )
