"""A Python of its own that does work for this one.

Not a fork, as the kernel may have started its threads; and none of the `multiprocessing` module, which would
run the user's script again. The two talk through the child's standard input and output, in pickles. A child
ends with its input, whatever becomes of its parent, and is not told of Ctrl-C.
"""

from __future__ import annotations

import os
import pickle
import subprocess
import sys
import tempfile
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import IO, Any, Final

THREADS: Final = ("PEPPERSCENE_THREADS", "OIDN_NUM_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS")
"""Environment variables that keep a process to its cores: for Mitsuba, the denoiser, the matrix library."""

_LAST_WORDS: Final = 4000  # chosen: bytes of what a child wrote on its standard error
_GRACE_S: Final = 5.0  # chosen: a child that is told to end has nothing to finish but system calls


class WorkerProcess:
    """The parent's side.

    Args:
        module: whose function `serve` the child runs, between `listening` and its end.
        environment: variables that the child has besides those of this process.

    Raises:
        OSError: the machine starts no further process.
    """

    def __init__(self, module: str, environment: Mapping[str, str] | None = None) -> None:
        self._words = tempfile.TemporaryFile()  # noqa: SIM115 - closed with the child
        try:
            self._process = subprocess.Popen(
                [sys.executable, "-P", "-c", f"from {module} import serve; serve()"],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=self._words,
                env={**os.environ, **(environment or {})},
                start_new_session=True,
            )
        except BaseException:
            self._words.close()
            raise

    @property
    def number(self) -> int:
        """The process number that the system gave it."""
        return self._process.pid

    def same(self) -> bool:
        """Whether it is the same Python and package as this one; the first thing that it is asked.

        Another version of this package would make other frames.

        Raises:
            EOFError: the child has ended.
        """
        return bool(self.hear() == identity())

    def say(self, thing: Any) -> None:
        """Send something.

        Raises:
            OSError: the child has ended.
        """
        if self._process.stdin is not None:
            say(self._process.stdin, thing)

    def hear(self) -> Any:
        """The next thing that the child says; waits for it.

        Raises:
            EOFError: the child has ended.
        """
        if self._process.stdout is None:
            raise EOFError
        try:
            return pickle.load(self._process.stdout)
        except (OSError, pickle.UnpicklingError) as fault:
            # What a killed child had begun to say.
            raise EOFError(str(fault)) from None

    def dismiss(self) -> None:
        """Tell the child that nothing more will come; it ends after what it is at."""
        if self._process.stdin is not None:
            with suppress(OSError):
                self._process.stdin.close()

    def ended(self, patience_s: float = _GRACE_S) -> int | None:
        """Its exit status, a negative signal's number where one ended it; None when it still runs."""
        with suppress(subprocess.TimeoutExpired):
            return self._process.wait(patience_s)
        return None

    def last_words(self) -> str:
        """The end of what it wrote on its standard error."""
        size = self._words.seek(0, os.SEEK_END)
        self._words.seek(max(0, size - _LAST_WORDS))
        return self._words.read().decode(errors="replace").strip()

    def kill(self) -> None:
        """End it at once."""
        self._process.kill()

    def close(self) -> None:
        """Give back what the child took, once it has ended."""
        with suppress(OSError):
            self._process.__exit__(None, None, None)
        self._words.close()


def listening() -> tuple[IO[bytes], IO[bytes]]:
    """The child's side: what it is asked through and what it tells through, its identity being told already.

    Whatever prints from now on goes to the standard error, where it cannot get between what is told.
    """
    asked, told = sys.stdin.buffer, os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)
    say(told, identity())
    return asked, told


def say(pipe: IO[bytes], thing: Any) -> None:
    """Send something through a pipe."""
    pickle.dump(thing, pipe, protocol=5)
    pipe.flush()


def identity() -> tuple[str, str]:
    """Which Python and which package this is."""
    return sys.version, str(Path(__file__).resolve())
