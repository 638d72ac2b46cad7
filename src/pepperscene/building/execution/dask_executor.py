"""The executor that uses the workers of a running Dask cluster."""

from __future__ import annotations

import logging
import pickle
import queue
import tempfile
import time
import uuid
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from ipaddress import ip_address
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Self, final

from pepperscene.atomic import write_errors
from pepperscene.building.execution.dask_worker import TOPIC, BuildRequest, UnfitWorkerError, UnitTask
from pepperscene.building.execution.executor import Dispatcher, Executor
from pepperscene.building.execution.job import BuildJob, FrameDone
from pepperscene.errors import ArgumentError, PepperError, SetupError, WorkerError
from pepperscene.interrupts import raise_if_interrupted

if TYPE_CHECKING:
    from distributed import Client, Future
    from distributed.security import Security


_ANSWER_S: Final = 10.0  # chosen: how long a scheduler may take to answer
_NO_WORKER_S: Final = 60.0  # chosen: how long there may be no worker; lost ones are replaced within seconds
_CHECK_S: Final = 1.0  # chosen: interval between queries of the scheduler's workers
_PATIENCE_S: Final = 60.0  # chosen: how long workers may take to finish their frames when one has failed
_INTERRUPT_PATIENCE_S: Final = 5.0  # chosen: the same after Ctrl-C

_LIBRARIES: Final = frozenset({"distributed", "tornado", "asyncio", "dask_jobqueue"})


@final
class DaskExecutor(Executor):
    """A running Dask cluster, which keeps running after the build.

    Its workers have this version of the package and see the output folder under the same path. Each makes one
    unit at a time, with as many cores as it has threads. Raises `ArgumentError` if this is not an address,
    and `SetupError` if the extra `cluster` is not installed.
    """

    def __init__(self, address: str) -> None:
        try:
            from distributed.comm import parse_address, parse_host_port
        except ImportError:
            raise missing_extra() from None
        try:
            scheme, host = parse_address(address)
            if scheme in ("tcp", "tls", "ws", "wss"):
                parse_host_port(host)
        except (ValueError, TypeError):
            problem = f"must be an address such as tcp://10.0.0.5:8786, not {address!r}"
            raise ArgumentError("scheduler", problem) from None
        _check_credentials(address)
        self._address = address

    @property
    def size(self) -> int:
        """Present number of workers, at least one; raises `WorkerError` if no scheduler answers."""
        with connect(self._address) as client:
            return max(1, len(client.nthreads()))

    def make(self, job: BuildJob, dispatcher: Dispatcher) -> None:
        """See `Executor.make`; frames are reported as they become complete."""
        if trusts_network(self._address):
            dispatcher.on_notice(
                f"{self._address} is not encrypted: every user who can reach that address can run programs "
                "as the users of its workers, and can read this build"
            )
        last_present = time.monotonic()

        def check_present(present: bool) -> None:
            nonlocal last_present
            if present:
                last_present = time.monotonic()
            elif time.monotonic() - last_present > _NO_WORKER_S:
                raise WorkerError(f"{self._address}: has had no worker for {_NO_WORKER_S:.0f} s")

        with connect(self._address) as client:
            run_on_dask(client, self._address, job, dispatcher, check_present)


def _check_credentials(address: str) -> None:
    """Raise `ArgumentError` if an address needs credentials and Dask's configuration has no valid ones."""
    import dask
    from distributed.comm import parse_address
    from distributed.security import Security

    # A site may have a function that gets credentials from elsewhere.
    is_encrypted = parse_address(address)[0] in ("tls", "wss")
    if not is_encrypted or dask.config.get("distributed.client.security-loader"):
        return
    problem = (
        "set distributed.comm.tls.ca-file, distributed.comm.tls.client.cert and "
        "distributed.comm.tls.client.key in Dask's configuration to the paths of their files"
    )
    try:
        security = Security()
        tls = security.get_tls_config_for_role("client")
        if tls["ca_file"] and tls["cert"]:
            security.get_connection_args("client")
            return
    except (OSError, ValueError) as error:
        problem = f"those in Dask's configuration (distributed.comm.tls) cannot be used: {error}"
    raise ArgumentError("scheduler", f"{address} needs credentials: {problem}")


def trusts_network(address: str) -> bool:
    """Whether everybody who reaches an address from other machines can use it."""
    from distributed.comm import get_address_host, parse_address
    from distributed.utils import ensure_ip

    if parse_address(address)[0] not in ("tcp", "ws"):
        return False
    try:
        return not ip_address(ensure_ip(get_address_host(address))).is_loopback
    except (OSError, ValueError):
        return True


def run_on_dask(
    client: Client, where: str, job: BuildJob, dispatcher: Dispatcher, upkeep: Callable[[bool], None]
) -> None:
    """Make the frames of a dispatcher on a Dask cluster, as `Executor.make` does.

    `where` names the cluster in messages. `upkeep` is called about once a second with whether there is a
    worker, and raises `WorkerError` if none will come.
    """
    with _marker_file(job.folder) as marker, _DaskBuild(client, where, job, marker, dispatcher) as build:
        build.run(upkeep)


class _DaskBuild:
    """The workers of one build, by address, and their tasks.

    Dask itself would send all of a lost worker's task to another one; here the dispatcher requeues only the
    rest, and decides which worker continues with the plants of a set.
    """

    def __init__(
        self, client: Client, where: str, job: BuildJob, marker: Path, dispatcher: Dispatcher
    ) -> None:
        self._client, self._where, self._dispatcher = client, where, dispatcher
        self._request = BuildRequest.create(uuid.uuid4().hex, marker, job)
        self._messages: queue.SimpleQueue[tuple[int, FrameDone | None]] = queue.SimpleQueue()
        self._tasks: dict[int, tuple[str, Future]] = {}
        self._unfinished: set[int] = set()  # tasks that a worker may be processing, including recalled ones
        self._unfit: dict[str, str] = {}
        self._count = 0

    def __enter__(self) -> Self:
        self._client.subscribe_topic(TOPIC, self._receive)
        return self

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        for number in list(self._tasks):
            self._cancel(number)
        # Let workers finish their frames.
        end = time.monotonic() + (_PATIENCE_S if isinstance(error, PepperError) else _INTERRUPT_PATIENCE_S)
        while error is not None and self._unfinished and time.monotonic() < end:
            time.sleep(0.05)
        with suppress(Exception):
            # This fails if the scheduler is lost.
            self._client.unsubscribe_topic(TOPIC)

    def run(self, upkeep: Callable[[bool], None]) -> None:
        """Make all frames."""
        checked = -_CHECK_S
        while self._dispatcher:
            raise_if_interrupted()
            if time.monotonic() - checked >= _CHECK_S:
                upkeep(self._check_workers())
                checked = time.monotonic()
            try:
                number, done = self._messages.get(timeout=_CHECK_S)
            except queue.Empty:
                continue
            if done is not None:
                self._dispatcher.report(done)
            elif number in self._tasks:
                self._end_task(number)

    def _receive(self, event: tuple[float, dict[str, Any]]) -> None:
        """Receive a worker's message, in the client's thread."""
        message = event[1]
        if message.get("build") == self._request.build:
            if message["done"] is None:
                self._unfinished.discard(message["number"])
            else:
                self._messages.put((message["number"], pickle.loads(message["done"])))

    def _end_task(self, number: int) -> None:
        """React to the end of a task, and assign the next unit to its worker."""
        from distributed import KilledWorker

        address, future = self._tasks[number]
        error = future.exception() if future.status == "error" else None
        # A task that could not even be read sends no message of its end.
        self._unfinished.discard(number)
        if error is None and self._dispatcher.is_complete(address):
            self._dispatcher.release(self._cancel(number))
            self._assign(address)
        elif error is None or isinstance(error, KilledWorker):
            self._dispatcher.lose(self._cancel(number), f"at {address}")
        elif (reason := _unfit_reason(error)) is not None:
            self._dispatcher.release(self._cancel(number))
            self._unfit[address] = reason
            self._dispatcher.on_notice(f"the worker at {address} {reason}; it is not used")
        else:
            self._cancel(number)
            raise error

    def _check_workers(self) -> bool:
        """Requeue units of lost workers, assign units to new ones; returns whether there is a worker."""
        present = self._present_workers()
        for number, (address, _) in list(self._tasks.items()):
            if address not in present:
                self._unfinished.discard(number)
                self._dispatcher.lose(self._cancel(number), f"at {address}")
        for address in sorted(present - self._dispatcher.running.keys() - self._unfit.keys()):
            self._assign(address)
        if not self._tasks and present and present <= self._unfit.keys():
            address = min(present)
            raise WorkerError(
                f"no worker at {self._where} can be used: the one at {address} {self._unfit[address]}"
            )
        return bool(present)

    def _present_workers(self) -> set[str]:
        """Addresses of the workers that the scheduler knows."""
        try:
            if self._client.status == "running":
                return set(self._client.nthreads())
        except (OSError, TimeoutError):
            pass
        self._unfinished.clear()
        raise WorkerError(
            f"the scheduler at {self._where} is lost; complete frames are kept, and the same command resumes "
            "the build"
        )

    def _assign(self, address: str) -> None:
        indices = self._dispatcher.assign(address)
        if not indices:
            return
        number, self._count = self._count, self._count + 1
        future = self._client.submit(
            pickle.loads,
            pickle.dumps(UnitTask(self._request, number, indices), protocol=5),
            key=f"pepperscene-{self._request.build}-{number}",
            workers=[address],
            allow_other_workers=False,
            pure=False,
        )
        self._tasks[number] = address, future
        self._unfinished.add(number)
        future.add_done_callback(lambda _: self._messages.put((number, None)))

    def _cancel(self, number: int) -> str:
        """Cancel a task, which ends after the current frame; return its worker's address."""
        address, future = self._tasks.pop(number)
        with suppress(Exception):
            future.cancel()
        return address


def _unfit_reason(error: BaseException) -> str | None:
    """Reason why a worker cannot make frames at all, or None for any other error."""
    if isinstance(error, UnfitWorkerError):
        return str(error)
    # A task cannot be read where this package, or a module of the user's, is missing or has another version.
    unread = isinstance(error, AttributeError) and str(error).startswith("Can't get attribute")
    return f"cannot start ({error})" if unread or isinstance(error, ImportError) else None


@contextmanager
def _marker_file(folder: Path) -> Iterator[Path]:
    """A file in a folder, or in the first parent that exists, by which workers recognise the file system."""
    existing_folder = next(path for path in (folder, *folder.parents) if path.is_dir())
    with write_errors(existing_folder):
        file = tempfile.NamedTemporaryFile(  # noqa: SIM115 - entered below
            prefix=".pepperscene.", suffix=".tmp", dir=existing_folder
        )
    with file:
        yield Path(file.name)


@contextmanager
def connect(address: str, credentials: Security | None = None) -> Iterator[Client]:
    """A client of a scheduler, silent on the terminal; raises `WorkerError` if no scheduler answers.

    Without credentials, those of Dask's configuration are used.
    """
    from distributed import Client
    from distributed.versions import VersionMismatchWarning

    with quiet_libraries():
        try:
            with warnings.catch_warnings():
                # Workers compare the versions that matter themselves.
                warnings.simplefilter("ignore", VersionMismatchWarning)
                client = Client(address, timeout=_ANSWER_S, set_as_default=False, security=credentials)
        except (OSError, TimeoutError, ImportError, ValueError, RuntimeError) as error:
            reason = next(iter(str(error).splitlines()), type(error).__name__)
            raise WorkerError(f"{address}: no Dask scheduler answers there ({reason})") from None
        try:
            yield client
        finally:
            client.close(timeout=_ANSWER_S)


@contextmanager
def quiet_libraries() -> Iterator[None]:
    """Silence the loggers of Dask's libraries; what matters is reported in our own messages."""
    names = [name for name in logging.root.manager.loggerDict if name.split(".")[0] in _LIBRARIES]
    loggers = {logging.getLogger(name) for name in (*_LIBRARIES, *names)}
    levels = {logger: logger.level for logger in loggers}
    for logger in loggers:
        logger.setLevel(logging.CRITICAL + 1)
    try:
        yield
    finally:
        for logger, level in levels.items():
            logger.setLevel(level)


def missing_extra() -> SetupError:
    """The error to raise if Dask is not installed."""
    return SetupError("clusters need Dask: pip install 'pepperscene[cluster]'")
