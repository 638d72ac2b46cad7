"""Signals while a command runs: they set a flag, which is looked at between frames, passes and files.

Python runs signal handlers between any two instructions of the main thread. An exception raised there breaks
an import of a compiled library, is lost in a destructor, or ends the process if a library cannot pass it on.
"""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Final

_SIGNALS: Final = [getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)]

_PATIENCE_S: Final = 25.0
"""Chosen: time until the flag is looked at and for the clean-up. Slurm's default is to kill after 30 s."""

_MAX_SIGNALS: Final = 3
"""Chosen: the third signal ends a command at once. Some programs send every signal twice, to a process and to
its group."""


class Interrupted(KeyboardInterrupt):
    """A signal has interrupted the command.

    Args:
        number: of the signal.
    """

    def __init__(self, number: int) -> None:
        super().__init__(number)
        self.number = number


class _Signals:
    """The signals that have arrived for the running command, and the handlers that were installed before."""

    def __init__(self) -> None:
        self.number: int | None = None
        self.is_raised = False
        self._count = 0
        self._previous: dict[int, object] = {}

    def install(self) -> None:
        for number in _SIGNALS:
            # `nohup` and shells ignore signals on behalf of background processes.
            if (previous := signal.getsignal(number)) not in (signal.SIG_IGN, None):
                self._previous[number] = previous
                signal.signal(number, self._on_signal)
        if hasattr(signal, "SIGALRM"):
            self._previous[signal.SIGALRM] = signal.signal(signal.SIGALRM, self._end_at_once)

    def remove(self) -> None:
        if hasattr(signal, "SIGALRM"):
            signal.setitimer(signal.ITIMER_REAL, 0.0)
        for number, previous in self._previous.items():
            signal.signal(number, previous)  # type: ignore[arg-type]

    def _on_signal(self, number: int, frame: FrameType | None) -> None:
        self._count += 1
        if self.number is None:
            self.number = number
            if hasattr(signal, "SIGALRM"):
                signal.setitimer(signal.ITIMER_REAL, _PATIENCE_S)
        if self._count >= _MAX_SIGNALS:
            self._end_at_once(number, frame)

    def _end_at_once(self, _: int, __: FrameType | None) -> None:
        """Leave the signal to the previous handlers, which end the process."""
        assert self.number is not None
        self.remove()
        signal.raise_signal(self.number)


_signals: _Signals | None = None


def raise_if_interrupted() -> None:
    """Raise `Interrupted`, once, if a signal has arrived for the running command; called where that is safe.

    It does nothing in other threads than the main one.
    """
    signals = _signals
    if signals is None or signals.number is None or signals.is_raised:
        return
    if threading.current_thread() is threading.main_thread():
        signals.is_raised = True
        raise Interrupted(signals.number)


@contextmanager
def interruptible() -> Iterator[None]:
    """Let signals set the flag of a command, in place of what they do otherwise."""
    global _signals
    # Python allows handlers in the main thread only.
    if threading.current_thread() is not threading.main_thread() or _signals is not None:
        yield
        return
    _signals = _Signals()
    try:
        _signals.install()
        yield
    finally:
        _signals.remove()
        _signals = None
