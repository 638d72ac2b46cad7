"""Renderers that workers of a cluster can import: they note who rendered what, and one waits at a gate."""

from __future__ import annotations

import os
import time
from pathlib import Path

from stand_in import StandIn

_FREE = 3
_rendered = 0


class Noting(StandIn):
    """Appends a line "process seed" to the file named by `NOTES` before each frame."""

    def render(self, camera, outputs=(), quality="standard", seed=0, **others):
        with open(os.environ["NOTES"], "a", encoding="utf-8") as file:
            file.write(f"{os.getpid()} {seed}\n")
        return super().render(camera, outputs, quality, seed, **others)


class Gated(Noting):
    """Waits, after a process's third frame, until the file named by `GATE` is there."""

    def render(self, camera, outputs=(), quality="standard", seed=0, **others):
        global _rendered
        frame = super().render(camera, outputs, quality, seed, **others)
        _rendered += 1
        while _rendered > _FREE and not Path(os.environ["GATE"]).exists():
            time.sleep(0.02)
        return frame
