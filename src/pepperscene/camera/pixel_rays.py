"""The pixels of a lens and a sensor: pinhole matrix, rays through pixels, and limits of the field of view.

Arrays of whole images are shared by all cameras with this lens and sensor, at any pose. The sensor of a line
scanner is its line, `Sensor.line`, whose rays are the same in all rows of the image.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pepperscene.camera.optics.lens import Lens
from pepperscene.camera.sensor.rows import is_whole, row_strips
from pepperscene.camera.sensor.sensor import Sensor
from pepperscene.errors import InputError

_WIDEST_DEG: Final = 85.0
"""Field angle of an image's corner. Chosen: images of the widest lenses that keep lines straight end at 68
degrees, and a straight projection has no image at 90."""
_MAX_FOCAL_PX: Final = 1e6
"""Focal length in pixels. Chosen: rays in single precision are exact to 6e-8, a sixteenth of such a pixel,
and light waves blur it through any lens of less than half a metre."""


def intrinsics_matrix(lens: Lens, sensor: Sensor) -> NDArray[np.float64]:
    """`(3, 3)` pinhole matrix in image pixels."""
    fx = lens.focal_length_m / sensor.pixel_pitch_m
    right, down = (length / sensor.pixel_pitch_m for length in lens.principal_offset_m)
    fy = fx * lens.fy_over_fx
    return np.array([[fx, 0, sensor.columns / 2 + right], [0, fy, sensor.rows / 2 + down], [0, 0, 1.0]])


def _sensor_slopes(lens: Lens, sensor: Sensor, u: ArrayLike, v: ArrayLike) -> NDArray[np.float64]:
    """Slopes on the sensor `(rows, columns, 2)`, distortion included, on a grid of pixel coordinates."""
    matrix = intrinsics_matrix(lens, sensor)
    return np.asarray((np.stack(np.meshgrid(u, v), axis=-1) - matrix[:2, 2]) / matrix[[0, 1], [0, 1]])


def _undistorted_slopes(lens: Lens, sensor: Sensor, u: ArrayLike, v: ArrayLike) -> NDArray[np.float64]:
    """Undistorted slopes `(rows, columns, 2)` on a grid of pixel coordinates.

    Raises:
        InputError: the lens and the sensor do not fit together.
    """
    try:
        return lens.distortion.undistort(_sensor_slopes(lens, sensor, u, v))
    except ValueError as error:
        allowed = f"must be invertible over the whole image of {sensor.name}, but {error}"
        value = lens.distortion.to_json()
        raise InputError(lens.name, allowed, key="distortion", value=value) from None


@lru_cache(maxsize=8)
def check_field(lens: Lens, sensor: Sensor) -> None:
    """Check early, on a coarse grid, the field of view, and that the distortion can be inverted.

    Raises:
        InputError: the lens and the sensor do not fit together.
    """
    value = 1e3 * lens.focal_length_m
    focal_px = lens.focal_length_m / sensor.pixel_pitch_m * max(lens.fy_over_fx, 1.0)
    if focal_px > _MAX_FOCAL_PX:
        pitch = f"pixels of {sensor.name}, {1e6 * sensor.pixel_pitch_m:g} um wide"
        problem = f"is {focal_px:.3g} {pitch}; at most {_MAX_FOCAL_PX:g} are allowed"
        raise InputError(lens.name, problem, key="focal_length_mm", value=value)
    u, v = np.linspace(0, sensor.columns, 33), np.linspace(0, sensor.rows, 33)
    # Both on the sensor and in the scene, which differ by the distortion.
    for slopes_of in (_sensor_slopes, _undistorted_slopes):
        slopes = slopes_of(lens, sensor, u, v)
        angle = math.degrees(math.atan(float(np.linalg.norm(slopes, axis=-1).max())))
        if angle > _WIDEST_DEG:
            problem = (
                f"gives {sensor.name} a corner at {angle:.1f} degrees from the optical axis; "
                f"at most {_WIDEST_DEG:g} are allowed"
            )
            raise InputError(lens.name, problem, key="focal_length_mm", value=value)


@lru_cache(maxsize=8)
def pixel_slopes(lens: Lens, sensor: Sensor, shift: float) -> NDArray[np.float64]:
    """Undistorted slopes of pixel corners `(h + 1, w + 1, 2)`, shift 0, or centres `(h, w, 2)`, shift 0.5."""
    extra = 1 if shift == 0 else 0
    u, v = np.arange(sensor.columns + extra) + shift, np.arange(sensor.rows + extra) + shift
    slopes = _undistorted_slopes(lens, sensor, u, v)
    slopes.setflags(write=False)
    return slopes


def corner_slopes(lens: Lens, sensor: Sensor, rows: slice | None = None) -> NDArray[np.float64]:
    """Undistorted slopes of pixel corners in all or some of the h + 1 rows of corners, `(n, w + 1, 2)`.

    Read-only; those of some rows of a large image are computed anew.
    """
    if rows is None or is_whole(sensor.columns, sensor.rows):
        slopes = pixel_slopes(lens, sensor, 0.0)
        return slopes if rows is None else slopes[rows]
    return _undistorted_slopes(lens, sensor, np.arange(sensor.columns + 1), np.arange(sensor.rows + 1)[rows])


@lru_cache(maxsize=8)
def border_slopes(lens: Lens, sensor: Sensor) -> tuple[NDArray[np.float64], ...]:
    """Undistorted slopes of the pixel corners along each border: top and bottom `(w + 1, 2)`, left and right
    `(h + 1, 2)`; read-only.
    """
    if is_whole(sensor.columns, sensor.rows):
        slopes = pixel_slopes(lens, sensor, 0.0)
        return slopes[0], slopes[-1], slopes[:, 0], slopes[:, -1]
    u, v = np.arange(sensor.columns + 1), np.arange(sensor.rows + 1)
    top, bottom = _undistorted_slopes(lens, sensor, u, v[[0, -1]])
    left, right = np.moveaxis(_undistorted_slopes(lens, sensor, u[[0, -1]], v), 1, 0)
    borders = top, bottom, left, right
    for border in borders:
        border.setflags(write=False)
    return borders


@lru_cache(maxsize=8)
def slope_limits(lens: Lens, sensor: Sensor) -> NDArray[np.float64]:
    """`(2, 2)` the least and the largest undistorted slopes (x/z, y/z) of all pixel corners; read-only."""
    limits = []
    for rows in row_strips(sensor.columns + 1, sensor.rows + 1):
        slopes = corner_slopes(lens, sensor, rows).reshape(-1, 2)
        limits += [slopes.min(axis=0), slopes.max(axis=0)]
    result = np.array([np.min(limits, axis=0), np.max(limits, axis=0)])
    result.setflags(write=False)
    return result


def centre_directions(lens: Lens, sensor: Sensor, rows: slice | None = None) -> NDArray[np.float64]:
    """`(n, w, 3)` unit directions in camera axes of the rays through the pixel centres of all or some rows.

    Read-only; those of some rows of a large image are computed anew.
    """
    if rows is None or is_whole(sensor.columns, sensor.rows):
        return _image_directions(lens, sensor)[rows or slice(None)]
    u, v = np.arange(sensor.columns) + 0.5, np.arange(sensor.rows)[rows] + 0.5
    return _directions(_undistorted_slopes(lens, sensor, u, v))


@lru_cache(maxsize=8)
def _image_directions(lens: Lens, sensor: Sensor) -> NDArray[np.float64]:
    return _directions(pixel_slopes(lens, sensor, 0.5))


def _directions(slopes: NDArray[np.float64]) -> NDArray[np.float64]:
    directions = np.concatenate([slopes, np.ones((*slopes.shape[:2], 1))], axis=-1)
    directions /= np.linalg.norm(directions, axis=-1, keepdims=True)
    directions.setflags(write=False)
    return directions
