"""A second process that makes parts of a scene beside this one."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Self

from pepperscene.building.subprocess_rpc import GRACE_S, Connection, WorkerProcess


class SceneWorker:
    """Calls functions in another process, which starts with the first call and then serves all parts.

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
    """Call the requested functions, in a worker process."""
    for function, arguments in connection:
        connection.send(function(*arguments))
