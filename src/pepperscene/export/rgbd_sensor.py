"""RGB-D sequences with the depth that a depth camera measured; the layout is that of the format rgbd."""

from __future__ import annotations

from pathlib import Path

from pepperscene.camera import Camera
from pepperscene.dataset.dataset_frame import DatasetFrame
from pepperscene.export.job import ExportJob
from pepperscene.export.rgbd import write_depths
from pepperscene.export.surface import depth_png, size_error


def write_rgbd_sensor(job: ExportJob, folder: Path) -> None:
    """Write the files of `write_rgbd` with depths of the output `depth_sensor`; 0 in its holes."""
    write_depths(job, folder, _measured_png)


def _measured_png(frame: DatasetFrame, camera: Camera) -> bytes:
    depth = frame.image("depth_sensor")
    if depth.shape != (camera.height, camera.width):
        path = frame.dataset.path(frame.index, "depth_sensor")
        raise size_error(path, (camera.height, camera.width), depth.shape)
    return depth_png(depth)
