"""The table `[views]` of a recipe file: where the camera is, one model for each kind of views."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from typing import Annotated, Final, Literal

from pydantic import Field, model_validator

from pepperscene.document import Document
from pepperscene.recipe.tables import Angle, Fraction, Height, Name, Switch, single_message

Distance = Annotated[float, Field(strict=True, ge=50, le=10_000)]
Pitch = Annotated[float, Field(strict=True, ge=-89, le=89)]
Coordinate = Annotated[float, Field(strict=True, ge=-100_000, le=100_000)]
Speed = Annotated[float, Field(strict=True, ge=0.001, le=100_000)]
Point = tuple[Coordinate, Coordinate, Coordinate]
Limits = tuple[Coordinate, Coordinate]
_Distances = Annotated[tuple[Distance, ...], Field(min_length=1, max_length=1000)]
_Angles = Annotated[tuple[Angle, ...], Field(min_length=1, max_length=1000)]

_TARGET: Final = single_message("must be a name, or a point [x, y, z] in millimetres")

DEFAULT_SUBJECT_MM: Final = 400.0
"""Distance of the subject for views without one. Chosen: that of Barth et al. 2018."""


class Views(Document, ABC):
    """Where the camera is in each frame of a scene."""

    @property
    def count(self) -> int | None:
        """Number of views in a scene, or None if `plan.frames` decides."""
        return None

    @property
    @abstractmethod
    def subject_mm(self) -> float:
        """The nearest distance from the camera to its subject."""

    @property
    def pitch_of_view_deg(self) -> float:
        """A typical elevation of the optical axis."""
        return 0.0


class ArcViews(Views):
    """An arc around the middle plant; azimuth and height run from the first to the second value.

    With `speed_mm_s` the camera moves while it takes the photographs.
    """

    kind: Literal["arc"]
    distance_mm: Distance
    azimuth_deg: tuple[Angle, Angle]
    height_mm: tuple[Height, Height]
    pitch_deg: Pitch
    speed_mm_s: Speed | None = None

    @property
    def subject_mm(self) -> float:
        """The nearest distance from the camera to its subject."""
        return self.distance_mm

    @property
    def pitch_of_view_deg(self) -> float:
        """A typical elevation of the optical axis."""
        return self.pitch_deg


class ProtocolViews(Views):
    """The protocol of a robot: every azimuth at every distance from the middle plant, at one height."""

    kind: Literal["protocol"]
    distance_mm: _Distances
    azimuth_deg: _Angles
    height_mm: Height
    pitch_deg: Pitch

    @property
    def count(self) -> int:
        """Number of views in a scene."""
        return len(self.distance_mm) * len(self.azimuth_deg)

    @property
    def subject_mm(self) -> float:
        """The nearest distance from the camera to its subject."""
        return min(self.distance_mm)

    @property
    def pitch_of_view_deg(self) -> float:
        """A typical elevation of the optical axis."""
        return self.pitch_deg


class GridViews(Views):
    """All combinations of positions along the row, distances, heights and angles; the last varies fastest."""

    kind: Literal["grid"]
    x_mm: Annotated[tuple[Coordinate, ...], Field(min_length=1, max_length=1000)] = (0.0,)
    distance_mm: _Distances
    height_mm: Annotated[tuple[Height, ...], Field(min_length=1, max_length=1000)]
    azimuth_deg: _Angles = (0.0,)
    pitch_deg: Annotated[tuple[Pitch, ...], Field(min_length=1, max_length=1000)] = (0.0,)

    @property
    def count(self) -> int:
        """Number of views in a scene."""
        axes = (self.x_mm, self.distance_mm, self.height_mm, self.azimuth_deg, self.pitch_deg)
        return math.prod(len(axis) for axis in axes)

    @property
    def subject_mm(self) -> float:
        """The nearest distance from the camera to its subject."""
        return min(self.distance_mm)

    @property
    def pitch_of_view_deg(self) -> float:
        """A typical elevation of the optical axis."""
        return self.pitch_deg[0]


class PoseViews(Views):
    """Poses from a file. `motion`: timed poses blur the photographs along their path."""

    kind: Literal["poses"]
    file: Name
    motion: Switch = True

    @property
    def subject_mm(self) -> float:
        """The nearest distance from the camera to its subject."""
        return DEFAULT_SUBJECT_MM


class PathViews(Views):
    """A smooth path through points at a constant speed; `motion` blurs the photographs along it.

    The camera looks at a point, `look_at_mm`, or in a direction, `azimuth_deg` (0 faces the row from its
    aisle, positive turns to the left) and `pitch_deg`. With `frame_rate_hz`, frames follow each other in
    time; without it, they are spread evenly over the path.
    """

    kind: Literal["path"]
    points_mm: Annotated[tuple[Point, ...], Field(min_length=2, max_length=1000)]
    speed_mm_s: Speed
    frame_rate_hz: Annotated[float, Field(strict=True, ge=0.001, le=10_000)] | None = None
    look_at_mm: Point | None = None
    azimuth_deg: Angle = 0.0
    pitch_deg: Pitch = 0.0
    motion: Switch = True

    @model_validator(mode="after")
    def _check(self) -> PathViews:
        if any(a == b for a, b in zip(self.points_mm, self.points_mm[1:], strict=False)):
            raise ValueError("points_mm must not repeat a point in succession")
        if self.look_at_mm is not None and (self.azimuth_deg, self.pitch_deg) != (0.0, 0.0):
            raise ValueError("must hold either look_at_mm, or azimuth_deg and pitch_deg")
        return self

    @property
    def subject_mm(self) -> float:
        """The nearest distance from the camera to its subject."""
        return DEFAULT_SUBJECT_MM

    @property
    def pitch_of_view_deg(self) -> float:
        """A typical elevation of the optical axis."""
        return self.pitch_deg


class RandomViews(Views):
    """Random views of organs or of a point, within limits.

    Attributes:
        target: "fruit", "ripe fruit", "unripe fruit", the kind or the class of an organ, or a point.
        distance_mm: of the lens from the target.
        elevation_deg: of the camera, seen from the target.
        azimuth_deg: of the camera around the target; 0 is in front of the row.
        roll_deg: of the camera about its optical axis.
        offset: of the target from the image's centre, as a fraction of the half field of view.
        volume_mm: limits of the camera's x, y and z.
        clearance_mm: radius of the sphere around the lens that must be empty.
        least_visibility: fraction of the target's surface towards the camera that must be in view.
    """

    kind: Literal["random"]
    target: Annotated[Name | Point, _TARGET]
    distance_mm: tuple[Distance, Distance]
    elevation_deg: tuple[Pitch, Pitch] = (-20.0, 20.0)
    azimuth_deg: tuple[Angle, Angle] = (-60.0, 60.0)
    roll_deg: tuple[Angle, Angle] = (0.0, 0.0)
    offset: tuple[Fraction, Fraction] = (0.0, 0.0)
    volume_mm: tuple[Limits, Limits, Limits] | None = None
    clearance_mm: Annotated[float, Field(strict=True, ge=0, le=5000)] = 50.0
    least_visibility: Fraction = 0.0

    @model_validator(mode="after")
    def _check(self) -> RandomViews:
        pairs = {name: getattr(self, name) for name in (
            "distance_mm", "elevation_deg", "azimuth_deg", "roll_deg", "offset"
        )}  # fmt: skip
        pairs |= {f"volume_mm.{axis}": limits for axis, limits in enumerate(self.volume_mm or ())}
        for name, (low, high) in pairs.items():
            if low > high:
                raise ValueError(f"{name} = [{low:g}, {high:g}] must be [minimum, maximum]")
        return self

    @property
    def subject_mm(self) -> float:
        """The nearest distance from the camera to its subject."""
        return self.distance_mm[0]


class FunctionViews(Views):
    """Poses from the user's Python function `poses(scene, rng)`, in a file of its own."""

    kind: Literal["function"]
    file: Name
    function: Name = "poses"

    @property
    def subject_mm(self) -> float:
        """The nearest distance from the camera to its subject."""
        return DEFAULT_SUBJECT_MM


ViewsTable = Annotated[
    ArcViews | ProtocolViews | GridViews | PoseViews | PathViews | RandomViews | FunctionViews,
    Field(discriminator="kind"),
]
