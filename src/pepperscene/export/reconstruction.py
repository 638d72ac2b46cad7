"""Scenes for reconstruction: nerfstudio's transforms.json, COLMAP's text model, and point clouds.

Formats: https://docs.nerf.studio/quickstart/data_conventions.html; https://colmap.github.io/format.html,
https://colmap.github.io/cameras.html; PLY: G. Turk, "The PLY polygon file format", Stanford University, 1994,
https://paulbourke.net/dataformats/ply/.
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
    training_frames,
    write_json,
    write_table,
)
from pepperscene.export.surface import (
    MILLIMETRES,
    SEED_POINTS,
    RangeImage,
    SeedPoints,
    depth_png,
    mask_png,
    read_colour,
    read_label,
    read_surface,
    seed_points,
)

_COLUMNS: Final = ("index", "set", "rotation", "step", "split", "file")
_COLOURS: Final = ("red", "green", "blue")
_LABELS: Final = ("class", "instance")


def write_ply(job: ExportJob, folder: Path) -> None:
    """Write `points/000110.ply` of each frame, and `frames.csv`, which gives its split.

    A point is a pixel with a surface: its centre's world coordinates `x`, `y`, `z` in metres, its colour
    `red`, `green`, `blue`, its `class` id and its `instance`.
    """
    (folder / "points").mkdir()

    def write_clouds() -> Iterator[dict[str, Any]]:
        for frame in job.frames():
            name = f"points/{frame.name}.ply"
            (folder / name).write_bytes(_point_cloud(frame))
            yield {**frame.metadata, "split": job.split_of[frame.index], "file": name}

    write_table(folder / "frames.csv", _COLUMNS, write_clouds())


def _point_cloud(frame: DatasetFrame) -> bytes:
    surface = read_surface(frame, allows_line_scan=True)
    colour, labels = read_colour(frame, surface), {name: read_label(frame, name, surface) for name in _LABELS}
    rows, columns = np.nonzero(np.isfinite(surface.distance))
    extra = {name: image[rows, columns] for name, image in labels.items()}
    return point_file(surface.points(rows, columns), colour[rows, columns], **extra)


def point_file(
    position: NDArray[np.floating[Any]], colour: NDArray[np.uint8], **extra: NDArray[Any]
) -> bytes:
    """A binary PLY file of points.

    Args:
        position: `(n, 3)` metres, stored in single precision.
        colour: `(n, 3)` uint8.
        extra: more properties by name, each `(n,)` of uint8 or uint16.
    """
    columns = dict(zip("xyz", np.asarray(position, "<f4").T, strict=True))
    columns |= dict(zip(_COLOURS, colour.T, strict=True))
    columns |= {name: values.astype(values.dtype.newbyteorder("<")) for name, values in extra.items()}
    names = {"f": "float", "u1": "uchar", "u2": "ushort"}
    properties = [
        f"property {names.get(values.dtype.str[1:], names.get(values.dtype.kind))} {name}"
        for name, values in columns.items()
    ]
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {len(position)}", *properties]
    table = np.empty(len(position), [(name, values.dtype) for name, values in columns.items()])
    for name, values in columns.items():
        table[name] = values
    return "\n".join([*header, "end_header", ""]).encode("ascii") + table.tobytes()


_POINT_FILE: Final = "seed_points.ply"
_DEPTH_UNIT_M: Final = 1 / MILLIMETRES


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
        # Nerfstudio ignores this key. It documents the unit, which is that of its readers.
        "depth_unit_scale_factor": _DEPTH_UNIT_M,
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
        contents = {"images": frame.content("colour"), "depths": depth_png(surface.depth_z, _DEPTH_UNIT_M)}
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


DISTANCE_TOLERANCE: Final = 0.005
"""Relative difference of distances up to which a pixel shows a point. Chosen: 2 mm at 40 cm, which a surface
at 60 degrees reaches within two pixels of a camera of 800 columns."""


@dataclass(frozen=True, eq=False)
class _Tracks:
    """The observations of the points of a scene; each entry is of one image."""

    points: list[NDArray[np.int64]] = field(default_factory=list)  # numbers of points, from 0
    errors: list[NDArray[np.float64]] = field(default_factory=list)  # of the reprojection, pixels

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
    that show it. If frames can have ignored pixels, `masks/000110.png.png` is 0 there and 255 elsewhere, as
    COLMAP's feature extractor reads it. Splits are lists of images, `train_list.txt` and so on, as nerfstudio
    reads them; seed points are from frames of the split `train`.
    """
    for place, indices, frames in open_groups(job, folder, scene_groups(job)):
        seeds = seed_points(training_frames(job, indices), SEED_POINTS, skip_ignored=job.has_ignored_pixels)
        _write_scene(job, place, seeds, frames)
        _write_splits(place, scene_splits(job, indices))


def _write_splits(place: Path, splits: Mapping[str, Sequence[int]]) -> None:
    for split, members in splits.items():
        text = "".join(f"{index:06d}.png\n" for index in members)
        (place / f"{split}_list.txt").write_text(text, encoding="utf-8")


def _write_scene(job: ExportJob, place: Path, seeds: SeedPoints, frames: Iterable[DatasetFrame]) -> None:
    model = place / "sparse" / "0"
    for new in (place / "images", model, *([place / "masks"] if job.has_ignored_pixels else [])):
        new.mkdir(parents=True)
    tracks, cameras = _Tracks(), dict[str, int]()
    with (model / "images.txt").open("w", encoding="utf-8", newline="\n") as file:
        file.write(COLMAP_IMAGES)
        for number, frame in enumerate(frames, start=1):
            surface, name = read_surface(frame), f"{frame.name}.png"
            (place / "images" / name).write_bytes(frame.content("colour"))
            if job.has_ignored_pixels:
                (place / "masks" / f"{name}.png").write_bytes(mask_png(frame, surface))
            # A camera is its line without the number.
            _, _, parameters = colmap_camera(surface.camera).partition(" ")
            camera = cameras.setdefault(parameters, len(cameras) + 1)
            file.write(f"{colmap_images(surface.camera.pose[None], [number], [camera], [name])[0]}\n")
            file.write(f"{_observe(seeds, surface, tracks)}\n")
    lines = "".join(f"{number} {parameters}\n" for parameters, number in cameras.items())
    (model / "cameras.txt").write_text(COLMAP_CAMERAS + lines, encoding="utf-8")
    (model / "points3D.txt").write_text(tracks.text(seeds), encoding="utf-8")


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
