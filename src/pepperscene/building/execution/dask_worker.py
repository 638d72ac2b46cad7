"""Code that runs in Dask workers: it renders frames, one unit at a time."""

from __future__ import annotations

import os
import pickle
import platform
import threading
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from pepperscene.building.execution.job import BuildJob, FrameDone, FrameMaker, OnFrame
from pepperscene.building.memory import report_memory_errors
from pepperscene.building.scenes.plants import PROCESSES
from pepperscene.building.subprocess_rpc import THREADS
from pepperscene.errors import SetupError, WorkerError
from pepperscene.version import __version__

if TYPE_CHECKING:
    from distributed import Worker


TOPIC: Final = "pepperscene"
"""Of the events that report frames; the same for all builds, as schedulers never forget a topic."""

_IDLE_S: Final = 60.0
"""Chosen: a worker without units for so long frees the memory of its plants and its scene."""

_LIBRARIES: Final = ("mitsuba", "drjit", "numpy", "scipy")
"""Packages whose version can change the bytes of frames."""


class UnfitWorkerError(WorkerError):
    """This worker cannot make frames of this build; another one may."""


@dataclass(frozen=True)
class BuildRequest:
    """Data that a worker receives of a build with this unique name.

    Workers compare versions and identity with their own, and see the marker file if the file system is
    shared. The job is pickled, so that it is read only where the versions are right.
    """

    build: str
    versions: dict[str, str]
    identity: Mapping[str, Any]
    marker: Path
    job: bytes

    @classmethod
    def create(cls, build: str, marker: Path, job: BuildJob) -> BuildRequest:
        """The request for a job of this process."""
        return cls(build, versions(), job.recipe.identity, marker, pickle.dumps(job, protocol=5))


@dataclass(frozen=True)
class UnitTask:
    """A task, as bytes that run it when they are read.

    A worker that cannot read a message ends, and a scheduler that cannot read a task refuses it. So the task
    is `pickle.loads`, which is known everywhere, and it reads these bytes: where this package is missing or
    has another version, the task fails, and the worker continues with other tasks.
    """

    request: BuildRequest
    number: int
    indices: tuple[int, ...]

    def __reduce__(self) -> tuple[Callable[..., None], tuple[Any, ...]]:
        return make_unit, (self.request, self.number, self.indices)


def versions() -> dict[str, str]:
    """Versions of everything besides the recipe that determines a frame's bytes."""
    result = {"pepperscene": __version__, "Python": ".".join(platform.python_version_tuple()[:2])}
    for library in _LIBRARIES:
        try:
            result[library] = metadata.version(library)
        except metadata.PackageNotFoundError:
            result[library] = "none"
    return result


def make_unit(request: BuildRequest, number: int, indices: tuple[int, ...]) -> None:
    """Make the frames of a task, in a Dask worker.

    Each frame is reported by an event, and so is the end, as there is no other message of a cancelled task.
    Raises `UnfitWorkerError` if this worker would make other frames, or would write them elsewhere.
    """
    from distributed import get_worker

    worker = get_worker()
    key = worker.get_current_task()

    def send(done: FrameDone | None) -> None:
        content = None if done is None else pickle.dumps(done, protocol=5)
        worker.log_event(TOPIC, {"build": request.build, "number": number, "done": content})

    advice = "use fewer workers on a machine, complete frames are kept"
    try:
        with report_memory_errors(WorkerError(f"a worker ran out of memory; {advice}")):
            _check_fit(request)
            # Use as many cores as the worker has threads, unless its environment says otherwise.
            for name in THREADS:
                os.environ.setdefault(name, str(worker.state.nthreads))
            os.environ.setdefault(PROCESSES, "1")
            _frame_thread.make(request, indices, send, lambda: _is_cancelled(worker, key))
    finally:
        send(None)


def _check_fit(request: BuildRequest) -> None:
    """Raise `UnfitWorkerError` if this worker cannot make frames."""
    installed = versions()
    for name, version in request.versions.items():
        if installed.get(name) != version:
            raise UnfitWorkerError(
                f"has {name} {installed.get(name)}, not {version}, and would make other frames"
            )
    folder = request.marker.parent
    if not request.marker.is_file():
        raise UnfitWorkerError(f"does not see {folder}; the folder must be on a shared file system")
    if not os.access(folder, os.W_OK | os.X_OK):
        raise UnfitWorkerError(f"may not write into {folder}")


def _read_job(request: BuildRequest) -> BuildJob:
    """The job of a request; raises `UnfitWorkerError` if its frames would differ or not fit into memory."""
    job: BuildJob = pickle.loads(request.job)
    # Some files, such as scans of fruit, are only read when they are used.
    if job.recipe.recipe.identity() != request.identity:
        raise UnfitWorkerError("reads other files by the names in the recipe, and would make other frames")
    try:
        job.check_memory()
    except SetupError as error:
        raise UnfitWorkerError(str(error)) from None
    return job


def _is_cancelled(worker: Worker, key: Any) -> bool:
    """Whether a task is cancelled, its build has ended, or the worker closes."""
    task = worker.state.tasks.get(key)
    return task is None or task.state == "cancelled" or worker.status.name not in ("running", "paused")


class _FrameThread:
    """The one thread of this process that makes frames, and what it keeps between the units of a build.

    One thread, because a kernel's arrays belong to the thread that made them, and because two scenes at a
    time would need twice the memory.
    """

    def __init__(self) -> None:
        self._thread = ThreadPoolExecutor(1, "frames")
        self._held: tuple[str, FrameMaker] | None = None
        self._units = 0

    def make(
        self, request: BuildRequest, indices: tuple[int, ...], on_frame: OnFrame, stop: Callable[[], bool]
    ) -> None:
        """Make frames, after those of earlier calls."""
        self._thread.submit(self._make, request, indices, on_frame, stop).result()

    def _make(
        self, request: BuildRequest, indices: tuple[int, ...], on_frame: OnFrame, stop: Callable[[], bool]
    ) -> None:
        if stop():
            return
        self._units += 1
        try:
            if self._held is None or self._held[0] != request.build:
                # Release the old plants before making new ones.
                self._release()
                maker = FrameMaker(_read_job(request), f"{platform.node()}-{os.getpid()}", eager=True)
                self._held = request.build, maker
            self._held[1].make(indices, on_frame, stop)
        except BaseException:
            self._release()
            raise
        timer = threading.Timer(_IDLE_S, self._release_if_idle, (self._units,))
        timer.daemon = True
        timer.start()

    def _release(self) -> None:
        maker, self._held = self._held, None
        if maker is not None:
            maker[1].__exit__(None, None, None)

    def _release_if_idle(self, units: int) -> None:
        # A process that ends accepts no further work.
        with suppress(RuntimeError):
            self._thread.submit(lambda: self._release() if units == self._units else None)


_frame_thread: Final = _FrameThread()
