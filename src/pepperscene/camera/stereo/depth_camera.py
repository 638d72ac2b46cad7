"""A stereo depth camera: two equal imagers side by side, with or without a projector, and their matching; and
the further devices that some outputs of a frame need.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass, field
from typing import Annotated, Any

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field

from pepperscene.camera.camera import Camera
from pepperscene.camera.image.auto_exposure import ExposureControl
from pepperscene.camera.lamps.lamp import lamps_seen_from
from pepperscene.camera.optics.projector import Projector
from pepperscene.camera.optics.white_reference import WhiteReference
from pepperscene.units import MILLIMETRES, Table, within


@dataclass(frozen=True)
class StereoMatching(Table):
    """Settings of semi-global matching (Hirschmueller 2008, IEEE TPAMI 30:328) in OpenCV.

    The penalties are those that OpenCV's documentation recommends: 8 and 32 times the pixels of a block.

    Attributes:
        disparities: disparities that are compared, in pixels; the nearest depth is `fx` × baseline over it.
        block_px: side of the block of pixels that is compared; odd.
        refined_px: side of the window in which disparities are refined to fractions of a pixel; odd, or 0 for
            none.
        uniqueness_percent: by how much the best cost must be below that of any other disparity.
        least_correlation: of the slopes of both images in that window; less is a hole.
        left_right_px: largest difference between the disparities of the left and of the right image; more is
            a hole.
        speckle_px: regions of fewer connected pixels are holes.
        farthest_m: farther points are holes.
    """

    # Chosen: at most half of the columns of usual images.
    disparities: Annotated[int, within(16, 512), Field(multiple_of=16)] = 128
    block_px: Annotated[int, within(1, 21)] = 7
    refined_px: Annotated[int, within(0, 51)] = 9
    uniqueness_percent: Annotated[int, within(0, 100)] = 10
    # Chosen: images of noise alone reach 0.38.
    least_correlation: Annotated[float, within(-1, 1)] = 0.4
    left_right_px: Annotated[float, within(0, 100)] = 1.0
    speckle_px: Annotated[int, within(0, 100_000)] = 100
    farthest_m: Annotated[float, within(10, 1_000_000), MILLIMETRES] = 10.0

    def __post_init__(self) -> None:
        if self.disparities < 16 or self.disparities % 16:
            raise ValueError(f"disparities must be a multiple of 16, not {self.disparities}")
        for name, side in (("block_px", self.block_px), ("refined_px", self.refined_px)):
            if side % 2 == 0 and (side or name == "block_px"):
                raise ValueError(f"{name} = {side} must be odd")


@dataclass(frozen=True, eq=False)
class DepthCamera:
    """A stereo depth camera at a pose.

    Its depth image is that of the left imager. Both imagers are exposed at the same time, and the projector
    shines during the exposure.

    Attributes:
        left: the left imager at its pose. It has no flash.
        baseline_m: distance to the right imager, along the rows of the image.
        projector: None for passive stereo.
        matching: settings of the matcher.
        exposure_control: for an automatic exposure; None for that of `left`.
        depth_unit_m: of a step of its depth images of 16 bits.
    """

    left: Camera
    baseline_m: float
    projector: Projector | None = None
    matching: StereoMatching = field(default_factory=StereoMatching)
    exposure_control: ExposureControl | None = None
    depth_unit_m: float = 1e-3

    def __post_init__(self) -> None:
        if not self.baseline_m > 0:
            raise ValueError(f"the baseline must be positive, not {self.baseline_m:g} m")
        if self.left.flash is not None:
            raise ValueError("the imagers of a depth camera have no flash")
        if not self.left.lens.distortion.is_zero:
            raise ValueError(
                "the imagers of a depth camera must have no distortion: images are matched by row"
            )

    @property
    def right(self) -> Camera:
        """The right imager."""
        return self.left_with_offset((self.baseline_m, 0.0, 0.0))

    def longest_exposed(self) -> tuple[Camera, Camera]:
        """Both imagers with the longest exposure that they can have."""
        control = self.exposure_control
        if control is None:
            return self.left, self.right
        left, right = (
            dataclasses.replace(camera, exposure_s=control.longest_s) for camera in (self.left, self.right)
        )
        return left, right

    @property
    def disparity_m(self) -> float:
        """Depth times disparity, metres times pixels: focal length in pixels times baseline."""
        return float(self.left.intrinsics[0, 0] * self.baseline_m)

    def left_with_offset(self, offset_m: ArrayLike) -> Camera:
        """The left imager at another place, given in its own axes: right, down, forward."""
        offset = self.left.pose[:3, :3] @ np.asarray(offset_m, dtype=float)
        pose = self.left.pose.copy()
        pose[:3, 3] += offset
        camera = self.left.at_pose(pose)
        if camera.lamps:
            shift = np.eye(4)
            shift[:3, 3] = offset_m
            camera = dataclasses.replace(camera, lamps=lamps_seen_from(camera.lamps, shift))
        if camera.motion is None:
            return camera
        return dataclasses.replace(camera, motion=camera.motion.at_offset(offset))

    def with_left(self, left: Camera) -> DepthCamera:
        """The same depth camera with another left imager."""
        return dataclasses.replace(self, left=left)

    def to_metadata(self) -> dict[str, Any]:
        """JSON-ready description: that of the left imager, with the baseline, projector and matching."""
        return {
            **self.left.to_metadata(),
            "baseline_m": float(self.baseline_m),
            "depth_unit_m": float(self.depth_unit_m),
            "projector": None if self.projector is None else self.projector.name,
            "matching": dataclasses.asdict(self.matching),
        }


@dataclass(frozen=True, eq=False)
class Partners:
    """Further devices of a frame, beside its camera.

    Attributes:
        flow: the camera of the next frame, the target of the output `flow`; None gives no flow.
        stereo: the partner of `stereo` and `colour_stereo`.
        depth: the depth camera of `depth_sensor` and the other `DEPTH_CAMERA_OUTPUTS`, at its pose.
        white_reference: of `reflectance`; by default a panel of 0.99 half a metre in front of the camera.
    """

    flow: Camera | None = None
    stereo: Camera | None = None
    depth: DepthCamera | None = None
    white_reference: WhiteReference = field(default_factory=WhiteReference)
