"""The side of a Dask cluster's worker: frames made in its process, one unit at a time."""

from __future__ import annotations

import os
import pickle
import platform
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from pepperscene.dataset.execution.job import BuildJob, FrameDone, FrameMaker, Tell
from pepperscene.dataset.recipe.recipe import digest
from pepperscene.dataset.scenes.plant_worker import VARIABLE as PROCESSES
from pepperscene.dataset.subprocess_rpc import THREADS
from pepperscene.errors import WorkerError
from pepperscene.version import __version__

if TYPE_CHECKING:
    from distributed import Worker


TOPIC: Final = "pepperscene"
"""Of the events through which workers tell of frames; one for all builds, as schedulers never forget one."""

_IDLE_S: Final = 60.0
"""Chosen: a worker that had no unit for so long gives back the memory of its plants and its scene."""

_LIBRARIES: Final = ("mitsuba", "drjit", "numpy", "scipy")
"""Other versions of these may make other bytes."""


class MisfitError(WorkerError):
    """This worker cannot make frames of this build; another one may."""


@dataclass(frozen=True)
class Order:
    """What a worker is told of a build.

    Attributes:
        build: its name, like no other's.
        versions: of whoever asks, as by `versions`.
        marker: a file that the worker has to see if the file system is a shared one.
        job: pickled, so that it is read only where the versions are right.
        about: digest of the job's `about`, which changes with every file that the recipe names.
    """

    build: str
    versions: dict[str, str]
    marker: Path
    job: bytes
    about: str

    @classmethod
    def of(cls, build: str, marker: Path, job: BuildJob) -> Order:
        """The order for a job, by this process."""
        return cls(build, versions(), marker, pickle.dumps(job, protocol=5), digest(job.about()))


@dataclass(frozen=True)
class Call:
    """What a worker is to do, as bytes that do it where they are read.

    A worker that cannot read a message ends, and a scheduler that cannot read a task refuses it. So the task
    is none of this package's: it is `pickle.loads`, which everybody knows, and it reads the rest. Where this
    package is missing or an older one the task fails, and the worker goes on with what others want of it.

    Attributes:
        order, number, indices: as for `make_unit`.
    """

    order: Order
    number: int
    indices: tuple[int, ...]

    def __reduce__(self) -> tuple[Callable[..., None], tuple[Any, ...]]:
        return make_unit, (self.order, self.number, self.indices)


def versions() -> dict[str, str]:
    """What decides a frame's bytes besides the recipe, by name."""
    python = ".".join(platform.python_version_tuple()[:2])
    return {"pepperscene": __version__, "Python": python, **{one: _version(one) for one in _LIBRARIES}}


def _version(library: str) -> str:
    try:
        return metadata.version(library)
    except metadata.PackageNotFoundError:
        return "none"


def make_unit(order: Order, number: int, indices: tuple[int, ...]) -> None:
    """Make frames; what a worker does when it reads a `Call`.

    Each frame is told through an event, and so is the end, as nobody hears a task that was cancelled.

    Args:
        order: of the build.
        number: of the task in the build.
        indices: of the frames.

    Raises:
        MisfitError: this worker would make other frames, or would write them elsewhere.
        PepperError: a frame cannot be made.
    """
    from distributed import get_worker

    worker = get_worker()
    key = worker.get_current_task()

    def say(done: FrameDone | None) -> None:
        told = None if done is None else pickle.dumps(done, protocol=5)
        worker.log_event(TOPIC, {"build": order.build, "number": number, "done": told})

    try:
        _examine(order)
        _keep_to(worker.state.nthreads)
        _bench.make(order, indices, say, lambda: _unwanted(worker, key))
    except MemoryError:
        raise WorkerError(
            "a worker ran out of memory; try fewer workers on a machine, the frames so far are kept"
        ) from None
    finally:
        say(None)


def _examine(order: Order) -> None:
    """Raise the `MisfitError` that tells why this worker cannot make frames, if there is a reason."""
    here = versions()
    for name, wanted in order.versions.items():
        if here.get(name) != wanted:
            raise MisfitError(f"has {name} {here.get(name)}, not {wanted}, and would make other frames")
    if not order.marker.is_file():
        raise MisfitError(f"does not see {order.marker.parent}; the folder has to be on a shared file system")
    if not os.access(order.marker.parent, os.W_OK | os.X_OK):
        raise MisfitError(f"must not write into {order.marker.parent}")


def _keep_to(threads: int) -> None:
    """Let this process take no more cores than its worker's; what its environment says already stands."""
    for name in THREADS:
        os.environ.setdefault(name, str(threads))
    os.environ.setdefault(PROCESSES, "1")


def _unwanted(worker: Worker, key: Any) -> bool:
    """Whether nobody waits for a task any more: it is cancelled, who asked is gone, or the worker closes."""
    task = worker.state.tasks.get(key)
    return task is None or task.state == "cancelled" or worker.status.name not in ("running", "paused")


class _Bench:
    """The one thread of this process that makes frames, and what it keeps between units of a build.

    One thread, because a kernel's arrays belong to the thread that made them, and because two scenes at a
    time would take the memory of two.
    """

    def __init__(self) -> None:
        self._thread = ThreadPoolExecutor(1, "frames")
        self._held: tuple[str, FrameMaker] | None = None
        self._turns = 0

    def make(self, order: Order, indices: tuple[int, ...], tell: Tell, stop: Callable[[], bool]) -> None:
        """Make frames, after those that somebody asked for before."""
        self._thread.submit(self._make, order, indices, tell, stop).result()

    def _make(self, order: Order, indices: tuple[int, ...], tell: Tell, stop: Callable[[], bool]) -> None:
        if stop():
            return
        self._turns += 1
        try:
            self._maker(order).make(indices, tell, stop)
        except BaseException:
            self._drop()
            raise
        idle = threading.Timer(_IDLE_S, self._tidy, (self._turns,))
        idle.daemon = True
        idle.start()

    def _maker(self, order: Order) -> FrameMaker:
        if self._held is None or self._held[0] != order.build:
            # The old plants go before new ones come.
            self._drop()
            job: BuildJob = pickle.loads(order.job)
            if digest(job.about()) != order.about:
                raise MisfitError("reads other files by the names in the recipe, and would make other frames")
            self._held = order.build, FrameMaker(job, f"{platform.node()}-{os.getpid()}", eager=True)
        return self._held[1]

    def _drop(self) -> None:
        held, self._held = self._held, None
        if held is not None:
            held[1].__exit__(None, None, None)

    def _tidy(self, turns: int) -> None:
        # A process that ends takes no further work.
        with suppress(RuntimeError):
            self._thread.submit(lambda: self._drop() if turns == self._turns else None)


_bench: Final = _Bench()
