"""Further devices that some outputs of a frame need."""

from __future__ import annotations

from dataclasses import dataclass, field

from pepperscene.camera.camera import Camera
from pepperscene.camera.optics.white_reference import WhiteReference
from pepperscene.camera.stereo.depth_camera import DepthCamera


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
