"""The table `[depth_camera]` of a recipe file."""

from __future__ import annotations

from typing import Annotated, Final, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from pepperscene.document import Document
from pepperscene.recipe.camera_tables import LEAST_BASELINE_MM, CameraTable, ExposureTime
from pepperscene.recipe.exposure import AUTO, AutoExposureTable
from pepperscene.recipe.rig import Offset, extrinsics
from pepperscene.recipe.tables import NONE, Angle, Name

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
