"""ROS 2 bags in MCAP files: camera, depth, instances, transforms, and detections of fruit.

Formats: https://mcap.dev/spec/registry (profile ros2), and https://github.com/ros2/rosbag2 for
`metadata.yaml`. Frames and axes are those of REP 103 (https://www.ros.org/reps/rep-0103.html): the optical
frame of a camera has z forward and y down, as camera axes here. Depth images of floats are those of REP 118
(https://www.ros.org/reps/rep-0118.html): metres along the optical axis.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import IO, Any, Final, cast

import numpy as np

from pepperscene.camera import Camera
from pepperscene.classes import OrganClass
from pepperscene.dataset.dataset_frame import DatasetFrame
from pepperscene.dataset.selection import Selection
from pepperscene.dataset.store.dataset import MARK
from pepperscene.document import validate
from pepperscene.errors import InputError
from pepperscene.export.job import ExportJob, open_groups, sequence_groups
from pepperscene.export.rgbd import STEP_S, camera_matrices
from pepperscene.export.ros_messages import (
    Message,
    definition,
    header,
    image,
    quaternion,
    transform,
    vector,
)
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
    "/camera/color/image_raw": "sensor_msgs/Image",
    "/camera/color/camera_info": "sensor_msgs/CameraInfo",
    "/camera/aligned_depth_to_color/image_raw": "sensor_msgs/Image",
    "/camera/aligned_depth_to_color/camera_info": "sensor_msgs/CameraInfo",
    "/camera/instance/image_raw": "sensor_msgs/Image",
    "/tf": "tf2_msgs/TFMessage",
    "/fruit/detections": "vision_msgs/Detection3DArray",
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
    recipe, where = job.dataset.info["recipe"], job.dataset.folder / MARK
    varied = (*recipe.get("variation", {}), *recipe.get("twins", {}))
    if any(key.partition(".")[0] == "views" for key in varied):
        return lambda step: STEP_S * step
    views = validate(cast("type[Views]", ViewsTable), recipe["views"], where)
    greenhouse = validate(Greenhouse, recipe.get("greenhouse") or {}, where)
    times = view_times(views, job.plan.frames, greenhouse, str(where))
    if times is None:
        return lambda step: STEP_S * step
    if len(times) < job.plan.frames:
        raise InputError(
            where, f"gives {len(times)} views, but plan.frames is {job.plan.frames}", key="views"
        )
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
        {"transforms": _transforms(frame, surface.camera.pose, time_ns)},
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


def _transforms(frame: DatasetFrame, pose: np.ndarray, time_ns: int) -> list[Message]:
    """The poses of the camera and of each fruit of the harvest truth in the world."""
    head = header(time_ns, WORLD)
    fruit = {f"fruit_{value}": np.asarray(one["pose"], dtype=float) for value, one in frame.fruit.items()}
    return [
        transform(head, CAMERA, pose),
        *(transform(head, name, pose @ in_camera) for name, in_camera in fruit.items()),
    ]


def _detection(head: Message, fruit: Mapping[str, Any], selection: Selection) -> Message:
    """A `vision_msgs/Detection3D`: the box of a fruit along its own axes, in the camera's frame."""
    box, category = fruit["box_3d"], selection.category(OrganClass.PEPPER, fruit)
    assert category is not None  # it is an object
    rotation = np.asarray(fruit["pose"], dtype=float)[:3, :3]
    centre = {"position": vector(box["centre"]), "orientation": quaternion(rotation)}
    return {
        "header": head,
        "results": [
            {"hypothesis": {"class_id": category.name, "score": 1.0}, "pose": {"pose": centre}},
        ],
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
        """Add a message."""
        kind = TOPICS[topic]
        if kind not in self._schemas:
            name = kind.replace("/", "/msg/")
            self._schemas[kind] = self._writer.register_msgdef(name, definition(kind))
        number = self._counts[topic]
        self._writer.write_message(topic, self._schemas[kind], message, time_ns, time_ns, number)
        self._counts[topic] += 1
        self._times.append(time_ns)

    def finish(self) -> None:
        """Write the index at the end."""
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
        topics = [
            {
                "topic_metadata": {
                    "name": topic,
                    "type": TOPICS[topic].replace("/", "/msg/"),
                    "serialization_format": "cdr",
                    "offered_qos_profiles": "",
                },
                "message_count": count,
            }
            for topic, count in self._counts.items()
        ]
        information = {
            "version": 5,
            "storage_identifier": "mcap",
            **span,
            "topics_with_message_count": topics,
            "compression_format": "",
            "compression_mode": "",
            "relative_file_paths": [BAG],
            "files": [{"path": BAG, **span}],
        }
        return str(yaml.safe_dump({"rosbag2_bagfile_information": information}, sort_keys=False))
