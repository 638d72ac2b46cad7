"""The pixels of a lens and a sensor: pinhole matrix, rays through pixels, and limits of the field of view.

Arrays are shared by all cameras with this lens and sensor, at any pose.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pepperscene.camera.lens import Lens
from pepperscene.camera.sensor import Sensor
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
    if sensor.line_scan:
        check_field(lens, sensor.line)
        return
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
    """Undistorted slopes of pixel corners `(h + 1, w + 1, 2)`, shift 0, or centres `(h, w, 2)`, shift 0.5.

    Those of a line scanner are the same in all rows of its image, and returned for one: h is 1.
    """
    if sensor.line_scan:
        return pixel_slopes(lens, sensor.line, shift)
    extra = 1 if shift == 0 else 0
    u, v = np.arange(sensor.columns + extra) + shift, np.arange(sensor.rows + extra) + shift
    slopes = _undistorted_slopes(lens, sensor, u, v)
    slopes.setflags(write=False)
    return slopes


@lru_cache(maxsize=8)
def centre_directions(lens: Lens, sensor: Sensor) -> NDArray[np.float64]:
    """`(h, w, 3)` unit directions in camera axes of the rays through the pixel centres; read-only."""
    slopes = pixel_slopes(lens, sensor, 0.5)
    directions = np.concatenate([slopes, np.ones((*slopes.shape[:2], 1))], axis=-1)
    directions /= np.linalg.norm(directions, axis=-1, keepdims=True)
    directions.setflags(write=False)
    # The line of a line scanner looks in the same directions at all times.
    return (
        np.broadcast_to(directions, (sensor.rows, *directions.shape[1:])) if sensor.line_scan else directions
    )
