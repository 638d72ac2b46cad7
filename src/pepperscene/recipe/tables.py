"""The tables of a recipe file that no other package uses, one data class for each."""

from __future__ import annotations

import datetime
from dataclasses import dataclass, field
from typing import Annotated, Final, Literal

from pydantic import Field

from pepperscene.classes import OrganClass
from pepperscene.units import MILLIMETRES, Fraction, Name, Table, within

PLANT_TABLES: Final = (
    "cultivar",
    "override",
    "growth",
    "row",
    "twine",
    "greenhouse",
    "skin_texture",
    "stand",
)
"""Keys of a recipe that plants and their surroundings depend on."""

Grey = Annotated[float, within(0, 255)]


@dataclass(frozen=True, kw_only=True)
class GrowthTable(Table):
    """A growth stage between those of two cultivar files, by date or by the fraction of the way, `share`.

    Attributes:
        until: the later stage: a shipped cultivar, or the path of a cultivar file.
        share: fraction of the way from the first stage to the later one.
        date: instead of `share`: a day between the `date`s of the two cultivar files, such as `2016-06-01`.
    """

    until: Name
    share: Fraction | None = None
    date: Annotated[datetime.date, Field(strict=True)] | None = None

    def __post_init__(self) -> None:
        if (self.share is None) == (self.date is None):
            raise ValueError("must hold either share or date, and not both")


@dataclass(frozen=True, kw_only=True)
class WhiteReferenceTable(Table):
    """The white reference of the output `reflectance`, as in `pepperscene.camera.WhiteReference`.

    Without `distance_m`, it is at the nearest distance from the camera to its subject.

    Attributes:
        reflectance: of the panel, in all bands.
        distance_m: of its centre along the optical axis; it matters in the light of a flash. Default: the
            nearest distance from the camera to its subject, as of the views.
        facing: across the optical axis, or level.
    """

    reflectance: Annotated[float, within(0.01, 1)] = 0.99
    distance_m: Annotated[float, within(10, 100_000), MILLIMETRES] | None = None
    facing: Literal["camera", "up"] = "camera"


@dataclass(frozen=True, kw_only=True)
class ExpectTable(Table):
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
    share: dict[str, tuple[Fraction, Fraction]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        names = [organ_class.name.lower() for organ_class in OrganClass]
        for name in self.share:
            if name not in names:
                raise ValueError(f"share.{name} is not a class; allowed are {', '.join(names)}")
        ranges = {"intensity": self.intensity, "frame_intensity": self.frame_intensity}
        ranges |= {f"share.{name}": limits for name, limits in self.share.items()}
        for name, limits in ranges.items():
            if limits is not None and not limits[0] <= limits[1]:
                raise ValueError(f"{name} = {list(limits)} must be [minimum, maximum]")
