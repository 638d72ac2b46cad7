"""The camera of a recorded frame, and the surface that it shows: distances, depths and world points."""

from __future__ import annotations

from dataclasses import dataclass, field
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
from pepperscene.export.job import ImageOptions
from pepperscene.export.pinhole import PinholeImages

_REACH_PX: Final = 5.0  # chosen: beyond, the nearest whole pixel is rarely of the same organ
MILLIMETRES: Final = 1000.0  # per metre
MOST_STEPS: Final = 65_535  # of a 16-bit image


@dataclass(frozen=True, eq=False)
class ImageGeometry:
    """The camera of exported images.

    Attributes:
        camera: that of the frame, or a pinhole camera.
        pinhole: resamples the frame's images to those of a pinhole camera; None for the frame's own.
    """

    camera: Camera
    pinhole: PinholeImages | None = field(default=None, kw_only=True)

    def resample(self, image: NDArray[Any], outside: Any) -> NDArray[Any]:
        """`(h, w)` an image of the frame as the camera sees it, by the nearest pixels."""
        return image if self.pinhole is None else self.pinhole.resample(image, outside)


@dataclass(frozen=True, eq=False)
class RangeImage(ImageGeometry):
    """The surface that a frame shows.

    Attributes:
        distance: `(h, w)` metres along the rays through the pixel centres; inf where there is no surface.
    """

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


def read_geometry(frame: DatasetFrame, options: ImageOptions) -> ImageGeometry:
    """The camera of the exported images of a frame.

    Raises:
        InputError: the camera is not valid; or a pinhole is wanted, and the lens is too wide for one, or the
            rows of a moving camera have poses of their own.
    """
    camera = recorded_camera(frame)
    if not options.is_undistorted:
        return ImageGeometry(camera)
    path = frame.dataset.frame_path(frame.index)
    if camera.rows_move:
        raise InputError(path, "must not move while its rows are read, with undistort", key="camera.motion")
    try:
        pinhole = PinholeImages(camera, fills=True)
    except ValueError as error:
        raise InputError(path, f"cannot be undone, as {error}", key="camera.distortion") from None
    if pinhole.is_identity:
        return ImageGeometry(camera)
    matrix = dict(zip(("fx", "fy", "cx", "cy"), pinhole.matrix[[0, 1, 0, 1], [0, 1, 2, 2]], strict=True))
    return ImageGeometry(
        Camera.from_metadata({**frame.metadata["camera"], **matrix, "distortion": {}}), pinhole=pinhole
    )


def read_view(frame: DatasetFrame, geometry: ImageGeometry) -> RangeImage:
    """The surface of a frame as its exported images show it; raises as `read_surface`."""
    distance = geometry.resample(read_surface(frame).distance, np.inf)
    return RangeImage(geometry.camera, distance, pinhole=geometry.pinhole)


def read_surface(frame: DatasetFrame, *, allows_line_scan: bool = False) -> RangeImage:
    """The surface of a frame from its output `distance`, or else `depth_z`, seen by the frame's own camera.

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


def read_colour(frame: DatasetFrame, geometry: ImageGeometry) -> NDArray[np.uint8]:
    """The photograph `(h, w, 3)` of a frame; raises `InputError` if it has another size than its camera."""
    colour: NDArray[np.uint8] = _read_image(frame, "colour", geometry)
    return colour if geometry.pinhole is None else geometry.pinhole.resample_colour(colour)


def read_label(frame: DatasetFrame, output: str, geometry: ImageGeometry) -> NDArray[Any]:
    """An image `(h, w)` of a frame; raises `InputError` if it has another size than its camera."""
    image = _read_image(frame, output, geometry)
    return geometry.resample(image, image.dtype.type(0))


def _read_image(frame: DatasetFrame, output: str, geometry: ImageGeometry) -> NDArray[Any]:
    image: NDArray[Any] = frame.image(output)
    size = geometry.camera.height, geometry.camera.width
    if image.shape[:2] != size:
        raise size_error(frame.dataset.path(frame.index, output), size, image.shape)
    return image


def picture_png(frame: DatasetFrame, geometry: ImageGeometry, options: ImageOptions) -> bytes:
    """A PNG of the photograph, the same bytes as in the data set if nothing is changed.

    The fourth channel of a picture with one is the share of the pixel's area that shows the foreground, of
    255, by the output `coverage`, or else 255 where the pixel's centre does. Pixels that show the foreground
    in part have the colour of the nearest inside it, up to 5 pixels away.
    """
    if geometry.pinhole is None and options.cut_out is None:
        return frame.content("colour")
    colour = read_colour(frame, geometry)
    if options.cut_out is not None:
        alpha = _read_alpha(frame, geometry, options.cut_out)
        colour = np.concatenate([_without_background(colour, alpha[..., 0]), alpha], axis=-1)
    return png_bytes(colour)


def _without_background(colour: NDArray[np.uint8], alpha: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """A photograph whose mixed pixels have the colour of the nearest inside, as alpha is not premultiplied.

    Otherwise what is cut out of a bright background has a bright outline before a dark one. Pixels beside
    mixed ones are no sources, since demosaicing mixes the background into them.
    """
    from scipy.ndimage import binary_erosion, distance_transform_edt

    is_inside = binary_erosion(alpha == 255, border_value=1)
    if not is_inside.any():
        return colour
    distance, (rows, columns) = distance_transform_edt(~is_inside, return_indices=True)
    is_replaced = (alpha > 0) & (alpha < 255) & (distance <= _REACH_PX)
    return np.where(is_replaced[..., None], colour[rows, columns], colour)


def _read_alpha(frame: DatasetFrame, geometry: ImageGeometry, cut_out: frozenset[int]) -> NDArray[np.uint8]:
    """`(h, w, 1)` the fourth channel of a picture."""
    if "coverage" not in frame.metadata["outputs"]:
        return np.where(valid_pixels(frame, geometry, cut_out), np.uint8(255), np.uint8(0))[..., None]
    shares = _read_image(frame, "coverage", geometry)[..., sorted(cut_out)]
    alpha = np.rint(255.0 * shares.sum(axis=-1, keepdims=True, dtype=np.float32)).astype(np.uint8)
    return alpha if geometry.pinhole is None else geometry.pinhole.resample_colour(alpha)


def valid_pixels(
    frame: DatasetFrame, geometry: ImageGeometry, foreground: frozenset[int] | None = None
) -> NDArray[np.bool_]:
    """`(h, w)` whether the output `class` is in the foreground; for None, whether training may use it."""
    classes = read_label(frame, "class", geometry)
    if foreground is None:
        return np.asarray(classes != IGNORE_CLASS)
    return np.isin(classes, sorted(foreground))


def mask_png(frame: DatasetFrame, geometry: ImageGeometry, foreground: frozenset[int] | None) -> bytes:
    """A PNG of 8 bits: 255 for `valid_pixels`, 0 for others."""
    return png_bytes(np.where(valid_pixels(frame, geometry, foreground), np.uint8(255), np.uint8(0)))


def size_error(path: Path, expected: tuple[int, ...], found: tuple[int, ...]) -> InputError:
    """The error of an image of another size, in rows and columns, than its camera has."""
    wanted = f"{expected[1]} x {expected[0]} pixels, as the frame's camera"
    return InputError(path, f"must have {wanted}, not {found[1]} x {found[0]}")
