"""Options of a calibration."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated

from pepperscene.errors import ArgumentError
from pepperscene.options import Option, check_options


@dataclass(frozen=True)
class CalibrationOptions:
    """How photographs are read, and which camera of the program shall look like that of the photographs.

    Attributes:
        recipe: name or path of the recipe whose sensor, lens and light of the white balance are taken, and
            which the written one extends.
        corners: x, y of the four outer corners of the fields at the chart's corners, in pixels, in order
            around it; None detects the chart.
        grey_card: left, top, width and height of a rectangle on a grey card, in pixels; None for a chart.
        seed: of the resamples and of the model's noise.
    """

    recipe: Annotated[str, Option("Recipe to extend, whose sensor, lens and light are used.", "NAME")] = (
        "greenhouse"
    )
    corners: tuple[float, ...] | None = None
    grey_card: tuple[float, ...] | None = None
    seed: Annotated[int, Option("Random seed: resamples, noise.", minimum=0, shows_range=True)] = 0

    def __post_init__(self) -> None:
        check_options(self)
        for name, count in (("corners", 8), ("grey_card", 4)):
            value = getattr(self, name)
            if value is not None and (len(value) != count or not all(map(math.isfinite, value))):
                raise ArgumentError(name, f"must be {count} numbers separated by commas")
        if self.corners is not None and self.grey_card is not None:
            raise ArgumentError("grey_card", "cannot be combined with corners")
