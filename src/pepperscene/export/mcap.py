"""ROS 2 bags in MCAP files: camera, depth, instances, transforms, and detections of fruit.

Formats: https://mcap.dev/spec/registry (profile ros2), and https://github.com/ros2/rosbag2 for
`metadata.yaml`. Frames and axes are those of REP 103 (https://www.ros.org/reps/rep-0103.html): the optical
frame of a camera has z forward and y down, as camera axes here. Depth images of floats are those of REP 118
(https://www.ros.org/reps/rep-0118.html): metres along the optical axis.

Messages are those of the interface packages of ROS 2, https://github.com/ros2/common_interfaces (std_msgs,
sensor_msgs, geometry_msgs), https://github.com/ros2/geometry2 (tf2_msgs), and
https://github.com/ros2/rcl_interfaces (builtin_interfaces), and of release 4 of
https://github.com/ros-perception/vision_msgs.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import IO, Any, Final, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pepperscene.camera import Camera
from pepperscene.camera.poses.generators import check_poses
from pepperscene.classes import OrganClass
from pepperscene.dataset.dataset_frame import DatasetFrame
from pepperscene.dataset.selection import Selection
from pepperscene.dataset.store.dataset import MARK
from pepperscene.document import validate
from pepperscene.errors import InputError
from pepperscene.export.job import ExportJob, open_groups, sequence_groups
from pepperscene.export.rgbd import STEP_S, camera_matrices
from pepperscene.export.surface import read_colour, read_label, read_surface
from pepperscene.libraries import import_library
from pepperscene.recipe.views.fixed_views import view_times
from pepperscene.recipe.views_tables import Views, ViewsTable
from pepperscene.scene import Greenhouse

BAG: Final = "bag.mcap"
METADATA: Final = "metadata.yaml"
WORLD: Final = "world"
CAMERA: Final = "camera_color_optical_frame"
START_S: Final = 1.0
"""Time of the first step. Chosen: to ROS, time 0 means "the latest"."""

TOPICS: Final = {
    "/camera/color/image_raw": "sensor_msgs/msg/Image",
    "/camera/color/camera_info": "sensor_msgs/msg/CameraInfo",
    "/camera/aligned_depth_to_color/image_raw": "sensor_msgs/msg/Image",
    "/camera/aligned_depth_to_color/camera_info": "sensor_msgs/msg/CameraInfo",
    "/camera/instance/image_raw": "sensor_msgs/msg/Image",
    "/tf": "tf2_msgs/msg/TFMessage",
    "/fruit/detections": "vision_msgs/msg/Detection3DArray",
}
"""Topics and types of their messages; the names of images are those of the RealSense driver."""


def write_mcap(job: ExportJob, folder: Path) -> None:
    """Write `bag.mcap` and `metadata.yaml` of each sequence: a scene as one camera of one split sees it.

    Raises:
        InputError: the views of the recipe give no times.
    """
    time_of = _clock(job)
    for place, _, frames in open_groups(job, folder, sequence_groups(job)):
        with (place / BAG).open("wb") as file:
            bag = _Bag(file)
            for frame in frames:
                step = job.plan.frame(frame.index).step
                time_ns = round(1e9 * (START_S + time_of(step)))
                for topic, message in _messages(frame, time_ns, job.selection):
                    bag.write(topic, message, time_ns)
            bag.finish()
        (place / METADATA).write_text(bag.metadata(), encoding="utf-8")


def _clock(job: ExportJob) -> Callable[[int], float]:
    """Seconds from the first step to each: of the option, of a path with a speed, or of steps of a second."""
    rate_hz = job.frame_rate_hz
    if rate_hz is not None:
        return lambda step: step / rate_hz
    recipe, where, times = job.dataset.info["recipe"], job.dataset.folder / MARK, None
    varied = (*recipe.get("variation", {}), *recipe.get("twins", {}))
    if not any(key.partition(".")[0] == "views" for key in varied):
        views = validate(cast("type[Views]", ViewsTable), recipe.get("views", {}), where)
        greenhouse = validate(Greenhouse, recipe.get("greenhouse") or {}, where)
        times = view_times(views, job.plan.frames, greenhouse, str(where))
    if times is None:
        return lambda step: STEP_S * step
    if len(times) < job.plan.frames:
        raise InputError(where, f"gives only {len(times)} views", key="recipe.views")
    return lambda step: float(times[step])


def _messages(frame: DatasetFrame, time_ns: int, selection: Selection) -> Iterator[tuple[str, Message]]:
    """The topics and messages of a frame, in the order of `TOPICS`."""
    surface, head = read_surface(frame), header(time_ns, CAMERA)
    info, instance = _camera_info(head, surface.camera), read_label(frame, "instance", surface)
    messages = [
        image(head, "rgb8", read_colour(frame, surface)),
        info,
        image(head, "32FC1", surface.depth_z.astype(np.float32)),
        info,
        image(head, "16UC1", instance),
        {"transforms": _transforms(frame, surface.camera, time_ns)},
    ]
    if "harvest" in frame.metadata["outputs"]:
        objects = frame.objects(selection, instance)
        seen = [fruit for value, fruit in frame.fruit.items() if value in objects and fruit.get("box_3d")]
        messages.append({"header": head, "detections": [_detection(head, one, selection) for one in seen]})
    yield from zip(TOPICS, messages, strict=False)


def _camera_info(head: Message, camera: Camera) -> Message:
    model, matrices = camera_matrices(camera)
    k, d, r, p = (matrix.ravel().tolist() for matrix in matrices.values())
    size = {"height": camera.height, "width": camera.width}
    return {"header": head, **size, "distortion_model": model, "d": d, "k": k, "r": r, "p": p}


def _transforms(frame: DatasetFrame, camera: Camera, time_ns: int) -> list[Message]:
    """The poses of the camera and of each fruit of the harvest truth in the world."""
    poses = np.array([one["pose"] for one in frame.fruit.values()], dtype=float).reshape(-1, 4, 4)
    try:
        check_poses(poses)
    except ValueError as error:
        path = frame.dataset.path(frame.index, "harvest")
        raise InputError(path, f"must hold rigid motions: {error}", key="fruit.pose") from None
    names = [CAMERA, *(f"fruit_{value}" for value in frame.fruit)]
    head, in_world = header(time_ns, WORLD), [camera.pose, *(camera.pose @ poses)]
    return [transform(head, name, matrix) for name, matrix in zip(names, in_world, strict=True)]


def _detection(head: Message, fruit: Mapping[str, Any], selection: Selection) -> Message:
    """A `vision_msgs/Detection3D`: the box of a fruit along its own axes, in the camera's frame."""
    box, category = fruit["box_3d"], selection.category(OrganClass.PEPPER, fruit)
    assert category is not None  # it is an object
    centre = pose(box["centre"], np.asarray(fruit["pose"], dtype=float)[:3, :3])
    hypothesis = {"class_id": category.name, "score": 1.0}  # certain
    return {
        "header": head,
        "results": [{"hypothesis": hypothesis, "pose": {"pose": centre}}],
        "bbox": {"center": centre, "size": vector(box["size"])},
        "id": str(fruit["instance"]),
    }


class _Bag:
    """An MCAP file that is written, and what its `metadata.yaml` says."""

    def __init__(self, file: IO[bytes]) -> None:
        self._writer = import_library("mcap_ros2.writer", "ros").Writer(file)
        self._schemas: dict[str, Any] = {}
        self._counts: Counter[str] = Counter()
        self._times: list[int] = []

    def write(self, topic: str, message: Message, time_ns: int) -> None:
        kind = TOPICS[topic]
        if kind not in self._schemas:
            self._schemas[kind] = self._writer.register_msgdef(kind, definition(kind))
        schema, number = self._schemas[kind], self._counts[topic]
        self._writer.write_message(topic, schema, message, time_ns, sequence=number)
        self._counts[topic] += 1
        self._times.append(time_ns)

    def finish(self) -> None:
        self._writer.finish()

    def metadata(self) -> str:
        """The content of `metadata.yaml`, which rosbag2 needs to open a folder as a bag."""
        import yaml

        first, last = min(self._times), max(self._times)
        span = {
            "duration": {"nanoseconds": last - first},
            "starting_time": {"nanoseconds_since_epoch": first},
            "message_count": self._counts.total(),
        }
        encoding = {"serialization_format": "cdr", "offered_qos_profiles": ""}
        topics = [
            {
                "topic_metadata": {"name": topic, "type": TOPICS[topic], **encoding},
                "message_count": count,
            }
            for topic, count in self._counts.items()
        ]
        information = {"version": 5, "storage_identifier": "mcap", **span}
        information |= {"topics_with_message_count": topics, "files": [{"path": BAG, **span}]}
        information |= {"compression_format": "", "compression_mode": "", "relative_file_paths": [BAG]}
        return str(yaml.safe_dump({"rosbag2_bagfile_information": information}))


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
"""Fields of each type of message, separated by semicolons."""


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
