"""The tables of a recipe file, one model for each."""

from __future__ import annotations

import datetime
import math
import re
from typing import Annotated, Any, Final, Literal

from pydantic import (
    AfterValidator,
    Field,
    ValidationError,
    ValidatorFunctionWrapHandler,
    WrapValidator,
    model_validator,
)

from pepperscene.classes import OrganClass
from pepperscene.document import Document


def _check_undecodable(value: Any, check: ValidatorFunctionWrapHandler) -> Any:
    """Check a name; the validator's own check of text refuses paths whose bytes are not UTF-8 (PEP 383)."""
    if not isinstance(value, str):
        return check(value)
    check(_SURROGATE.sub("_", value))
    return value


_SURROGATE: Final = re.compile("[\udc80-\udcff]")
Name = Annotated[
    str,
    Field(strict=True, min_length=1, max_length=400, pattern=r"^[^\x00-\x1f]+$"),
    WrapValidator(_check_undecodable),
]
"""A shipped name or a path."""

NONE: Final = "none"
"""Instead of a name: no flash, no filter, no cover, no white balance."""

PLANT_TABLES: Final = ("cultivar", "override", "growth", "row", "twine", "greenhouse")
"""Keys of a recipe that plants and their surroundings depend on."""

Angle = Annotated[float, Field(strict=True, ge=-180, le=180)]
Height = Annotated[float, Field(strict=True, ge=0, le=10_000)]
Switch = Annotated[bool, Field(strict=True)]
Fraction = Annotated[float, Field(strict=True, ge=0, le=1)]
Grey = Annotated[float, Field(strict=True, ge=0, le=255)]

LEAST_DAYLIGHT_LX: Final = 1e-4
"""Chosen: a moonless, overcast night."""

LEAST_SUN_FRACTION: Final = 1e-6
"""Chosen: far below the sunlight that passes an overcast sky."""

MOST_SUNLIGHT_LX: Final = 1e6
"""On a plane that faces the sun. Chosen: seven times what the sun gives above the atmosphere (133,000 lx;
Darula, Kittler and Gueymard 2005, Solar Energy 79:559), and far from where the renderer's numbers end."""

LEAST_TWINE_MM: Final = 0.1
"""Chosen: fine sewing thread."""

MIN_GUTTER_WIDTH_MM: Final = 110
"""The substrate block of a plant is 100 mm wide."""

MIN_WIRE_HEIGHT_MM: Final = 500
"""Above the gutter. Chosen: a lower wire could hardly hold a stem."""


def _zero_or_at_least(least: float) -> AfterValidator:
    """0 omits a part; a positive number that is no real part's is an error."""

    def check(value: float) -> float:
        if 0 < value < least:
            raise ValueError(f"must be 0 for none, or at least {least:g}")
        return value

    return AfterValidator(check)


def single_message(allowed: str) -> WrapValidator:
    """One sentence for a value of several forms, instead of an error for each form."""

    def check(value: Any, handler: ValidatorFunctionWrapHandler) -> Any:
        try:
            return handler(value)
        except ValidationError:
            raise ValueError(allowed) from None

    return WrapValidator(check)


class RowTable(Document):
    """The double row of plants: a front row at the aisle and a row behind it."""

    plants_front: Annotated[int, Field(strict=True, ge=1, le=50)]
    plants_back: Annotated[int, Field(strict=True, ge=0, le=50)]
    spacing_mm: Annotated[float, Field(strict=True, ge=50, le=2000)]
    gap_mm: Annotated[float, Field(strict=True, ge=0, le=5000)]
    shift_mm: Annotated[float, Field(strict=True, ge=-2000, le=2000)]


class DaylightTable(Document):
    """The partly cloudy sky above the greenhouse's cover; no sky if `illuminance_lx` is 0."""

    illuminance_lx: Annotated[
        float, Field(strict=True, ge=0, le=200_000), _zero_or_at_least(LEAST_DAYLIGHT_LX)
    ]
    sun_azimuth_deg: Annotated[float, Field(strict=True, ge=-360, le=360)] = 90.0
    sun_elevation_deg: Annotated[float, Field(strict=True, ge=1, le=90)] = 45.0
    sun_fraction: Annotated[
        float, Field(strict=True, ge=0, le=0.95), _zero_or_at_least(LEAST_SUN_FRACTION)
    ] = 0.0
    cloud_cover: Annotated[float, Field(strict=True, ge=0, le=1)] = 0.5
    cover: Name = NONE

    @model_validator(mode="after")
    def _check(self) -> DaylightTable:
        direct_lx = self.illuminance_lx * self.sun_fraction / math.sin(math.radians(self.sun_elevation_deg))
        if direct_lx > MOST_SUNLIGHT_LX:
            raise ValueError(
                f"illuminance_lx x sun_fraction / sin(sun_elevation_deg) = {direct_lx:.3g} lx "
                f"towards the sun must be at most {MOST_SUNLIGHT_LX:g} lx"
            )
        return self


class TwineTable(Document):
    """The twine that is wound around every stem; no twine if `diameter_mm` is 0."""

    diameter_mm: Annotated[float, Field(strict=True, ge=0, le=20), _zero_or_at_least(LEAST_TWINE_MM)]
    turns_per_m: Annotated[float, Field(strict=True, ge=0, le=50)]


class GreenhouseTable(Document):
    """Surroundings of the double row, and irregularity of its plants; 0 or false omits a part."""

    row_lean_deg: Annotated[float, Field(strict=True, ge=0, le=20)] = 0.0
    lean_sd_deg: Annotated[float, Field(strict=True, ge=0, le=10)] = 0.0
    turn_sd_deg: Annotated[float, Field(strict=True, ge=0, le=180)] = 0.0
    spacing_sd_mm: Annotated[float, Field(strict=True, ge=0, le=500)] = 0.0
    across_sd_mm: Annotated[float, Field(strict=True, ge=0, le=500)] = 0.0
    gutter_width_mm: Annotated[float, Field(strict=True, ge=0, le=1000)] = 0.0
    gutter_height_mm: Annotated[float, Field(strict=True, ge=0, le=1500)] = 0.0
    floor: Switch = False
    crop_wire_mm: Annotated[float, Field(strict=True, ge=0, le=10_000)] = 0.0
    far_rows: Annotated[int, Field(strict=True, ge=0, le=5)] = 0
    far_rows_as: Literal["labels", "ignore", "background"] = "labels"
    far_reach_mm: Annotated[float, Field(strict=True, ge=500, le=20_000)] = 4000.0
    aisle_mm: Annotated[float, Field(strict=True, ge=600, le=5000)] = 1200.0
    pipes: Switch = False

    @model_validator(mode="after")
    def _check(self) -> GreenhouseTable:
        if self.gutter_width_mm == 0 and self.gutter_height_mm > 0:
            raise ValueError("gutter_height_mm needs a gutter_width_mm above 0")
        if 0 < self.gutter_width_mm < MIN_GUTTER_WIDTH_MM:
            raise ValueError(
                f"gutter_width_mm = {self.gutter_width_mm:g} must be 0 for none, or at least "
                f"{MIN_GUTTER_WIDTH_MM}, so that a plant's block fits in"
            )
        if 0 < self.crop_wire_mm < self.gutter_height_mm + MIN_WIRE_HEIGHT_MM:
            raise ValueError(
                f"crop_wire_mm = {self.crop_wire_mm:g} must be 0 for none, or at least "
                f"{MIN_WIRE_HEIGHT_MM} above the gutter"
            )
        return self


class GrowthTable(Document):
    """A growth stage between those of two cultivar files, by date or by the fraction of the way, `share`."""

    until: Name
    share: Fraction | None = None
    date: Annotated[datetime.date, Field(strict=True)] | None = None

    @model_validator(mode="after")
    def _check(self) -> GrowthTable:
        if (self.share is None) == (self.date is None):
            raise ValueError("must hold either share or date, and not both")
        return self


class WhiteReferenceTable(Document):
    """The white reference of the output `reflectance`, as in `pepperscene.camera.WhiteReference`.

    Without `distance_mm`, it is at the nearest distance from the camera to its subject.
    """

    reflectance: Annotated[float, Field(strict=True, ge=0.01, le=1)] = 0.99
    distance_mm: Annotated[float, Field(strict=True, ge=10, le=100_000)] | None = None
    facing: Literal["camera", "up"] = "camera"


class ExpectTable(Document):
    """Expected statistics of a finished data set, for `pepperscene check`; frames do not depend on them.

    Attributes:
        intensity: minimum and maximum of the photographs' mean grey value over the whole set, 0 to 255.
        frame_intensity: the same for every single frame.
        saturated: maximum fraction of a frame's pixels with a channel at 255.
        share: minimum and maximum fraction of all pixels of the set, by lower-case class name.
    """

    intensity: tuple[Grey, Grey] | None = None
    frame_intensity: tuple[Grey, Grey] | None = None
    saturated: Fraction | None = None
    share: dict[str, tuple[Fraction, Fraction]] = Field(default_factory=dict)

    @model_validator(mode="after")
    def _check(self) -> ExpectTable:
        names = [organ_class.name.lower() for organ_class in OrganClass]
        for name in self.share:
            if name not in names:
                raise ValueError(f"share.{name} is not a class; allowed are {', '.join(names)}")
        ranges = {"intensity": self.intensity, "frame_intensity": self.frame_intensity}
        ranges |= {f"share.{name}": limits for name, limits in self.share.items()}
        for name, limits in ranges.items():
            if limits is not None and not limits[0] <= limits[1]:
                raise ValueError(f"{name} = {list(limits)} must be [minimum, maximum]")
        return self
