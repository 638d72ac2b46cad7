"""The tables of a recipe file for its cameras, automatic exposure and developing."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Final, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from pepperscene.document import Document
from pepperscene.recipe.rig import Offset, extrinsics
from pepperscene.recipe.tables import NONE, Angle, Name, Switch, single_message

if TYPE_CHECKING:
    from pepperscene.camera.image.auto_exposure import ExposureControl

Exposure = Annotated[float, Field(strict=True, ge=1, le=1_000_000)]


AUTO: Final = "auto"
"""Instead of an exposure time: it is chosen for each frame."""


class AutoExposureTable(Document):
    """What an exposure of "auto" aims at, and the settings that it may use.

    Attributes:
        target_grey: mean 8-bit code of the developed photograph.
        exposure_us: shortest and longest exposure time. The default is chosen, as in `ExposureControl`.
        most_gain: highest gain of the amplifier, which is raised where the longest exposure is too dark.
        metering: "average" of the whole image, or "centre" with more weight in its middle.
    """

    target_grey: Annotated[float, Field(strict=True, ge=1, le=250)] = 110.0
    exposure_us: tuple[Exposure, Exposure] = (10.0, 10_000.0)
    most_gain: Annotated[float, Field(strict=True, ge=1, le=1000)] = 4.0
    metering: Literal["average", "centre"] = "average"

    @model_validator(mode="after")
    def _check(self) -> AutoExposureTable:
        if self.exposure_us[0] > self.exposure_us[1]:
            raise ValueError(f"exposure_us = {list(self.exposure_us)} must be [shortest, longest]")
        return self

    def control(self) -> ExposureControl:
        """The control in SI units."""
        from pepperscene.camera.image.auto_exposure import ExposureControl

        shortest_us, longest_us = self.exposure_us
        return ExposureControl(
            self.target_grey, shortest_us / 1e6, longest_us / 1e6, self.most_gain, self.metering
        )


Gain = Annotated[float, Field(strict=True, ge=0.01, le=100)]
Entry = Annotated[float, Field(strict=True, ge=-100, le=100)]
MatrixRow = tuple[Entry, Entry, Entry]

LEAST_BASELINE_MM: Final = 0.1
"""Chosen: the smallest stereo endoscopes have 1 mm; closer cameras have the same image to within a pixel."""


ExposureTime = Annotated[
    Exposure | Literal["auto"],
    single_message('must be 1 to 1,000,000, or "auto"'),
]


GENERIC_SENSOR: Final = "generic_rgb"
"""The shipped sensor that has the size of any image."""

_SIDE: Final = 20_000  # pixels; chosen: the limit of sensor files
_MOST_HFOV_DEG: Final = 170.0  # no corner may be more than 85 degrees off the axis

INTRINSICS: Final = ("fx", "fy", "cx", "cy")
LENS_KEYS: Final = (
    ("lens",),
    ("hfov_deg",),
    (*INTRINSICS, "distortion_model", "distortion"),
    ("calibration",),
)
"""Keys of each of the ways to describe the lens, of which a camera has one."""

SIZE_KEYS: Final = ("width", "height")
LATER_KEYS: Final = (
    "baseline_mm", *SIZE_KEYS, *(key for keys in LENS_KEYS[1:] for key in keys), "f_number", "transmittance",
    "labels_per_row",
)  # fmt: skip
"""Optional keys that older recipes do not have; the identity leaves out those without a value."""

Pixels = Annotated[int, Field(strict=True, ge=1, le=_SIDE)]
FocalLength = Annotated[float, Field(strict=True, ge=1, le=1e6)]
PrincipalPoint = Annotated[float, Field(strict=True, ge=-100_000, le=100_000)]
Coefficients = tuple[Annotated[float, Field(strict=True, ge=-1e5, le=1e5)], ...]


class CameraTable(Document):
    """The camera's parts by shipped name or path, or in numbers, and their settings.

    Flash and filter may be "none". The lens is a file, or a horizontal field of view, intrinsics in pixels,
    or a calibration file, each of an ideal thin lens. `width` and `height` are the size of the image; without
    them the sensor decides. Intrinsics are in OpenCV's convention: the centre of the upper left pixel is at
    (0, 0).

    Without `focus_mm` everything is sharp; without `bits` the sensor file decides. `f_number` and
    `transmittance` replace those of a lens file. `baseline_mm` is the distance to a second camera of the same
    kind on the right; without it there is no stereo partner. With a rolling shutter, labels show each row at
    its own time, unless `labels_per_row` is false.
    """

    sensor: Name = GENERIC_SENSOR
    lens: Name = NONE
    flash: Name
    filter: Name = NONE
    exposure_us: ExposureTime
    focus_mm: Annotated[float, Field(strict=True, ge=1, le=1_000_000)] | None = None
    gain: Annotated[float, Field(strict=True, ge=0.01, le=1000)] = 1.0
    bits: Annotated[int, Field(strict=True, ge=1, le=16)] | None = None
    baseline_mm: Annotated[float, Field(strict=True, ge=LEAST_BASELINE_MM, le=10_000)] | None = None
    width: Pixels | None = None
    height: Pixels | None = None
    hfov_deg: Annotated[float, Field(strict=True, ge=0.1, le=_MOST_HFOV_DEG)] | None = None
    fx: FocalLength | None = None
    fy: FocalLength | None = None
    cx: PrincipalPoint | None = None
    cy: PrincipalPoint | None = None
    distortion_model: Literal["plumb_bob", "rational_polynomial", "equidistant"] | None = None
    distortion: Coefficients | None = None
    calibration: Name | None = None
    f_number: Annotated[float, Field(strict=True, ge=0.5, le=1000)] | None = None
    transmittance: Annotated[float, Field(strict=True, ge=1e-6, le=1)] | None = None
    labels_per_row: Switch | None = None

    @property
    def lens_key(self) -> str:
        """The first key of the way in which the lens is described: lens, hfov_deg, fx or calibration."""
        return next(keys[0] for keys in LENS_KEYS if self._given(keys))

    def _given(self, keys: tuple[str, ...]) -> list[str]:
        """Those of the keys that have a value."""
        return [key for key in keys if getattr(self, key) not in (None, NONE)]

    @model_validator(mode="after")
    def _check_lens(self) -> CameraTable:
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
        return self

    @model_validator(mode="after")
    def _check_size(self) -> CameraTable:
        given = self._given(SIZE_KEYS)
        if len(given) == 1:
            raise ValueError(f"width and height must be given together, not {given[0]} alone")
        if not given and self.sensor == GENERIC_SENSOR and self.calibration is None:
            raise ValueError("width and height are required without a sensor")
        return self


Balance = Annotated[
    Literal["flash", "daylight", "none"] | tuple[Gain, Gain, Gain],
    single_message(
        'must be "flash", "daylight", "none", or the gains of red, green and blue, each 0.01 to 100'
    ),
]
ColourMatrix = Annotated[
    Switch | tuple[MatrixRow, MatrixRow, MatrixRow],
    single_message("must be true, false, or three rows of three numbers, each -100 to 100"),
]

Pedestal = Annotated[
    Annotated[float, Field(strict=True, ge=0, le=0.25)] | Literal["auto"],
    single_message('must be "auto", or 0 to 0.25'),
]

LATER_STEPS: Final[dict[str, object]] = {
    "white_balance_error": (1.0, 1.0, 1.0),
    "stray_light": False,
    "pedestal": 0.0,
}
"""Keys of `[developing]` that older recipes do not have, and the values that the identity leaves out."""


class DevelopingTable(Document):
    """The steps from light to image, as in `pepperscene.camera.Developing`; "none": no white balance."""

    falloff: Switch = True
    shot_noise: Switch = True
    read_noise: Switch = True
    saturation: Switch = True
    quantise: Switch = True
    demosaic: Literal["malvar", "menon", "bilinear"] = "malvar"
    white_balance: Balance = "flash"
    colour_matrix: ColourMatrix = True
    tone: Literal["srgb", "linear"] = "srgb"
    white_balance_error: tuple[Gain, Gain, Gain] = (1.0, 1.0, 1.0)
    stray_light: Switch = False
    pedestal: Pedestal = 0.0


_MOST_DISPARITIES: Final = 512  # chosen: half of the columns of usual images


class MatchingTable(Document):
    """Settings of the matcher, as in `pepperscene.camera.StereoMatching`."""

    disparities: Annotated[int, Field(strict=True, ge=16, le=_MOST_DISPARITIES, multiple_of=16)] = 128
    block_px: Annotated[int, Field(strict=True, ge=1, le=21)] = 7
    refined_px: Annotated[int, Field(strict=True, ge=0, le=51)] = 9
    uniqueness_percent: Annotated[int, Field(strict=True, ge=0, le=100)] = 10
    least_correlation: Annotated[float, Field(strict=True, ge=-1, le=1)] = 0.4
    left_right_px: Annotated[float, Field(strict=True, ge=0, le=100)] = 1.0
    speckle_px: Annotated[int, Field(strict=True, ge=0, le=100_000)] = 100
    farthest_mm: Annotated[float, Field(strict=True, ge=10, le=1_000_000)] = 10_000.0

    @model_validator(mode="after")
    def _check_sides(self) -> MatchingTable:
        for name, side in (("block_px", self.block_px), ("refined_px", self.refined_px)):
            if side and side % 2 == 0:
                raise ValueError(f"{name} = {side} must be odd")
        return self


class DepthCameraTable(CameraTable):
    """A stereo depth camera that moves with the one of `[camera]`, whose pixels its depth is given in.

    The keys of `[camera]` describe its two equal imagers, except `flash`, which it has not.

    Attributes:
        baseline_mm: distance to the right imager.
        projector: shipped name or path, or "none" for passive stereo.
        position_mm: of the left imager in the axes of the main camera: right, down, forward.
        rotation_deg: as of a camera of a rig.
        auto_exposure: for an exposure of "auto". The limits are chosen: one frame of 30 in a second, and the
            gain of a D435, 16 to 248 in its software.
        matching: settings of the matcher.
    """

    flash: Literal["none"] = NONE
    exposure_us: ExposureTime = AUTO
    baseline_mm: Annotated[float, Field(strict=True, ge=LEAST_BASELINE_MM, le=10_000)]
    projector: Name = NONE
    position_mm: tuple[Offset, Offset, Offset] = (0.0, 0.0, 0.0)
    rotation_deg: tuple[Angle, Angle, Angle] = (0.0, 0.0, 0.0)
    auto_exposure: AutoExposureTable = AutoExposureTable(exposure_us=(10.0, 33_000.0), most_gain=15.5)
    matching: MatchingTable = MatchingTable()

    @property
    def extrinsics(self) -> NDArray[np.float64]:
        """`(4, 4)` from the left imager's axes to those of the main camera, metres."""
        return extrinsics(self.position_mm, self.rotation_deg)
