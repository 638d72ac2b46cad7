"""The camera of a recorded frame, and the surface that it shows: distances, depths and world points."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.camera import Camera
from pepperscene.camera.optics.distortion import MODELS
from pepperscene.classes import IGNORE_CLASS
from pepperscene.dataset.dataset_frame import DatasetFrame
from pepperscene.dataset.store.images import png_bytes
from pepperscene.errors import InputError
from pepperscene.export.formats import DEPTH_OUTPUTS

SEED_POINTS: Final = 20_000
"""Of a scene. Chosen: COLMAP finds some tens of thousands in a few hundred images."""

MILLIMETRES: Final = 1000.0  # per metre
MOST_STEPS: Final = 65_535  # of a 16-bit image


@dataclass(frozen=True, eq=False)
class RangeImage:
    """The surface that a frame shows.

    Attributes:
        camera: of the frame.
        distance: `(h, w)` metres along the rays through the pixel centres; inf where there is no surface.
        depth_unit_m: of a step of its depth images of 16 bits; see `depth_unit_m`.
    """

    camera: Camera
    distance: NDArray[np.float64]
    depth_unit_m: float = 1.0 / MILLIMETRES

    @property
    def depth_z(self) -> NDArray[np.float64]:
        """`(h, w)` metres along the optical axis."""
        return np.asarray(self.distance * self.camera.pixel_directions()[..., 2])

    def points(self, rows: NDArray[np.int64], columns: NDArray[np.int64]) -> NDArray[np.float64]:
        """`(n, 3)` world points in metres of pixels with a surface, at their rows and columns `(n,)`."""
        camera = self.camera
        in_camera = camera.pixel_directions()[rows, columns] * self.distance[rows, columns, None]
        if not camera.rows_move:
            return np.asarray(in_camera @ camera.pose[:3, :3].T + camera.pose[:3, 3])
        # Labels of a moving camera with a rolling shutter have the pose of each row.
        poses = camera.label_poses(np.arange(camera.height) + 0.5)[rows]
        return np.asarray(np.einsum("nij,nj->ni", poses[:, :3, :3], in_camera) + poses[:, :3, 3])

    def depth_png(self) -> bytes:
        """A PNG of 16 bits: depth along the optical axis as of `depth_png`."""
        return depth_png(self.depth_z, self.depth_unit_m)


def depth_png(depth_m: NDArray[np.floating[Any]], unit_m: float) -> bytes:
    """A PNG of 16 bits: depths in steps of a unit, 0 for none, nan and those beyond 65,535 steps."""
    steps = np.rint(depth_m * (1.0 / unit_m))
    return png_bytes(np.where(steps <= MOST_STEPS, steps, 0).astype(np.uint16))


def depth_unit_m(frame: DatasetFrame) -> float:
    """Metres of a step of depth images: that of the frame's depth camera, or else a millimetre."""
    table = frame.metadata.get("depth_camera")
    unit = table.get("depth_unit_m", 1.0 / MILLIMETRES) if isinstance(table, dict) else 1.0 / MILLIMETRES
    if not isinstance(unit, int | float) or not 0 < unit < np.inf:
        path = frame.dataset.frame_path(frame.index)
        raise InputError(path, "must be a positive number", key="depth_camera.depth_unit_m", value=unit)
    return unit


def recorded_camera(frame: DatasetFrame, *, allows_line_scan: bool = False) -> Camera:
    """The camera of a frame, for its geometry only: values of light and electrons are placeholders.

    Pose, intrinsics, distortion, motion and the times of rows are those of the frame's JSON, so that
    `Camera.project`, `pixel_directions` and `label_poses` are those of its labels.

    Raises:
        InputError: a value is missing, the lens has no image of this size, or it is a line scanner, unless
            that is allowed.
    """
    path, values = frame.dataset.frame_path(frame.index), frame.metadata["camera"]
    for key in ("width", "height"):
        if values.get(key) is None:
            raise InputError(path, "is required but missing", key=f"camera.{key}")
    if values.get("line_scan", False) and not allows_line_scan:
        problem = "must be false: this format has cameras that take an image at once, not line scanners"
        raise InputError(path, problem, key="camera.line_scan", value=True)
    model = values["distortion"].get("model", "plumb_bob")
    if model not in MODELS:
        raise InputError(
            path, f"must be one of {', '.join(MODELS)}", key="camera.distortion.model", value=model
        )
    try:
        return Camera.from_metadata(values)
    except InputError as error:
        raise InputError(path, error.detail, key="camera") from None
    except (ValueError, ZeroDivisionError) as error:
        raise InputError(path, f"must describe a camera, but {error}", key="camera") from None


def read_surface(frame: DatasetFrame, *, allows_line_scan: bool = False) -> RangeImage:
    """The surface of a frame from its output `distance`, or else `depth_z`.

    Raises:
        InputError: the camera or the image is not valid, or they differ in size.
    """
    camera = recorded_camera(frame, allows_line_scan=allows_line_scan)
    outputs = frame.metadata["outputs"]
    output = next((name for name in DEPTH_OUTPUTS if name in outputs), DEPTH_OUTPUTS[0])
    image = np.asarray(frame.image(output), dtype=float)
    path = frame.dataset.path(frame.index, output)
    if image.shape != (camera.height, camera.width):
        raise size_error(path, (camera.height, camera.width), image.shape)
    if not (image >= 0).all():
        # Written so that nan fails too.
        raise InputError(path, "must hold depths from 0 metres, inf for none")
    distance = image if output == "distance" else image / camera.pixel_directions()[..., 2]
    return RangeImage(camera, distance, depth_unit_m(frame))


def read_colour(frame: DatasetFrame, surface: RangeImage) -> NDArray[np.uint8]:
    """The photograph `(h, w, 3)` of a frame; raises `InputError` if it has another size than its surface."""
    colour: NDArray[np.uint8] = frame.image("colour")
    if colour.shape[:2] != surface.distance.shape:
        path = frame.dataset.path(frame.index, "colour")
        raise size_error(path, surface.distance.shape, colour.shape)
    return colour


def read_label(frame: DatasetFrame, output: str, surface: RangeImage) -> NDArray[Any]:
    """A label image `(h, w)` of a frame; raises `InputError` if it has another size than its surface."""
    image: NDArray[Any] = frame.image(output)
    if image.shape != surface.distance.shape:
        raise size_error(frame.dataset.path(frame.index, output), surface.distance.shape, image.shape)
    return image


def valid_pixels(frame: DatasetFrame, surface: RangeImage) -> NDArray[np.bool_]:
    """`(h, w)` whether training may use a pixel; the output `class` says which are ignored."""
    return np.asarray(read_label(frame, "class", surface) != IGNORE_CLASS)


def mask_png(frame: DatasetFrame, surface: RangeImage) -> bytes:
    """A PNG of 8 bits: 0 for ignored pixels, 255 for others."""
    return png_bytes(np.where(valid_pixels(frame, surface), np.uint8(255), np.uint8(0)))


def size_error(path: Path, expected: tuple[int, ...], found: tuple[int, ...]) -> InputError:
    """The error of an image of another size, in rows and columns, than its camera has."""
    wanted = f"{expected[1]} x {expected[0]} pixels, as the frame's camera"
    return InputError(path, f"must have {wanted}, not {found[1]} x {found[0]}")


@dataclass(frozen=True, eq=False)
class SeedPoints:
    """Points on the surfaces of a scene.

    Attributes:
        position: `(n, 3)` world metres, whole micrometres.
        colour: `(n, 3)` uint8, of the pixel in which a point was found.
    """

    position: NDArray[np.float64]
    colour: NDArray[np.uint8]


def seed_points(frames: Sequence[DatasetFrame], count: int, *, skip_ignored: bool) -> SeedPoints:
    """Pixels with a surface, drawn evenly from the frames of a scene; the same for the same frames.

    Args:
        frames: of the scene.
        count: of the points; fewer if there are fewer pixels.
        skip_ignored: whether frames can have ignored pixels, which have no points then.
    """
    positions, colours = [np.empty((0, 3))], [np.empty((0, 3), np.uint8)]
    for number, frame in enumerate(frames):
        surface = read_surface(frame)
        is_candidate = np.isfinite(surface.distance)
        if skip_ignored:
            is_candidate &= valid_pixels(frame, surface)
        candidates = np.flatnonzero(is_candidate)
        share = count * (number + 1) // len(frames) - count * number // len(frames)
        # By the index of the frame, so that its points do not depend on what else is exported.
        rng = np.random.default_rng(frame.index)
        chosen = np.sort(rng.choice(candidates, min(share, len(candidates)), replace=False, shuffle=False))
        rows, columns = np.unravel_index(chosen, surface.distance.shape)
        positions.append(np.round(surface.points(rows, columns), 6))
        colours.append(read_colour(frame, surface)[rows, columns])
    return SeedPoints(np.concatenate(positions), np.concatenate(colours))
