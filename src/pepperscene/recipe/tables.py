"""The tables of a recipe file that no other package uses, one data class for each."""

from __future__ import annotations

import datetime
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Annotated, Final, Literal

from pydantic import Field

from pepperscene.classes import OrganClass
from pepperscene.units import MILLIMETRES, Angle, Fraction, Name, Table, within

if TYPE_CHECKING:
    from pepperscene.camera import Lamp

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


MOST_LAMPS: Final = 1000
"""Of a recipe, with those of grids. Chosen: top lights of a hectare; each sample weighs all of them."""

Coordinate = Annotated[float, within(-1_000_000, 1_000_000), MILLIMETRES]
Point = tuple[Coordinate, Coordinate, Coordinate]
Strength = Annotated[float, within(1e-6, 1e9)]
Count = Annotated[int, within(1, MOST_LAMPS)]
Spacing = Annotated[float, within(0, 1_000_000), MILLIMETRES]
_DOWN: Final = (0.0, 0.0, -1.0)
_FORWARDS: Final = (0.0, 0.0, 1.0)


@dataclass(frozen=True, kw_only=True)
class LampTable(Table):
    """A lamp, or a grid of equal ones.

    Attributes:
        lamp: shipped name, or the path of a TOML, `.ies` or `.ldt` file.
        fixed: in the axes of the scene, or in those of the main camera, with which it moves.
        position_m: of its centre, or that of the grid. Axes of the scene: along the row, into the crop, up;
            of the camera: right, down, forwards.
        aim_m: point that the beam's axis goes through; default: straight down, or forwards from a camera.
        turn_rad: of the lamp about the beam's axis.
        flux_lm: luminous flux, instead of the file's strength.
        ppf_umol_s: flux of photons of 400 to 700 nm, instead of the file's strength.
        illuminance_lx: straight ahead at `at_m`, instead of the file's strength.
        at_m: distance at which `illuminance_lx` is measured.
        count: columns and rows of a grid of equal lamps, along the first two axes.
        spacing_m: of the grid.
    """

    lamp: Name
    fixed: Literal["world", "camera"] = "world"
    position_m: Point
    aim_m: Point | None = None
    turn_rad: Angle = 0.0
    flux_lm: Strength | None = None
    ppf_umol_s: Strength | None = None
    illuminance_lx: Strength | None = None
    at_m: Annotated[float, within(1, 100_000), MILLIMETRES] | None = None
    count: tuple[Count, Count] = (1, 1)
    spacing_m: tuple[Spacing, Spacing] | None = None

    def __post_init__(self) -> None:
        strengths = (self.flux_lm, self.ppf_umol_s, self.illuminance_lx)
        if sum(strength is not None for strength in strengths) > 1:
            raise ValueError("must have at most one of flux_lm, ppf_umol_s and illuminance_lx")
        if (self.illuminance_lx is None) != (self.at_m is None):
            raise ValueError("must have illuminance_lx and at_mm together")
        if max(self.count) > 1 and self.spacing_m is None:
            raise ValueError("must have spacing_mm for a grid of lamps")
        if self.aim_m == self.position_m:
            raise ValueError("must have an aim_mm that is not position_mm")

    @property
    def lamps(self) -> int:
        """Number of lamps."""
        return self.count[0] * self.count[1]

    def placed(self, lamp: Lamp) -> list[Lamp]:
        """The lamps, in the axes that they are fixed in.

        Raises:
            ValueError: the lamp has no such light.
        """
        import numpy as np

        from pepperscene.camera.lamps.lamp import aimed_axes

        strengths = {key: getattr(self, key) for key in ("flux_lm", "ppf_umol_s", "illuminance_lx")}
        if any(strength is not None for strength in strengths.values()):
            lamp = lamp.with_strength(**strengths, at_m=self.at_m or 1.0)
        axis = np.array(_DOWN if self.fixed == "world" else _FORWARDS)
        if self.aim_m is not None:
            axis = np.subtract(self.aim_m, self.position_m)
        axes = aimed_axes(axis, self.turn_rad)
        across, along = (
            (np.arange(count) - 0.5 * (count - 1)) * step
            for count, step in zip(self.count, self.spacing_m or (0.0, 0.0), strict=True)
        )
        return [
            lamp.moved(axes, np.add(self.position_m, (x, y, 0.0)))
            for y in along.tolist()
            for x in across.tolist()
        ]
