"""COLMAP: the text model of a scene, with seed points and the images that show each of them.

Format: https://colmap.github.io/format.html; camera models: https://colmap.github.io/cameras.html.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.camera.pose_files.projects import (
    COLMAP_CAMERAS,
    COLMAP_IMAGES,
    COLMAP_POINTS,
    colmap_camera,
    colmap_images,
)
from pepperscene.dataset.dataset_frame import DatasetFrame
from pepperscene.export.job import ExportJob, open_groups, scene_groups, scene_splits, training_frames
from pepperscene.export.surface import (
    SEED_POINTS,
    RangeImage,
    SeedPoints,
    mask_png,
    read_surface,
    seed_points,
)

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
