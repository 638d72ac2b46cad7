"""nerfstudio: transforms.json with the camera of each frame, depth images, masks and seed points.

Format: https://docs.nerf.studio/quickstart/data_conventions.html.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, Final

from pepperscene.camera.pose_files.projects import nerfstudio_frame, nerfstudio_intrinsics
from pepperscene.dataset.dataset_frame import DatasetFrame
from pepperscene.errors import ArgumentError, InputError
from pepperscene.export.job import (
    ExportJob,
    open_groups,
    scene_groups,
    scene_splits,
    training_frames,
    write_json,
)
from pepperscene.export.ply import point_file
from pepperscene.export.surface import (
    MILLIMETRES,
    SEED_POINTS,
    mask_png,
    read_surface,
    seed_points,
)

_POINT_FILE: Final = "seed_points.ply"


def write_nerfstudio(job: ExportJob, folder: Path) -> None:
    """Write `transforms.json`, `images/000110.png`, `depths/000110.png` and `seed_points.ply` of each scene.

    Every frame has its own intrinsics. Depths are along the optical axis, in millimetres, 0 for none. If
    frames can have ignored pixels, `masks/000110.png` is 0 there and 255 elsewhere. Splits are lists of
    images, `train_filenames` and so on; seed points are from frames of the split `train`.
    """
    for place, indices, frames in open_groups(job, folder, scene_groups(job)):
        points = seed_points(training_frames(job, indices), SEED_POINTS, skip_ignored=job.has_ignored_pixels)
        (place / _POINT_FILE).write_bytes(point_file(points.position, points.colour))
        content = _transforms(job, indices, _write_frames(job, place, frames))
        write_json(place / "transforms.json", content)


def _transforms(job: ExportJob, indices: Sequence[int], entries: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """The content of `transforms.json`: entries of frames without the camera model, which all share."""
    paths = {index: entry["file_path"] for index, entry in zip(indices, entries, strict=True)}
    splits = scene_splits(job, indices)
    return {
        "camera_model": entries[0]["camera_model"],
        # The default of nerfstudio, which does not read this key; it tells people the unit.
        "depth_unit_scale_factor": 1 / MILLIMETRES,
        "ply_file_path": _POINT_FILE,
        **{f"{split}_filenames": [paths[index] for index in members] for split, members in splits.items()},
        "frames": [{key: entry[key] for key in entry if key != "camera_model"} for entry in entries],
    }


def _write_frames(job: ExportJob, place: Path, frames: Iterable[DatasetFrame]) -> list[dict[str, Any]]:
    """Write the images of a scene, and return their entries in `frames`."""
    folders = ["images", "depths", *(["masks"] if job.has_ignored_pixels else [])]
    for name in folders:
        (place / name).mkdir()
    entries: list[dict[str, Any]] = []
    for frame in frames:
        surface, file = read_surface(frame), f"{frame.name}.png"
        contents = {"images": frame.content("colour"), "depths": surface.depth_png()}
        if job.has_ignored_pixels:
            contents["masks"] = mask_png(frame, surface)
        for name, content in contents.items():
            (place / name / file).write_bytes(content)
        entry = nerfstudio_frame(f"images/{file}", surface.camera.pose) | {
            "depth_file_path": f"depths/{file}"
        }
        if job.has_ignored_pixels:
            entry["mask_path"] = f"masks/{file}"
        try:
            entry |= nerfstudio_intrinsics(surface.camera)
        except ArgumentError as error:
            path = frame.dataset.frame_path(frame.index)
            raise InputError(path, error.problem, key="camera.distortion") from None
        if entries and entry["camera_model"] != entries[0]["camera_model"]:
            problem = "must be the same kind in all frames of a scene: nerfstudio has one camera model"
            path = frame.dataset.frame_path(frame.index)
            raise InputError(path, problem, key="camera.distortion.model", value=entry["camera_model"])
        entries.append(entry)
    return entries
