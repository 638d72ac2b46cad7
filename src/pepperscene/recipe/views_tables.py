"""The table `[views]` of a recipe file: where the camera is, one model for each kind of views."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, Final, Literal

from pydantic import Field

from pepperscene.units import (
    DEGREES,
    MILLIMETRES,
    Angle,
    Fraction,
    Name,
    Switch,
    Table,
    file_values,
    single_message,
    within,
)

Distance = Annotated[float, within(50, 10_000), MILLIMETRES]
Height = Annotated[float, within(0, 10_000), MILLIMETRES]
Pitch = Annotated[float, within(-89, 89), DEGREES]
Coordinate = Annotated[float, within(-100_000, 100_000), MILLIMETRES]
Speed = Annotated[float, within(0.001, 100_000), MILLIMETRES]
Point = tuple[Coordinate, Coordinate, Coordinate]
Limits = tuple[Coordinate, Coordinate]
_Distances = Annotated[tuple[Distance, ...], Field(min_length=1, max_length=1000)]
_Angles = Annotated[tuple[Angle, ...], Field(min_length=1, max_length=1000)]

_TARGET: Final = single_message("must be a name, or a point [x, y, z] in millimetres")

_SUBJECT_M: Final = 0.4
"""Distance of the subject for views without one. Chosen: that of Barth et al. 2018."""


@dataclass(frozen=True, kw_only=True)
class Views(Table):
    """Where the camera is in each frame of a scene."""

    kind: str

    @property
    def count(self) -> int | None:
        """Number of views in a scene, or None if `plan.frames` decides."""
        return None

    @property
    def subject_m(self) -> float:
        """The nearest distance from the camera to its subject."""
        distances: float | tuple[float, ...] = getattr(self, "distance_m", _SUBJECT_M)
        return min(distances) if isinstance(distances, tuple) else distances

    @property
    def typical_pitch_rad(self) -> float:
        """A typical elevation of the optical axis."""
        pitches: float | tuple[float, ...] = getattr(self, "pitch_rad", 0.0)
        return pitches[0] if isinstance(pitches, tuple) else pitches


@dataclass(frozen=True, kw_only=True)
class ArcViews(Views):
    """An arc around the middle plant; azimuth and height run from the first to the second value.

    Attributes:
        distance_m: from the plant's axis.
        azimuth_rad: at the first and the last frame; 0 is in the aisle, positive towards +x.
        height_m: of the projection centre, at the first and the last frame.
        pitch_rad: of the optical axis, positive upwards.
        speed_m_s: the camera moves along the arc at this speed while it exposes; default: it does not move.
    """

    kind: Literal["arc"]
    distance_m: Distance
    azimuth_rad: tuple[Angle, Angle]
    height_m: tuple[Height, Height]
    pitch_rad: Pitch
    speed_m_s: Speed | None = None


@dataclass(frozen=True, kw_only=True)
class ProtocolViews(Views):
    """The protocol of a robot: every azimuth at every distance from the middle plant, at one height.

    Attributes:
        distance_m: from the plant's axis.
        azimuth_rad: as for `arc`.
        height_m: of the projection centre.
        pitch_rad: of the optical axis.
    """

    kind: Literal["protocol"]
    distance_m: _Distances
    azimuth_rad: _Angles
    height_m: Height
    pitch_rad: Pitch

    @property
    def count(self) -> int:
        """Number of views in a scene."""
        return len(self.distance_m) * len(self.azimuth_rad)


@dataclass(frozen=True, kw_only=True)
class GridViews(Views):
    """All combinations of positions along the row, distances, heights and angles; the last varies fastest.

    Attributes:
        x_m: places along the row.
        distance_m: from the row at that place.
        height_m: of the projection centre.
        azimuth_rad: around that place, as for `arc`.
        pitch_rad: of the optical axis.
    """

    kind: Literal["grid"]
    x_m: Annotated[tuple[Coordinate, ...], Field(min_length=1, max_length=1000)] = (0.0,)
    distance_m: _Distances
    height_m: Annotated[tuple[Height, ...], Field(min_length=1, max_length=1000)]
    azimuth_rad: _Angles = (0.0,)
    pitch_rad: Annotated[tuple[Pitch, ...], Field(min_length=1, max_length=1000)] = (0.0,)

    @property
    def count(self) -> int:
        """Number of views in a scene."""
        axes = (self.x_m, self.distance_m, self.height_m, self.azimuth_rad, self.pitch_rad)
        return math.prod(len(axis) for axis in axes)


@dataclass(frozen=True, kw_only=True)
class PoseViews(Views):
    """Poses from a file.

    Attributes:
        file: path of a file of camera poses, relative to the recipe: TUM, CSV, nerfstudio or COLMAP. Its
            world must have the recipe's axes and metres.
        motion: if poses have times, the camera moves along them while it exposes.
    """

    kind: Literal["poses"]
    file: Name
    motion: Switch = True


@dataclass(frozen=True, kw_only=True)
class PathViews(Views):
    """A smooth path through points at a constant speed; `motion` blurs the photographs along it.

    Attributes:
        points_m: x, y and z in the world; two in succession must differ.
        speed_m_s: along the curve.
        frame_rate_hz: frames follow each other in time. Default: `plan.frames` views, spread evenly over the
            curve.
        look_at_m: the camera looks at this point; excludes the next two keys.
        azimuth_rad: direction of view: 0 faces the row from its aisle, positive turns to the left.
        pitch_rad: of the optical axis.
        motion: the camera moves while it exposes.
    """

    kind: Literal["path"]
    points_m: Annotated[tuple[Point, ...], Field(min_length=2, max_length=1000)]
    speed_m_s: Speed
    frame_rate_hz: Annotated[float, within(0.001, 10_000)] | None = None
    look_at_m: Point | None = None
    azimuth_rad: Angle = 0.0
    pitch_rad: Pitch = 0.0
    motion: Switch = True

    def __post_init__(self) -> None:
        if any(a == b for a, b in zip(self.points_m, self.points_m[1:], strict=False)):
            raise ValueError("points_mm must not repeat a point in succession")
        if self.look_at_m is not None and (self.azimuth_rad, self.pitch_rad) != (0.0, 0.0):
            raise ValueError("must hold either look_at_mm, or azimuth_deg and pitch_deg")


@dataclass(frozen=True, kw_only=True)
class RandomViews(Views):
    """Random views of organs or of a point, within limits.

    Directions are uniform in solid angle, distances and rolls are uniform, and so are places over the area of
    the image.

    Attributes:
        target: `fruit`, `ripe fruit`, `unripe fruit`, the kind of an organ (`lamina`, `peduncle`, …), a class
            in lower case (`leaf`), or a point in mm. The target of each frame is one of these organs of the
            scene, all with the same probability. A fruit is ripe if its mean ripeness is at least 0.5.
        distance_m: least and greatest distance of the projection centre from the target's centroid.
        elevation_rad: of the camera as seen from the target, positive above it.
        azimuth_rad: of the camera around the target: 0 is in front of the row, positive towards +x.
        roll_rad: about the optical axis, clockwise seen from behind the camera.
        offset: of the target from the middle of the image: 0 is the middle, 1 the ellipse that touches the
            borders.
        volume_m: limits of the camera's x, y and z.
        clearance_m: no surface is nearer to the projection centre; at least the radius of the lens's pupil.
        least_visibility: least fraction that is in the image and not hidden, of what the camera would see of
            the target alone.
    """

    kind: Literal["random"]
    target: Annotated[Name | Point, _TARGET]
    distance_m: tuple[Distance, Distance]
    elevation_rad: tuple[Pitch, Pitch] = (math.radians(-20.0), math.radians(20.0))
    azimuth_rad: tuple[Angle, Angle] = (math.radians(-60.0), math.radians(60.0))
    roll_rad: tuple[Angle, Angle] = (0.0, 0.0)
    offset: tuple[Fraction, Fraction] = (0.0, 0.0)
    volume_m: tuple[Limits, Limits, Limits] | None = None
    clearance_m: Annotated[float, within(0, 5000), MILLIMETRES] = 0.05
    least_visibility: Fraction = 0.0

    def __post_init__(self) -> None:
        in_file = file_values(self)
        names = ("distance_mm", "elevation_deg", "azimuth_deg", "roll_deg", "offset")
        pairs = {name: in_file[name] for name in names}
        pairs |= {f"volume_mm.{axis}": limits for axis, limits in enumerate(in_file["volume_mm"] or ())}
        for name, (low, high) in pairs.items():
            if low > high:
                raise ValueError(f"{name} = [{low:g}, {high:g}] must be [minimum, maximum]")


@dataclass(frozen=True, kw_only=True)
class FunctionViews(Views):
    """Poses from the user's Python function `poses(scene, rng)`, in a file of its own.

    Attributes:
        file: path of a Python file, relative to the recipe.
        function: name of the function in it.
    """

    kind: Literal["function"]
    file: Name
    function: Name = "poses"


ViewsTable = Annotated[
    ArcViews | ProtocolViews | GridViews | PoseViews | PathViews | RandomViews | FunctionViews,
    Field(discriminator="kind"),
]
