"""How fast a build goes, and how much of it is left."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable
from typing import Final

_WINDOW: Final = 200  # chosen: frames that the rate is taken over, so that it follows changes
_SPAN_S: Final = 120.0  # chosen: seconds that it is taken over, likewise


class Pace:
    """Counts frames; those that were there already do not count for the rate.

    Args:
        total: frames that are wanted.
        clock: seconds, steadily increasing.
    """

    def __init__(self, total: int, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock, self._total = clock, total
        self.done = 0
        self._made = deque([clock()], maxlen=_WINDOW)

    def count(self, made: bool) -> None:
        """One more frame is there."""
        self.done += 1
        if made:
            self._made.append(self._clock())
            while len(self._made) > 2 and self._made[-1] - self._made[0] > _SPAN_S:
                self._made.popleft()
        elif len(self._made) == 1:
            # Looking at what is there takes time that no frame was made in.
            self._made[0] = self._clock()

    @property
    def frames_per_s(self) -> float | None:
        """Frames made in a second, lately; None before the first."""
        took = self._made[-1] - self._made[0]
        return (len(self._made) - 1) / took if took > 0 else None

    @property
    def left_s(self) -> float | None:
        """Seconds for the rest at this rate, were none of it there; None before the first frame."""
        rate = self.frames_per_s
        return None if rate is None else (self._total - self.done) / rate
