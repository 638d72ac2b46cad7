"""The tables `[[rig]]` and `[twins]` of a recipe: the same moment by other cameras, or with other values."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Annotated, Any, Final

import numpy as np
from numpy.typing import NDArray
from pydantic import AfterValidator, Field, model_validator

from pepperscene.document import Document
from pepperscene.units import MILLIMETRES, TABLE_CONFIG, Angle, within

FIRST_CAMERA: Final = "main"
"""Name of the camera of the table `[camera]` on a rig."""

MOST_CAMERAS: Final = 64  # chosen: more than a robot carries
_MOST_TWINS: Final = 1000  # chosen: as the largest number of sets
Offset = Annotated[float, within(-10_000, 10_000), MILLIMETRES]
_PLACE: Final = ("name", "position_mm", "rotation_deg")


def _check_name(name: str) -> str:
    if re.fullmatch(r"[A-Za-z0-9_-]{1,40}", name) is None:
        raise ValueError("must be 1 to 40 letters, digits, _ or -")
    return name


class RigCamera(Document):
    """A further camera that moves with the one of the table `[camera]`.

    Attributes:
        name: of the camera.
        position_m: of its projection centre in the axes of the main camera: right, down, forward.
        rotation_rad: of its axes from those of the main camera: to the right about the down axis, then
            upwards about the right axis, then clockwise about the optical axis.
        camera: values of `[camera]` that differ.
    """

    model_config = TABLE_CONFIG

    name: Annotated[str, Field(strict=True), AfterValidator(_check_name)]
    position_m: tuple[Offset, Offset, Offset] = (0.0, 0.0, 0.0)
    rotation_rad: tuple[Angle, Angle, Angle] = (0.0, 0.0, 0.0)
    camera: dict[str, Any] = Field(default_factory=dict)

    @model_validator(mode="before")
    @classmethod
    def _collect_camera(cls, raw: Any) -> Any:
        """Separate the keys of the camera's place from the values of its table."""
        if not isinstance(raw, Mapping) or "camera" in raw:
            return raw
        camera = {key: value for key, value in raw.items() if key not in _PLACE}
        return {**{key: raw[key] for key in _PLACE if key in raw}, "camera": camera}

    @property
    def extrinsics(self) -> NDArray[np.float64]:
        """`(4, 4)` from this camera's axes to those of the main camera, metres."""
        return extrinsics(self.position_m, self.rotation_rad)


def extrinsics(
    position_m: tuple[float, float, float], rotation_rad: tuple[float, float, float]
) -> NDArray[np.float64]:
    """`(4, 4)` from a camera's axes to those of another, metres; arguments as of `RigCamera`."""
    from scipy.spatial.transform import Rotation

    right, up, clockwise = rotation_rad
    # About y (down), a positive angle turns the optical axis to the right; about x, it turns it up.
    rotation = Rotation.from_euler("YXZ", [right, up, clockwise])
    matrix = np.eye(4)
    matrix[:3, :3] = rotation.as_matrix()
    matrix[:3, 3] = position_m
    return matrix


def _check_twins(twins: dict[str, tuple[Any, ...]]) -> dict[str, tuple[Any, ...]]:
    for key, values in twins.items():
        if not 2 <= len(values) <= _MOST_TWINS:
            raise ValueError(f"must have 2 to {_MOST_TWINS} values for each key, but {key} has {len(values)}")
    lengths = {len(values) for values in twins.values()}
    if len(lengths) > 1:
        counts = ", ".join(f"{key} has {len(values)}" for key, values in twins.items())
        raise ValueError(f"must have the same number of values for each key: {counts}")
    return twins


Twins = Annotated[
    dict[str, tuple[Any, ...]],
    AfterValidator(_check_twins),
]
"""Values by dotted key; twin k of a frame has value k of each."""
