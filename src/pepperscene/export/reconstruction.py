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
    training_frames,
    write_json,
    write_table,
)
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
    valid_pixels,
)

LABELS: Final = ("class", "instance")
_SEED_POINTS: Final = 20_000
"""Of a scene. Chosen: COLMAP finds some tens of thousands in a few hundred images."""
_TYPES: Final = {"f4": "float", "u1": "uchar", "u2": "ushort"}


@dataclass(frozen=True, eq=False)
class SeedPoints:
    """Points on the surfaces of a scene.

    Attributes:
        position: `(n, 3)` world metres, whole micrometres.
        colour: `(n, 3)` uint8, of the pixel in which a point was found.
        labels: `(n,)` class and instance of that pixel, by name, as far as the data set has them.
    """

    position: NDArray[np.float64]
    colour: NDArray[np.uint8]
    labels: Mapping[str, NDArray[Any]]

    def file(self, numbers: NDArray[np.int64], *, has_normals: bool) -> bytes:
        """A PLY file of some of them; all normals are 0, as they are not known."""
        normals = dict.fromkeys(("nx", "ny", "nz") if has_normals else (), np.zeros(len(numbers), np.float32))
        labels = {name: values[numbers] for name, values in self.labels.items()}
        return point_file(self.position[numbers], self.colour[numbers], **normals, **labels)


def seed_points(job: ExportJob, indices: Sequence[int]) -> SeedPoints:
    """Pixels with a surface, drawn evenly from a scene's frames for training; the same for the same frames.

    There are 20,000, or fewer if there are fewer pixels. Ignored pixels, and those outside the foreground of
    the export, have none.
    """
    frames = training_frames(job, indices)
    positions, colours = [np.empty((0, 3))], [np.empty((0, 3), np.uint8)]
    labels: dict[str, list[NDArray[Any]]] = {name: [] for name in job.common_outputs(LABELS)}
    for number, frame in enumerate(frames):
        surface = read_surface(frame)
        is_candidate = np.isfinite(surface.distance)
        if job.has_masks:
            is_candidate &= valid_pixels(frame, surface, job.images.foreground)
        candidates = np.flatnonzero(is_candidate)
        share = _SEED_POINTS * (number + 1) // len(frames) - _SEED_POINTS * number // len(frames)
        # By the index of the frame, so that its points do not depend on what else is exported.
        rng = np.random.default_rng(frame.index)
        chosen = np.sort(rng.choice(candidates, min(share, len(candidates)), replace=False, shuffle=False))
        rows, columns = np.unravel_index(chosen, surface.distance.shape)
        positions.append(np.round(surface.points(rows, columns), 6))
        colours.append(read_colour(frame, surface)[rows, columns])
        for name, values in labels.items():
            values.append(read_label(frame, name, surface)[rows, columns])
    joined = {name: np.concatenate(values) for name, values in labels.items()}
    return SeedPoints(np.concatenate(positions), np.concatenate(colours), joined)


def point_file(
    position: NDArray[np.floating[Any]], colour: NDArray[np.uint8], **extra: NDArray[Any]
) -> bytes:
    """A binary PLY file of points.

    Args:
        position: `(n, 3)` metres, stored in single precision.
        colour: `(n, 3)` uint8.
        extra: more properties by name, each `(n,)` of float32, uint8 or uint16.
    """
    columns = dict(zip("xyz", np.asarray(position, "<f4").T, strict=True))
    columns |= dict(zip(("red", "green", "blue"), colour.T, strict=True))
    columns |= {name: values.astype(values.dtype.newbyteorder("<")) for name, values in extra.items()}
    properties = [f"property {_TYPES[values.dtype.str[1:]]} {name}" for name, values in columns.items()]
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {len(position)}", *properties]
    table = np.empty(len(position), [(name, values.dtype) for name, values in columns.items()])
    for name, values in columns.items():
        table[name] = values
    return "\n".join([*header, "end_header", ""]).encode("ascii") + table.tobytes()


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
        for split, members in scene_splits(job, indices).items():
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
