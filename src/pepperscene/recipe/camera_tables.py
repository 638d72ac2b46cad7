"""The tables of a recipe file for its cameras, the rig, twins and automatic exposure."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated, Any, Final, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import AfterValidator, Field, model_validator

from pepperscene.camera import ExposureControl, Metering, StereoMatching
from pepperscene.document import Document
from pepperscene.units import (
    MICROSECONDS,
    MILLIMETRES,
    NONE,
    TABLE_CONFIG,
    Angle,
    Name,
    Switch,
    Table,
    file_values,
    single_message,
    within,
)

FIRST_CAMERA: Final = "main"
"""Name of the camera of the table `[camera]` on a rig."""

MAX_CAMERAS: Final = 64  # chosen: more than a robot carries
_MAX_TWINS: Final = 1000  # chosen: as the largest number of sets
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
    """`(4, 4)` from a camera's axes to those of another, metres; arguments as in `RigCamera`."""
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
        if not 2 <= len(values) <= _MAX_TWINS:
            raise ValueError(f"must have 2 to {_MAX_TWINS} values for each key, but {key} has {len(values)}")
    lengths = {len(values) for values in twins.values()}
    if len(lengths) > 1:
        counts = ", ".join(f"{key} has {len(values)}" for key, values in twins.items())
        raise ValueError(f"must have the same number of values for each key: {counts}")
    return twins


Twins = Annotated[dict[str, tuple[Any, ...]], AfterValidator(_check_twins)]
"""Values by dotted key; twin k of a frame has value k of each."""


AUTO: Final = "auto"
"""Instead of an exposure time: it is chosen for each frame."""

Exposure = Annotated[float, within(1, 1_000_000), MICROSECONDS]
ExposureTime = Annotated[Exposure | Literal["auto"], single_message('must be 1 to 1,000,000, or "auto"')]

Baseline = Annotated[float, within(0.1, 10_000), MILLIMETRES]
"""Chosen: the smallest stereo endoscopes have 1 mm; closer cameras have the same image to within a pixel."""

GENERIC_SENSOR: Final = "generic_rgb"
"""The shipped sensor that has the size of any image."""

INTRINSICS: Final = ("fx", "fy", "cx", "cy")
LENS_KEYS: Final = (
    ("lens",),
    ("hfov_deg",),
    (*INTRINSICS, "distortion_model", "distortion"),
    ("calibration",),
)
"""Keys of each of the ways to describe the lens, of which a camera has one."""

SIZE_KEYS: Final = ("width", "height")

Pixels = Annotated[int, within(1, 20_000)]  # chosen: the limit of sensor files
FocalLength = Annotated[float, within(1, 1e6)]
PrincipalPoint = Annotated[float, within(-100_000, 100_000)]
Coefficients = tuple[Annotated[float, within(-1e5, 1e5)], ...]


@dataclass(frozen=True, kw_only=True)
class AutoExposureTable(Table):
    """What an exposure of "auto" aims at, and the settings that it may use.

    Attributes:
        target_grey: mean of the photograph's 8-bit codes over pixels and colours.
        exposure_s: shortest and longest exposure time.
        most_gain: highest gain. The lowest is `camera.gain`.
        metering: weights of the pixels: equal; more in the middle of the image; or only those of plants, with
            at most 0.3 % of them saturated; `highlights` has no target, but is as bright as that allows.
        lock: whether only the first view is metered, and all others of its camera, plants and twin have its
            exposure.
    """

    target_grey: Annotated[float, within(1, 250)] = 110.0
    # The limits are chosen, as in `ExposureControl`.
    exposure_s: tuple[Exposure, Exposure] = (10e-6, 10e-3)
    most_gain: Annotated[float, within(1, 1000)] = 4.0
    metering: Metering = "average"
    lock: Switch = False

    def __post_init__(self) -> None:
        if self.exposure_s[0] > self.exposure_s[1]:
            limits_us = list(file_values(self)["exposure_us"])
            raise ValueError(f"exposure_us = {limits_us} must be [shortest, longest]")

    def control(self) -> ExposureControl:
        """The same for a camera."""
        return ExposureControl(self.target_grey, *self.exposure_s, self.most_gain, self.metering)


@dataclass(frozen=True, kw_only=True)
class CameraTable(Table):
    """The camera's parts by shipped name or path, or in numbers, and their settings.

    Flash and filter may be "none". The lens is a file, or a horizontal field of view, intrinsics in pixels,
    or a calibration file, each of an ideal thin lens. `width` and `height` are the size of the image; without
    them the sensor decides. Intrinsics are in OpenCV's convention: the centre of the upper left pixel is at
    (0, 0).

    Without `focus_m` everything is sharp; without `bits` the sensor file decides. `f_number` and
    `transmittance` replace those of a lens file. `baseline_m` is the distance to a second camera of the same
    kind on the right; without it there is no stereo partner. With a rolling shutter, labels show each row at
    its own time, unless `labels_per_row` is false.
    """

    sensor: Name = GENERIC_SENSOR
    lens: Name = NONE
    flash: Name
    filter: Name = NONE
    exposure_s: ExposureTime
    focus_m: Annotated[float, within(1, 1_000_000), MILLIMETRES] | None = None
    gain: Annotated[float, within(0.01, 1000)] = 1.0
    bits: Annotated[int, within(1, 16)] | None = None
    baseline_m: Baseline | None = None
    width: Pixels | None = None
    height: Pixels | None = None
    # No corner may be more than 85 degrees off the axis.
    hfov_deg: Annotated[float, within(0.1, 170.0)] | None = None
    fx: FocalLength | None = None
    fy: FocalLength | None = None
    cx: PrincipalPoint | None = None
    cy: PrincipalPoint | None = None
    distortion_model: Literal["plumb_bob", "rational_polynomial", "equidistant"] | None = None
    distortion: Coefficients | None = None
    calibration: Name | None = None
    f_number: Annotated[float, within(0.5, 1000)] | None = None
    transmittance: Annotated[float, within(1e-6, 1)] | None = None
    labels_per_row: Switch | None = None

    def __post_init__(self) -> None:
        self._check_lens()
        self._check_size()

    @property
    def lens_key(self) -> str:
        """The first key of the way in which the lens is described: lens, hfov_deg, fx or calibration."""
        return next(keys[0] for keys in LENS_KEYS if self._given(keys))

    def _given(self, keys: tuple[str, ...]) -> list[str]:
        """Those of the keys that have a value."""
        return [key for key in keys if getattr(self, key) not in (None, NONE)]

    def _check_lens(self) -> None:
        given = [keys[0] for keys in map(self._given, LENS_KEYS) if keys]
        if len(given) > 1:
            raise ValueError(
                f"{given[0]} and {given[1]} contradict each other; only one of them may be given"
            )
        if not given:
            raise ValueError("lens, hfov_deg, fx with fy, cx and cy, or calibration is required but missing")
        missing = sorted(set(INTRINSICS) - set(self._given(INTRINSICS)))
        if self._given(LENS_KEYS[2]) and missing:
            verb = "is" if len(missing) == 1 else "are"
            raise ValueError(f"fx, fy, cx and cy must be given together; {', '.join(missing)} {verb} missing")

    def _check_size(self) -> None:
        given = self._given(SIZE_KEYS)
        if len(given) == 1:
            raise ValueError(f"width and height must be given together, not {given[0]} alone")
        if not given and self.sensor == GENERIC_SENSOR and self.calibration is None:
            raise ValueError("width and height are required without a sensor")


_MATCHING: Final = StereoMatching()


@dataclass(frozen=True, kw_only=True)
class DepthCameraTable(CameraTable):
    """A stereo depth camera that moves with the one of `[camera]`, whose pixels its depth is given in.

    The keys of `[camera]` describe its two equal imagers, except `flash`, which it has not.

    Attributes:
        baseline_m: distance to the right imager.
        projector: shipped name or path, or "none" for passive stereo.
        position_m: of the left imager in the axes of the main camera: right, down, forward.
        rotation_rad: as of a camera of a rig.
        depth_unit_m: of a step of depth images of 16 bits in exports.
        auto_exposure: for an exposure of "auto". The limits are chosen: one frame of 30 in a second, and the
            gain of a D435, 16 to 248 in its software.
        matching: settings of the matcher.
    """

    flash: Literal["none"] = NONE
    exposure_s: ExposureTime = AUTO
    baseline_m: Baseline = field()  # required, unlike that of a camera
    projector: Name = NONE
    position_m: tuple[Offset, Offset, Offset] = (0.0, 0.0, 0.0)
    rotation_rad: tuple[Angle, Angle, Angle] = (0.0, 0.0, 0.0)
    # Chosen: 65,535 steps of the smallest are 65 mm; the default is that of all RealSense but the D405.
    depth_unit_m: Annotated[float, within(0.001, 10), MILLIMETRES] = 0.001
    auto_exposure: AutoExposureTable = AutoExposureTable(exposure_s=(10e-6, 33e-3), most_gain=15.5)
    matching: StereoMatching = _MATCHING

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.auto_exposure.lock:
            raise ValueError("auto_exposure.lock must be false: depth cameras meter each frame")

    @property
    def extrinsics(self) -> NDArray[np.float64]:
        """`(4, 4)` from the left imager's axes to those of the main camera, metres."""
        return extrinsics(self.position_m, self.rotation_rad)
