"""RGB-D sequences in the layout of TUM, with the camera as ROS describes it.

Formats: https://cvg.cit.tum.de/data/datasets/rgbd-dataset/file_formats for images, trajectories and
associations; https://wiki.ros.org/camera_calibration_parsers and REP 104,
https://www.ros.org/reps/rep-0104.html, for `camera_info.yaml`; REP 118,
https://www.ros.org/reps/rep-0118.html, for depth images of 16 bits in millimetres. Those of a depth camera
with another unit have that unit, which the first line of `depth.txt` gives.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.camera import Camera, PoseList, write_poses
from pepperscene.camera.optics.calibration import CENTRE_OF_FIRST_PIXEL
from pepperscene.camera.optics.distortion import MODELS
from pepperscene.dataset.dataset_frame import DatasetFrame
from pepperscene.errors import InputError
from pepperscene.export.job import ExportJob, open_groups, sequence_groups
from pepperscene.export.surface import depth_png, depth_unit_m, read_surface, recorded_camera, size_error

STEP_S: Final = 1.0
"""Time from a step to the next. Chosen: a data set has no clock."""

_IMAGES: Final = ("rgb", "depth")


def write_rgbd(job: ExportJob, folder: Path) -> None:
    """Write `rgb/000110.png`, `depth/000110.png`, `camera_info.yaml` and tables of times of each sequence.

    A sequence is a scene as one camera of one split sees it. Its time is the step of a frame, in seconds.
    `rgb.txt` and `depth.txt` list the images by time, `associations.txt` their pairs, and `groundtruth.txt`
    the poses, camera to world. Depths are along the optical axis, in the unit of the depth camera, or else in
    millimetres, 0 for none.
    """
    _write_sequences(job, folder, lambda frame, _: read_surface(frame).depth_png())


def write_rgbd_sensor(job: ExportJob, folder: Path) -> None:
    """Write the files of `write_rgbd` with the depths that a depth camera measured; 0 in its holes."""
    _write_sequences(job, folder, _measured_png)


def _measured_png(frame: DatasetFrame, camera: Camera) -> bytes:
    depth = frame.image("depth_sensor")
    if depth.shape != (camera.height, camera.width):
        path = frame.dataset.path(frame.index, "depth_sensor")
        raise size_error(path, (camera.height, camera.width), depth.shape)
    return depth_png(depth, depth_unit_m(frame))


def _write_sequences(job: ExportJob, folder: Path, depth_of: Callable[[DatasetFrame, Camera], bytes]) -> None:
    """Write all files; `depth_of` makes the content of the depth image of a frame with its camera."""
    for place, indices, frames in open_groups(job, folder, sequence_groups(job)):
        times = [STEP_S * job.plan.frame(index).step for index in indices]
        camera_info, unit, poses = _write_images(place, frames, depth_of)
        (place / "camera_info.yaml").write_text(camera_info, encoding="utf-8")
        write_poses(place / "groundtruth.txt", PoseList(np.array(poses), np.array(times)), "tum")
        _write_tables(place, times, [f"{index:06d}.png" for index in indices], unit)


def _write_images(
    place: Path, frames: Iterable[DatasetFrame], depth_of: Callable[[DatasetFrame, Camera], bytes]
) -> tuple[str, str, list[Any]]:
    """Write the images of a sequence, and return its camera, unit of depth and poses; it has one of each."""
    for name in _IMAGES:
        (place / name).mkdir()
    first, poses = ("", ""), list[Any]()
    for frame in frames:
        camera = recorded_camera(frame)
        described = _camera_info(camera), f"# metres per step: {depth_unit_m(frame):g}"
        first = first if poses else described
        if described != first:
            problem = "must be the same in all frames of a sequence, which has one camera_info.yaml"
            key = "camera" if described[0] != first[0] else "depth_camera.depth_unit_m"
            raise InputError(frame.dataset.frame_path(frame.index), problem, key=key)
        (place / "rgb" / f"{frame.name}.png").write_bytes(frame.content("colour"))
        (place / "depth" / f"{frame.name}.png").write_bytes(depth_of(frame, camera))
        poses.append(camera.pose)
    return *first, poses


def _write_tables(place: Path, times: Sequence[float], files: Sequence[str], unit: str) -> None:
    for name in _IMAGES:
        rows = [f"{time:.6f} {name}/{file}" for time, file in zip(times, files, strict=True)]
        comments = [*([unit] if name == "depth" else []), "# timestamp filename"]
        _write_lines(place / f"{name}.txt", [*comments, *rows])
    pairs = [
        f"{time:.6f} rgb/{file} {time:.6f} depth/{file}" for time, file in zip(times, files, strict=True)
    ]
    _write_lines(place / "associations.txt", pairs)


def _write_lines(path: Path, lines: Sequence[str]) -> None:
    path.write_text("".join(f"{line}\n" for line in lines), encoding="utf-8")


def camera_matrices(camera: Camera) -> tuple[str, dict[str, NDArray[np.float64]]]:
    """ROS's name of a camera's distortion model, and its matrices by their names in calibration files.

    The centre of the upper left pixel is at (0, 0).
    """
    distortion = camera.lens.distortion.to_json()
    model = distortion.get("model", "plumb_bob")
    matrix = camera.intrinsics.copy()
    matrix[:2, 2] -= CENTRE_OF_FIRST_PIXEL
    return model, {
        "camera_matrix": matrix,
        "distortion_coefficients": np.array([[distortion[name] for name in MODELS[model]]]),
        "rectification_matrix": np.eye(3),
        "projection_matrix": np.hstack([matrix, np.zeros((3, 1))]),
    }


def _camera_info(camera: Camera) -> str:
    """YAML as of ROS's camera calibration parsers."""
    model, blocks = camera_matrices(camera)
    lines = [f"image_width: {camera.width}", f"image_height: {camera.height}", "camera_name: camera"]
    for name, block in blocks.items():
        if name == "distortion_coefficients":
            lines.append(f"distortion_model: {model}")
        rows, columns = block.shape
        values = ", ".join(_yaml_number(value) for value in block.ravel().tolist())
        lines += [f"{name}:", f"  rows: {rows}", f"  cols: {columns}", f"  data: [{values}]"]
    return "".join(f"{line}\n" for line in lines)


def _yaml_number(value: float) -> str:
    """All digits; with a point, without which YAML 1.1 takes 1e-05 for text."""
    text = repr(value)
    return text if "." in text else text.replace("e", ".0e")
