"""Notes on the exposure of photographs: dark or overexposed sets, and limits of automatic exposure."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from typing import Any, Final

from pepperscene.recipe.camera_tables import AUTO
from pepperscene.review.check.findings import json_object

_DARK: Final = 40.0
"""Chosen: mean grey value. The photographs of Barth et al. 2018, by flash in the dark, have 37."""
_BRIGHT: Final = 180.0  # chosen: mean grey value; leaves of such photographs are nearly white
_SATURATED: Final = 0.05  # chosen: fraction of the pixels; well exposed daylight has a tenth of it
_LONGEST_NAME: Final = 40  # chosen: of a limit in a note


class Exposures:
    """Accumulates the brightness of photographs and the limits that automatic exposures reached.

    Args:
        info: the content of `dataset.json`. If it has expectations, they are checked elsewhere, and there is
            no note on brightness.
    """

    def __init__(self, info: Mapping[str, Any]) -> None:
        camera = json_object(json_object(info, "recipe"), "camera")
        self._is_auto, self._is_judged = camera.get("exposure_us") == AUTO, "expect" not in info
        self._photographs = self._automatic = 0
        self._grey = self._saturated = 0.0  # sums over the photographs
        self._limits: Counter[str] = Counter()

    def add(self, mean: float | None, saturated: float, automatic: Mapping[str, Any] | None) -> None:
        """Add a frame.

        Args:
            mean: grey value of its photograph; None if it has none.
            saturated: fraction of the photograph's pixels with a channel at 255.
            automatic: `auto_exposure` of the frame's JSON, or None.
        """
        if mean is not None:
            self._photographs += 1
            self._grey += mean
            self._saturated += saturated
        if automatic is not None:
            self._automatic += 1
            if (limit := automatic.get("limited_by")) is not None:
                self._limits[str(limit)[:_LONGEST_NAME]] += 1

    def notes(self) -> Iterator[str]:
        """Yield at most one note on brightness, and one on limits."""
        if self._is_judged and self._photographs:
            mean, saturated = self._grey / self._photographs, self._saturated / self._photographs
            if mean < _DARK:
                problem = f"the photographs are dark: their mean grey value is {mean:.0f} of 255"
                yield f"{problem}; {self._advice('longer', 'raise')}"
            elif mean > _BRIGHT or saturated > _SATURATED:
                problem = "the photographs are overexposed: "
                problem += f"their mean grey value is {mean:.0f} of 255, and {saturated:.1%} of their pixels"
                yield f"{problem} have a channel at 255; {self._advice('shorter', 'lower')}"
        if self._limits:
            limits = ", ".join(f"{count} {limit}" for limit, count in sorted(self._limits.items()))
            number = f"{self._limits.total()} of {self._automatic} automatic exposures"
            yield f"{number} reached a limit ({limits}), so their grey is not auto_exposure.target_grey"

    def _advice(self, length: str, change: str) -> str:
        if self._is_auto:
            return f"{change} auto_exposure.target_grey, or widen auto_exposure.exposure_us"
        return f'set a {length} camera.exposure_us, or exposure_us = "auto"'
