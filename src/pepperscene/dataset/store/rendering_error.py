"""Frames whose rendering error is above the target of their build, and what to tell the user about them."""

from __future__ import annotations

import math
import statistics
from collections.abc import Iterator
from typing import Any

from pepperscene.frame import is_target_met


class RenderingErrors:
    """Accumulates the estimated errors of frames, and compares them with their targets."""

    def __init__(self) -> None:
        self._frames = 0
        self._target = math.nan  # of the last frame that misses its own; those of a build are equal
        self._missed: list[tuple[float, float]] = []  # error over noise, and error in codes

    def add(self, target: Any, error_codes: Any, noise_codes: Any) -> None:
        """Add a frame; one without a target or with unknown values is ignored.

        Args:
            target: error over noise at which sampling stops; None for a fixed number of samples.
            error_codes: estimated root mean square error of the traced light, 8-bit codes.
            noise_codes: that of the sensor noise.
        """
        if not all(_is_positive(value) for value in (target, error_codes, noise_codes)):
            return
        self._frames += 1
        if not is_target_met(ratio := error_codes / noise_codes, target):
            self._target = target
            self._missed.append((ratio, error_codes))

    def notes(self) -> Iterator[str]:
        """Yield at most one note."""
        if not self._missed:
            return
        ratios, codes = zip(*self._missed, strict=True)
        yield (
            f"in {len(self._missed)} of {self._frames} frames the rendering error is above its target of "
            f"{self._target:g} times the sensor noise: {statistics.median(ratios):.2g} times (median), "
            f"at most {max(codes):.1f} codes of 255; a smaller --target-error takes more samples"
        )


def _is_positive(value: Any) -> bool:
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    return is_number and math.isfinite(value) and value > 0.0
