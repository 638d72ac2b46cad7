"""RGB-D sequences in the layout of TUM, with the camera as ROS describes it.

Formats: https://cvg.cit.tum.de/data/datasets/rgbd-dataset/file_formats for images, trajectories and
associations; https://wiki.ros.org/camera_calibration_parsers and REP 104,
https://www.ros.org/reps/rep-0104.html, for `camera_info.yaml`; REP 118,
https://www.ros.org/reps/rep-0118.html, for depth images of 16 bits in millimetres. Those of a depth camera
with another unit have that unit, which `depth.json` gives.
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
from pepperscene.export.job import ExportJob, open_groups, sequence_groups, write_json
from pepperscene.export.surface import (
    ImageGeometry,
    depth_png,
    depth_unit_m,
    mask_png,
    picture_png,
    read_geometry,
    read_label,
    read_view,
    valid_pixels,
)

STEP_S: Final = 1.0
"""Time from a step to the next. Chosen: a data set has no clock."""

DepthOf = Callable[[DatasetFrame, ImageGeometry], NDArray[np.floating[Any]]]
"""The depths `(h, w)` of a frame in metres, as its exported images show them."""


def write_rgbd(job: ExportJob, folder: Path) -> None:
    """Write `rgb/000110.png`, `depth/000110.png`, `camera_info.yaml` and tables of times of each sequence.

    A sequence is a scene as one camera of one split sees it. Its time is the step of a frame, in seconds.
    `rgb.txt` and `depth.txt` list the images by time, `associations.txt` their pairs, and `groundtruth.txt`
    the poses, camera to world. Depths are along the optical axis, in the unit of the depth camera or else in
    millimetres, which `depth.json` gives, 0 for none. With a foreground, they are 0 outside it, and
    `mask/000110.png` is 255 inside. Without photographs in all frames, there is nothing of `rgb`.
    """
    _write_sequences(job, folder, lambda frame, geometry: read_view(frame, geometry).depth_z)


def write_rgbd_sensor(job: ExportJob, folder: Path) -> None:
    """Write the files of `write_rgbd` with the depths that a depth camera measured; 0 in its holes."""
    _write_sequences(job, folder, lambda frame, view: read_label(frame, "depth_sensor", view))


def _write_sequences(job: ExportJob, folder: Path, depth_of: DepthOf) -> None:
    for place, indices, frames in open_groups(job, folder, sequence_groups(job)):
        times = [STEP_S * job.plan.frame(index).step for index in indices]
        kinds = ["rgb"] if job.common_outputs(["colour"]) else []
        kinds += ["depth"] if job.images.foreground is None else ["depth", "mask"]
        camera_info, unit_m, poses = _write_images(job, place, kinds, frames, depth_of)
        (place / "camera_info.yaml").write_text(camera_info, encoding="utf-8")
        write_json(place / "depth.json", {"depth_scale_m": unit_m})
        write_poses(place / "groundtruth.txt", PoseList(np.array(poses), np.array(times)), "tum")
        _write_tables(place, kinds, times, [f"{index:06d}.png" for index in indices])


def _write_images(
    job: ExportJob, place: Path, kinds: Sequence[str], frames: Iterable[DatasetFrame], depth_of: DepthOf
) -> tuple[str, float, list[Any]]:
    """Write the images of a sequence, and return its camera, unit of depth and poses; it has one of each."""
    for kind in kinds:
        (place / kind).mkdir()
    first, poses = ("", 0.0), list[Any]()
    for frame in frames:
        geometry = read_geometry(frame, job.images)
        described = _camera_info(geometry.camera), depth_unit_m(frame)
        first = first if poses else described
        if described != first:
            problem = "must be the same in all frames of a sequence, which has one camera_info.yaml"
            key = "camera" if described[0] != first[0] else "depth_camera.depth_unit_m"
            raise InputError(frame.dataset.frame_path(frame.index), problem, key=key)
        contents = _contents(job, frame, geometry, depth_of(frame, geometry))
        for kind in kinds:
            (place / kind / f"{frame.name}.png").write_bytes(contents[kind]())
        poses.append(geometry.camera.pose)
    return *first, poses


def _contents(
    job: ExportJob, frame: DatasetFrame, geometry: ImageGeometry, depth: NDArray[np.floating[Any]]
) -> dict[str, Callable[[], bytes]]:
    """What makes the content of each kind of image of a frame."""
    foreground = job.images.foreground
    if foreground is not None:
        depth = np.where(valid_pixels(frame, geometry, foreground), depth, np.inf)
    return {
        "rgb": lambda: picture_png(frame, geometry, job.images),
        "depth": lambda: depth_png(depth, depth_unit_m(frame)),
        "mask": lambda: mask_png(frame, geometry, foreground),
    }


def _write_tables(place: Path, kinds: Sequence[str], times: Sequence[float], files: Sequence[str]) -> None:
    for kind in kinds:
        rows = [f"{time:.6f} {kind}/{file}" for time, file in zip(times, files, strict=True)]
        _write_lines(place / f"{kind}.txt", ["# timestamp filename", *rows])
    if "rgb" not in kinds:
        return
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
