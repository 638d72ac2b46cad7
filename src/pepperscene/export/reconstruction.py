"""Scenes for reconstruction: nerfstudio's transforms.json, COLMAP's text model, and point clouds.

Formats: https://docs.nerf.studio/quickstart/data_conventions.html; https://colmap.github.io/format.html,
https://colmap.github.io/cameras.html; what 3D Gaussian splatting reads of a COLMAP model:
https://github.com/graphdeco-inria/gaussian-splatting, `scene/dataset_readers.py`.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.camera.pose_files.projects import (
    COLMAP_CAMERAS,
    COLMAP_IMAGES,
    COLMAP_POINTS,
    colmap_camera,
    colmap_images,
    nerfstudio_frame,
    nerfstudio_intrinsics,
)
from pepperscene.dataset.dataset_frame import DatasetFrame
from pepperscene.errors import ArgumentError, InputError
from pepperscene.export.job import (
    ExportJob,
    open_groups,
    scene_groups,
    scene_splits,
    write_json,
    write_table,
)
from pepperscene.export.points import LABELS, SeedPoints, point_file, seed_points
from pepperscene.export.surface import (
    MILLIMETRES,
    RangeImage,
    depth_png,
    mask_png,
    picture_png,
    read_colour,
    read_geometry,
    read_label,
    read_surface,
    read_view,
)

_COLUMNS: Final = ("index", "set", "rotation", "step", "split", "file")


def write_ply(job: ExportJob, folder: Path) -> None:
    """Write `points/000110.ply` of each frame, and `frames.csv`, which gives its split.

    A point is a pixel with a surface: its centre's world coordinates `x`, `y`, `z` in metres, its colour
    `red`, `green`, `blue`, its `class` id and its `instance`. With a foreground, only its pixels are points.
    """
    (folder / "points").mkdir()

    def write_clouds() -> Iterator[dict[str, Any]]:
        for frame in job.frames():
            name = f"points/{frame.name}.ply"
            (folder / name).write_bytes(_point_cloud(frame, job.images.foreground))
            yield {**frame.metadata, "split": job.split_of[frame.index], "file": name}

    write_table(folder / "frames.csv", _COLUMNS, write_clouds())


def _point_cloud(frame: DatasetFrame, foreground: frozenset[int] | None) -> bytes:
    surface = read_surface(frame, allows_line_scan=True)
    colour, labels = read_colour(frame, surface), {name: read_label(frame, name, surface) for name in LABELS}
    is_point = np.isfinite(surface.distance)
    if foreground is not None:
        is_point &= np.isin(labels["class"], sorted(foreground))
    rows, columns = np.nonzero(is_point)
    extra = {name: image[rows, columns] for name, image in labels.items()}
    return point_file(surface.points(rows, columns), colour[rows, columns], **extra)


_POINT_FILE: Final = "seed_points.ply"
_DEPTH_UNIT_M: Final = 1 / MILLIMETRES


def write_nerfstudio(job: ExportJob, folder: Path) -> None:
    """Write `transforms.json`, `images/000110.png`, `depths/000110.png` and `seed_points.ply` of each scene.

    Every frame has its own intrinsics. Depths are along the optical axis, in millimetres, 0 for none. With a
    foreground, `masks/000110.png` is 255 there and 0 elsewhere; without one, if frames can have ignored
    pixels, it is 0 there. Splits are lists of images, `train_filenames` and so on; seed points are from
    frames of the split `train`.
    """
    for place, indices, frames in open_groups(job, folder, scene_groups(job)):
        points = seed_points(job, indices)
        (place / _POINT_FILE).write_bytes(points.file(np.arange(len(points.position)), has_normals=False))
        content = _transforms(job, indices, _write_frames(job, place, frames))
        write_json(place / "transforms.json", content)


def _transforms(job: ExportJob, indices: Sequence[int], entries: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """The content of `transforms.json`: entries of frames without the camera model, which all share."""
    paths = {index: entry["file_path"] for index, entry in zip(indices, entries, strict=True)}
    splits = scene_splits(job, indices)
    return {
        "camera_model": entries[0]["camera_model"],
        # Nerfstudio ignores this key. It documents the unit, which is that of its readers.
        "depth_unit_scale_factor": _DEPTH_UNIT_M,
        "ply_file_path": _POINT_FILE,
        **{f"{split}_filenames": [paths[index] for index in members] for split, members in splits.items()},
        "frames": [{key: entry[key] for key in entry if key != "camera_model"} for entry in entries],
    }


def _write_frames(job: ExportJob, place: Path, frames: Iterable[DatasetFrame]) -> list[dict[str, Any]]:
    """Write the images of a scene, and return their entries in `frames`."""
    folders = ["images", "depths", *(["masks"] if job.has_masks else [])]
    for name in folders:
        (place / name).mkdir()
    entries: list[dict[str, Any]] = []
    for frame in frames:
        surface, file = read_view(frame, read_geometry(frame, job.images)), f"{frame.name}.png"
        contents = {
            "images": picture_png(frame, surface, job.images),
            "depths": depth_png(surface.depth_z, _DEPTH_UNIT_M),
        }
        if job.has_masks:
            contents["masks"] = mask_png(frame, surface, job.images.foreground)
        for name, content in contents.items():
            (place / name / file).write_bytes(content)
        entry = nerfstudio_frame(f"images/{file}", surface.camera.pose) | {
            "depth_file_path": f"depths/{file}"
        }
        if job.has_masks:
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


DISTANCE_TOLERANCE: Final = 0.005
"""Relative difference of distances up to which a pixel shows a point. Chosen: 2 mm at 40 cm, which a surface
at 60 degrees reaches within two pixels of a camera of 800 columns."""


@dataclass(frozen=True, eq=False)
class _Tracks:
    """The observations of the points of a scene; each entry is of one image."""

    points: list[NDArray[np.int64]] = field(default_factory=list)  # numbers of points, from 0
    errors: list[NDArray[np.float64]] = field(default_factory=list)  # of the reprojection, pixels

    def seen(self) -> NDArray[np.int64]:
        """The numbers of the points that an image shows, ascending."""
        return np.unique(np.concatenate([np.empty(0, np.int64), *self.points]))

    def text(self, seeds: SeedPoints) -> str:
        """The content of points3D.txt."""
        sizes = [len(points) for points in self.points]
        point = np.concatenate([np.empty(0, np.int64), *self.points])
        image = np.repeat(np.arange(1, 1 + len(sizes)), sizes)
        place = np.concatenate([np.empty(0, np.int64), *map(np.arange, sizes)])
        order = np.argsort(point, kind="stable")
        count = np.bincount(point, minlength=len(seeds.position))
        total = np.bincount(point, np.concatenate([np.empty(0), *self.errors]), len(seeds.position))
        pairs = np.char.add(np.char.add(image[order].astype(str), " "), place[order].astype(str)).tolist()
        ends = np.cumsum(count).tolist()
        lines = [COLMAP_POINTS]
        for number in np.flatnonzero(count).tolist():
            x, y, z = seeds.position[number].tolist()
            red, green, blue = seeds.colour[number].tolist()
            track = " ".join(pairs[ends[number] - int(count[number]) : ends[number]])
            error = total[number] / count[number]
            lines.append(f"{number + 1} {x:.6f} {y:.6f} {z:.6f} {red} {green} {blue} {error:.4f} {track}\n")
        return "".join(lines)


def write_colmap(job: ExportJob, folder: Path) -> None:
    """Write `images/000110.png` and the text model `sparse/0` of each scene.

    Equal cameras share an entry of `cameras.txt`. The track of a seed point are the images of the scene
    that show it. `masks/000110.png.png` are those of `write_nerfstudio`, as COLMAP's feature extractor reads
    them. `points3D.ply` has the points of `points3D.txt` and their labels; 3D Gaussian splatting reads it, if
    the camera is a pinhole. Splits are lists of images, `train_list.txt` and so on, as nerfstudio reads them;
    seed points are from frames of the split `train`.
    """
    for place, indices, frames in open_groups(job, folder, scene_groups(job)):
        _write_scene(job, place, seed_points(job, indices), frames)
        _write_splits(place, scene_splits(job, indices))


def _write_splits(place: Path, splits: Mapping[str, Sequence[int]]) -> None:
    for split, members in splits.items():
        text = "".join(f"{index:06d}.png\n" for index in members)
        (place / f"{split}_list.txt").write_text(text, encoding="utf-8")


def _write_scene(job: ExportJob, place: Path, seeds: SeedPoints, frames: Iterable[DatasetFrame]) -> None:
    model = place / "sparse" / "0"
    for new in (place / "images", model, *([place / "masks"] if job.has_masks else [])):
        new.mkdir(parents=True)
    tracks, cameras = _Tracks(), dict[str, int]()
    with (model / "images.txt").open("w", encoding="utf-8", newline="\n") as file:
        file.write(COLMAP_IMAGES)
        for number, frame in enumerate(frames, start=1):
            surface, name = read_view(frame, read_geometry(frame, job.images)), f"{frame.name}.png"
            (place / "images" / name).write_bytes(picture_png(frame, surface, job.images))
            if job.has_masks:
                content = mask_png(frame, surface, job.images.foreground)
                (place / "masks" / f"{name}.png").write_bytes(content)
            # A camera is its line without the number.
            _, _, parameters = colmap_camera(surface.camera).partition(" ")
            camera = cameras.setdefault(parameters, len(cameras) + 1)
            file.write(f"{colmap_images(surface.camera.pose[None], [number], [camera], [name])[0]}\n")
            file.write(f"{_observe(seeds, surface, tracks)}\n")
    lines = "".join(f"{number} {parameters}\n" for parameters, number in cameras.items())
    (model / "cameras.txt").write_text(COLMAP_CAMERAS + lines, encoding="utf-8")
    (model / "points3D.txt").write_text(tracks.text(seeds), encoding="utf-8")
    (model / "points3D.ply").write_bytes(seeds.file(tracks.seen(), has_normals=True))


def _observe(seeds: SeedPoints, surface: RangeImage, tracks: _Tracks) -> str:
    """Add the points that an image shows to their tracks, and return its line of points in images.txt."""
    visible, pixels = visible_points(seeds.position, surface)
    camera = surface.camera
    errors = np.zeros(len(visible))
    if camera.rows_move:
        # The model has one pose for all rows.
        still = dataclasses.replace(camera, motion=None).project(seeds.position[visible])
        errors = np.nan_to_num(np.linalg.norm(still - pixels, axis=1))
    tracks.points.append(visible)
    tracks.errors.append(errors)
    # Rounding must not move a point near the right or lower border out of the image.
    pixels = np.minimum(pixels, [camera.width - 1e-3, camera.height - 1e-3])
    rows = zip(pixels.tolist(), visible.tolist(), strict=True)
    return " ".join(f"{u:.3f} {v:.3f} {number + 1}" for (u, v), number in rows)


def visible_points(
    points: NDArray[np.float64], surface: RangeImage
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """The numbers `(m,)` of the world points `(n, 3)` that a frame shows, and their pixels `(m, 2)`.

    A point is visible if it is inside the image, and its distance is that of its pixel up to
    `DISTANCE_TOLERANCE`.
    """
    camera = surface.camera
    pixels = camera.project(points)
    with np.errstate(invalid="ignore"):
        inside = ((pixels >= 0) & (pixels < (camera.width, camera.height))).all(axis=1)
    numbers = np.flatnonzero(inside)
    pixels = pixels[numbers]
    columns, rows = pixels.astype(np.int64).T
    expected = np.linalg.norm(points[numbers] - camera.label_centres(pixels[:, 1]), axis=1)
    with np.errstate(invalid="ignore"):
        shown = np.abs(surface.distance[rows, columns] - expected) <= DISTANCE_TOLERANCE * expected
    return numbers[shown], pixels[shown]
