"""Signals while a command runs: it is interrupted where its clean-up is safe.

Python runs signal handlers between any two instructions of the main thread. An exception raised there breaks
an import of a compiled library, is lost in a destructor, or ends the process if a library cannot pass it on.
So a handler raises only if the interrupted code is this package's own, or waits for threads or processes.
Otherwise a timer tries again.
"""

from __future__ import annotations

import signal
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path
from types import CodeType, FrameType
from typing import Final, final

_SIGNALS: Final = [getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)]
_PACKAGE: Final = str(Path(__file__).parents[1])

_RETRY_S: Final = 0.01
"""Chosen: time between two tries, short against what a user notices."""

_PATIENCE_S: Final = 25.0
"""Chosen: time for reaching a safe place and for the clean-up. Slurm's default is to kill after 30 s."""

_MAX_SIGNALS: Final = 3
"""Chosen: the third signal ends a command at once. Some programs send every signal twice, to a process and to
its group."""

_WAITS: Final = {
    ("threading", "wait"), ("threading", "join"), ("threading", "_wait_for_tstate_lock"),
    ("concurrent.futures._base", "result"), ("subprocess", "_communicate"), ("subprocess", "_try_wait"),
    ("selectors", "select"),
}  # fmt: skip
"""Functions of Python, by module, that wait and can be interrupted."""

_UNSAFE_MODULES: Final = ("importlib", "pepperscene.cli.streams")
"""Beginnings of the names of modules whose functions must not be interrupted: compiled libraries would be
imported incompletely, and text is written twice if a write ends without the number of its bytes."""

_UNSAFE_FUNCTIONS: Final = {"__del__", "weakref_cb"}
"""Functions that Python calls itself: it prints their exceptions and goes on."""


class Interrupted(KeyboardInterrupt):
    """A signal has interrupted the command.

    Args:
        number: of the signal.
    """

    def __init__(self, number: int) -> None:
        super().__init__(number)
        self.number = number


@final
class Interruption:
    """Whether a command was interrupted.

    Args:
        command: code of the command's function; exceptions are raised only while it runs.
    """

    def __init__(self, command: CodeType) -> None:
        self._command = command
        self._number: int | None = None
        self._count = 0
        self._end_s = 0.0
        self._is_raised = False
        self._previous: dict[int, object] = {}

    def raise_if_pending(self) -> None:
        """Raise `Interrupted` if a signal has arrived, unless it was raised before."""
        if self._number is None or self._is_raised:
            return
        self._is_raised = True
        # From now on the timer limits the clean-up.
        if hasattr(signal, "SIGALRM"):
            signal.setitimer(signal.ITIMER_REAL, max(_RETRY_S, self._end_s - time.monotonic()), _RETRY_S)
        raise Interrupted(self._number)

    def install(self) -> None:
        """Install the handlers."""
        for number in _SIGNALS:
            # `nohup` and shells ignore signals on behalf of background processes.
            if (previous := signal.getsignal(number)) not in (signal.SIG_IGN, None):
                self._previous[number] = previous
                signal.signal(number, self._on_signal)
        if hasattr(signal, "SIGALRM"):
            self._previous[signal.SIGALRM] = signal.signal(signal.SIGALRM, self._on_alarm)

    def remove(self) -> None:
        """Install the previous handlers again."""
        if hasattr(signal, "SIGALRM"):
            signal.setitimer(signal.ITIMER_REAL, 0.0)
        for number, previous in self._previous.items():
            signal.signal(number, previous)  # type: ignore[arg-type]

    def _on_signal(self, number: int, frame: FrameType | None) -> None:
        self._count += 1
        if self._number is None:
            self._number, self._end_s = number, time.monotonic() + _PATIENCE_S
            if hasattr(signal, "SIGALRM"):
                signal.setitimer(signal.ITIMER_REAL, _RETRY_S, _RETRY_S)
        if self._count >= _MAX_SIGNALS:
            self._end_at_once()
        self._raise_if_safe(frame)

    def _on_alarm(self, _: int, frame: FrameType | None) -> None:
        if time.monotonic() >= self._end_s:
            self._end_at_once()
        self._raise_if_safe(frame)

    def _raise_if_safe(self, frame: FrameType | None) -> None:
        if frame is not None and not self._is_raised and _is_safe(frame, self._command):
            self.raise_if_pending()

    def _end_at_once(self) -> None:
        """Leave the signal to the previous handlers, which end the process."""
        assert self._number is not None
        self.remove()
        signal.raise_signal(self._number)


_running: ContextVar[Interruption | None] = ContextVar("running command", default=None)


def raise_if_interrupted() -> None:
    """Raise `Interrupted` if a signal has arrived for the running command; call it where that is safe."""
    interruption = _running.get()
    if interruption is not None:
        interruption.raise_if_pending()


@contextmanager
def interruptible(command: CodeType) -> Iterator[Interruption]:
    """Let signals interrupt a command; its function has this code."""
    interruption = Interruption(command)
    # Python allows handlers in the main thread only.
    if threading.current_thread() is not threading.main_thread():
        yield interruption
        return
    token = _running.set(interruption)
    try:
        interruption.install()
        yield interruption
    finally:
        interruption.remove()
        _running.reset(token)


def _is_safe(frame: FrameType, command: CodeType) -> bool:
    """Whether an exception that is raised in a frame unwinds up to the command."""
    module, code = frame.f_globals.get("__name__"), frame.f_code
    if not code.co_filename.startswith(_PACKAGE) and (module, code.co_name) not in _WAITS:
        return False
    caller: FrameType | None = frame
    while caller is not None:
        if caller.f_code is command:
            return True
        module = str(caller.f_globals.get("__name__"))
        if module.startswith(_UNSAFE_MODULES) or caller.f_code.co_name in _UNSAFE_FUNCTIONS:
            return False
        caller = caller.f_back
    return False
