"""Definitions of the ROS 2 messages that bags hold, as text, and messages as tables of their fields.

Sources: the interface packages of ROS 2, https://github.com/ros2/common_interfaces (std_msgs, sensor_msgs,
geometry_msgs), https://github.com/ros2/geometry2 (tf2_msgs), https://github.com/ros2/rcl_interfaces
(builtin_interfaces), and https://github.com/ros-perception/vision_msgs, release 4.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

Message = dict[str, Any]

_FIELDS: Final[Mapping[str, str]] = {
    "builtin_interfaces/Time": "int32 sec; uint32 nanosec",
    "std_msgs/Header": "builtin_interfaces/Time stamp; string frame_id",
    "geometry_msgs/Point": "float64 x; float64 y; float64 z",
    "geometry_msgs/Vector3": "float64 x; float64 y; float64 z",
    "geometry_msgs/Quaternion": "float64 x; float64 y; float64 z; float64 w",
    "geometry_msgs/Pose": "geometry_msgs/Point position; geometry_msgs/Quaternion orientation",
    "geometry_msgs/PoseWithCovariance": "geometry_msgs/Pose pose; float64[36] covariance",
    "geometry_msgs/Transform": "geometry_msgs/Vector3 translation; geometry_msgs/Quaternion rotation",
    "geometry_msgs/TransformStamped": (
        "std_msgs/Header header; string child_frame_id; geometry_msgs/Transform transform"
    ),
    "tf2_msgs/TFMessage": "geometry_msgs/TransformStamped[] transforms",
    "sensor_msgs/Image": (
        "std_msgs/Header header; uint32 height; uint32 width; string encoding; uint8 is_bigendian; "
        "uint32 step; uint8[] data"
    ),
    "sensor_msgs/RegionOfInterest": (
        "uint32 x_offset; uint32 y_offset; uint32 height; uint32 width; bool do_rectify"
    ),
    "sensor_msgs/CameraInfo": (
        "std_msgs/Header header; uint32 height; uint32 width; string distortion_model; float64[] d; "
        "float64[9] k; float64[9] r; float64[12] p; uint32 binning_x; uint32 binning_y; "
        "sensor_msgs/RegionOfInterest roi"
    ),
    "vision_msgs/ObjectHypothesis": "string class_id; float64 score",
    "vision_msgs/ObjectHypothesisWithPose": (
        "vision_msgs/ObjectHypothesis hypothesis; geometry_msgs/PoseWithCovariance pose"
    ),
    "vision_msgs/BoundingBox3D": "geometry_msgs/Pose center; geometry_msgs/Vector3 size",
    "vision_msgs/Detection3D": (
        "std_msgs/Header header; vision_msgs/ObjectHypothesisWithPose[] results; "
        "vision_msgs/BoundingBox3D bbox; string id"
    ),
    "vision_msgs/Detection3DArray": "std_msgs/Header header; vision_msgs/Detection3D[] detections",
}
"""Fields of each type, separated by semicolons."""


def definition(name: str) -> str:
    """The definition of a type, such as "sensor_msgs/msg/Image", with those that it contains, as in MCAP."""
    order = [name.replace("/msg/", "/")]
    for one in order:
        contained = re.findall(r"\w+/\w+", _FIELDS[one])
        order += [kind for kind in dict.fromkeys(contained) if kind not in order]
    texts = {one: _FIELDS[one].replace("; ", "\n") + "\n" for one in order}
    own = texts.pop(order[0])
    return own + "".join(f"{'=' * 80}\nMSG: {one}\n{text}" for one, text in texts.items())


def header(time_ns: int, frame_id: str) -> Message:
    """A `std_msgs/Header`."""
    sec, nanosec = divmod(time_ns, 10**9)
    return {"stamp": {"sec": sec, "nanosec": nanosec}, "frame_id": frame_id}


def image(head: Message, encoding: str, pixels: NDArray[Any]) -> Message:
    """A `sensor_msgs/Image` of `(h, w)` or `(h, w, c)` pixels, which are written in little-endian order."""
    content = np.ascontiguousarray(pixels, pixels.dtype.newbyteorder("<"))
    height, width = content.shape[:2]
    size = {"height": height, "width": width, "step": content.strides[0]}
    return {"header": head, **size, "encoding": encoding, "is_bigendian": 0, "data": content.tobytes()}


def vector(values: ArrayLike) -> Message:
    """A `geometry_msgs/Point` or `Vector3` of `(3,)` values."""
    return dict(zip("xyz", np.asarray(values, dtype=float).tolist(), strict=True))


def pose(position: ArrayLike, rotation: NDArray[np.floating[Any]]) -> Message:
    """A `geometry_msgs/Pose` at a position `(3,)`, turned by a rotation matrix `(3, 3)`."""
    from scipy.spatial.transform import Rotation

    turn = Rotation.from_matrix(rotation).as_quat(canonical=True).tolist()
    return {"position": vector(position), "orientation": dict(zip("xyzw", turn, strict=True))}


def transform(head: Message, child: str, matrix: NDArray[np.floating[Any]]) -> Message:
    """A `geometry_msgs/TransformStamped`: the pose `(4, 4)` of a frame in that of the header."""
    found = pose(matrix[:3, 3], matrix[:3, :3])
    content = {"translation": found["position"], "rotation": found["orientation"]}
    return {"header": head, "child_frame_id": child, "transform": content}
