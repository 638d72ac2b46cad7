"""Frames made by the workers of a running Dask cluster."""

from __future__ import annotations

import logging
import time
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Final, final

from pepperscene.dataset.execution.executor import Executor, Notice, WorkUnit
from pepperscene.dataset.execution.job import BuildJob, Tell
from pepperscene.errors import ArgumentError, SetupError, WorkerError

if TYPE_CHECKING:
    from distributed import Client


_ANSWER_S: Final = 10.0
"""Chosen: how long a scheduler may take to answer."""

_ALONE_S: Final = 60.0
"""Chosen: how long there may be no worker; one that was lost is replaced within some seconds."""

_CHATTY: Final = frozenset({"distributed", "tornado", "asyncio", "dask_jobqueue"})


@final
class DaskExecutor(Executor):
    """A Dask cluster that somebody else has started, and that goes on when the build has ended.

    Its workers see the data set's folder under the same path and have the same version of this package.
    Each makes one unit at a time, with as many cores as it has threads.

    Args:
        address: of the scheduler ("tcp://10.0.0.5:8786").

    Raises:
        InputError: this is no address.
        SetupError: the extra `cluster` is not installed.
    """

    def __init__(self, address: str) -> None:
        try:
            from distributed.comm import parse_address, parse_host_port
        except ImportError:
            raise missing() from None
        try:
            scheme, place = parse_address(address)
            if scheme in ("tcp", "tls", "ws", "wss"):
                parse_host_port(place)
        except (ValueError, TypeError):
            raise ArgumentError(
                "scheduler", f"must be an address such as tcp://10.0.0.5:8786, not {address!r}"
            ) from None
        self._address = address

    @property
    def size(self) -> int:
        """Number of workers at present, at least one.

        Raises:
            WorkerError: nobody answers.
        """
        with connected(self._address) as client:
            return max(1, len(client.nthreads()))

    def make(self, job: BuildJob, units: Sequence[WorkUnit], tell: Tell, notice: Notice) -> None:
        """See `Executor.make`; the frames of different workers are told as they come."""
        from pepperscene.dataset.execution.dask_dispatch import DaskDispatcher, marker_beside

        alone = _Alone(self._address)
        with (
            connected(self._address) as client,
            marker_beside(job.folder) as marker,
            DaskDispatcher(client, self._address, job, marker, units, alone.look) as shift,
        ):
            shift.run(tell, notice)


class _Alone:
    """Notes for how long a cluster has had no worker."""

    def __init__(self, where: str) -> None:
        self._where, self._since = where, time.monotonic()

    def look(self, present: bool) -> None:
        """Raise the `WorkerError` that tells that nobody will come, when it is time."""
        if present:
            self._since = time.monotonic()
        elif time.monotonic() - self._since > _ALONE_S:
            raise WorkerError(f"{self._where}: has had no worker for {_ALONE_S:.0f} s")


@contextmanager
def connected(address: str) -> Iterator[Client]:
    """A client of a scheduler, which keeps the user's terminal clean.

    Raises:
        WorkerError: nobody answers, or somebody else.
    """
    from distributed import Client
    from distributed.versions import VersionMismatchWarning

    with quiet():
        try:
            with warnings.catch_warnings():
                # What decides a frame's bytes is compared by the workers themselves.
                warnings.simplefilter("ignore", VersionMismatchWarning)
                client = Client(address, timeout=_ANSWER_S, set_as_default=False)
        except (OSError, TimeoutError, ImportError, ValueError, RuntimeError) as fault:
            raise WorkerError(f"{address}: no Dask scheduler answers there ({_first_line(fault)})") from None
        try:
            yield client
        finally:
            client.close(timeout=_ANSWER_S)


@contextmanager
def quiet() -> Iterator[None]:
    """Keep the words of libraries off the terminal; what matters of them is told in sentences."""
    names = {*_CHATTY, *(name for name in logging.root.manager.loggerDict if name.split(".")[0] in _CHATTY)}
    loggers = [logging.getLogger(name) for name in names]
    before = [logger.level for logger in loggers]
    for logger in loggers:
        logger.setLevel(logging.CRITICAL + 1)
    try:
        yield
    finally:
        for logger, level in zip(loggers, before, strict=True):
            logger.setLevel(level)


def missing() -> SetupError:
    """What to say where the extra is not installed."""
    return SetupError("clusters need Dask: pip install 'pepperscene[cluster]'")


def _first_line(fault: BaseException) -> str:
    return next(iter(str(fault).splitlines()), type(fault).__name__)
