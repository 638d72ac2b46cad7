"""Python subprocesses that serve requests of this process, as pickles through pipes.

They are not forked, because the renderer may have started threads, and not started by `multiprocessing`,
which would run the user's script again. A worker ends when its input ends, even if its parent was killed, and
does not receive Ctrl-C. All that it needs is a module with a function `serve(connection)`:

    worker = WorkerProcess("package.module")    def serve(connection):
    worker.send(state)                              for request in connection:
    reply = worker.call(request)                        connection.send(answer(connection.state, request))
"""

from __future__ import annotations

import importlib
import os
import pickle
import queue
import signal
import subprocess
import sys
import tempfile
import threading
import traceback
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from typing import IO, Any, Final, Self

THREADS: Final = ("PEPPERSCENE_THREADS", "OIDN_NUM_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS")
"""Environment variables that limit the threads of a process: of Mitsuba, the denoiser, the matrix library."""

GRACE_S: Final = 5.0  # chosen: how long a worker that has nothing to finish may take to end
_LIKELY_CAUSES: Final = {
    "SIGKILL": ", as when memory runs out",
    **dict.fromkeys(("SIGSEGV", "SIGABRT"), ", as when the address space (`ulimit -v`) runs out"),
}
_STDERR_KEPT: Final = 4000  # chosen: bytes at the end of a worker's standard error


class WorkerProcess:
    """A worker process, seen from its parent; it imports from the same folders.

    Iterating over it yields replies until it ends.

    Args:
        module: name of the module whose function `serve` the worker runs.
        threads: limit of the numeric libraries' threads, or None.
        environment: further environment variables.

    Raises:
        OSError: the system cannot start another process.
    """

    def __init__(
        self, module: str, threads: int | None = None, environment: Mapping[str, str] | None = None
    ) -> None:
        limits = {} if threads is None else dict.fromkeys(THREADS, str(threads))
        paths = f"import sys; sys.path[:] = {sys.path!r}"
        run = f"from {__name__} import run_worker; run_worker({module!r})"
        self._ending = ""
        self._stderr = tempfile.TemporaryFile()  # noqa: SIM115 - closed by `close`
        try:
            self._process = subprocess.Popen(
                [sys.executable, "-P", "-c", f"{paths}; {run}"],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=self._stderr,
                env={**os.environ, **limits, **(environment or {})},
                start_new_session=True,
            )
        except BaseException:
            self._stderr.close()
            raise

    def send(self, message: Any) -> None:
        """Send the worker's state, which comes first, or a request; raises `OSError` if it has ended."""
        stdin = self._process.stdin
        if stdin is None or stdin.closed:
            raise BrokenPipeError
        try:
            _send(stdin, message)
        except ValueError:
            # Another thread has closed the pipe meanwhile.
            raise BrokenPipeError from None

    def receive(self) -> Any:
        """Wait for the next reply; raises `EOFError` if the worker has ended."""
        assert self._process.stdout is not None
        try:
            return pickle.load(self._process.stdout)
        except (OSError, ValueError, pickle.UnpicklingError) as error:
            # A worker that is killed may leave an incomplete reply.
            raise EOFError(str(error)) from None

    def call(self, request: Any) -> Any:
        """Send a request and wait for its reply; raises `OSError` or `EOFError` if the worker has ended."""
        self.send(request)
        return self.receive()

    def __iter__(self) -> Iterator[Any]:
        with suppress(EOFError):
            while True:
                yield self.receive()

    def finish(self) -> None:
        """Close the worker's input: it ends after its current request."""
        if self._process.stdin is not None:
            with suppress(OSError):
                self._process.stdin.close()

    def close(self, patience_s: float = GRACE_S) -> str:
        """End the worker, by force after some seconds, and return how it ended, in words."""
        if self._ending:
            return self._ending
        self.finish()
        status = None
        try:
            status = self._process.wait(patience_s)
        except subprocess.TimeoutExpired:
            self._process.kill()
        with suppress(OSError):
            self._process.__exit__(None, None, None)
        size = self._stderr.seek(0, os.SEEK_END)
        self._stderr.seek(max(0, size - _STDERR_KEPT))
        lines = self._stderr.read().decode(errors="replace").strip().splitlines()
        self._stderr.close()
        if status is None:
            self._ending = "it did not respond"
        elif status < 0:
            name = signal.Signals(-status).name if -status in set(signal.Signals) else f"signal {-status}"
            self._ending = f"killed by {name}" + _LIKELY_CAUSES.get(name, "")
        else:
            self._ending = f"exit code {status}" + (f": {lines[-1]}" if lines else "")
        return self._ending


class Connection:
    """A worker's connection with its parent; iterating over it yields the requests until the input ends.

    Requests are read in a thread, so that the end of the input is noticed while a request is served.

    Attributes:
        state: the first message.
        closed: set when the input has ended.
    """

    def __init__(self, requests: IO[bytes], replies: IO[bytes]) -> None:
        self._requests, self._replies = requests, replies
        self._queue: queue.SimpleQueue[tuple[Any, ...]] = queue.SimpleQueue()
        self.closed = threading.Event()
        self.state = pickle.load(requests)
        threading.Thread(target=self._read, name="requests", daemon=True).start()

    def __iter__(self) -> Iterator[Any]:
        while request := self._queue.get():
            yield request[0]

    def send(self, reply: Any) -> None:
        """Send a reply; raises `BrokenPipeError` if the parent has ended."""
        _send(self._replies, reply)

    def _read(self) -> None:
        try:
            with suppress(EOFError, OSError, pickle.UnpicklingError):
                while True:
                    self._queue.put((pickle.load(self._requests),))
        finally:
            self.closed.set()
            self._queue.put(())


class FunctionWorker:
    """Calls functions in another process, which starts with the first call and then serves all of them.

    To start a process takes as long as to make three plants.
    """

    def __init__(self) -> None:
        self._process: WorkerProcess | None = None

    def start(self) -> None:
        """Start the process, if it has not been started; raises `OSError` if the system cannot."""
        if self._process is None:
            self._process = WorkerProcess(__name__)
            self._process.send(None)

    def call(self, function: Callable[..., Any], *arguments: Any) -> Any:
        """The result of a function of a module there; raises `OSError` or `EOFError` if the process fails."""
        self.start()
        assert self._process is not None
        return self._process.call((function, arguments))

    def close(self, patience_s: float = GRACE_S) -> None:
        """End the process, by force after some seconds."""
        if self._process is not None:
            self._process.close(patience_s)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def serve(connection: Connection) -> None:
    """Call the requested functions, in a `FunctionWorker`'s process."""
    for function, arguments in connection:
        connection.send(function(*arguments))


def run_worker(module: str) -> None:
    """Run a worker: its process starts here."""
    replies = os.fdopen(os.dup(1), "wb")
    # Whatever is printed goes to the standard error, not between the replies.
    os.dup2(2, 1)
    status = 1
    try:
        with suppress(EOFError, BrokenPipeError):
            importlib.import_module(module).serve(Connection(sys.stdin.buffer, replies))
        status = 0
    except Exception:
        traceback.print_exc()
    finally:
        # Python would wait for the thread that reads requests, and that thread for the input.
        sys.stderr.flush()
        os._exit(status)


def available_cores() -> int:
    """Processor cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def _send(pipe: IO[bytes], message: Any) -> None:
    pickle.dump(message, pipe, protocol=5)
    pipe.flush()
