"""The image that a camera would take with any exposure and gain, predicted from reduced images of its light.

The mean grey of a reduced image is too bright, because the tone curve raises means of bright and dark: by 3
to 9 % in images of plants of 120 x 90 pixels. The excess grows with the size of the pixels, as the fraction
of them with an edge inside does. So it is measured once more, with pixels twice as large, and extrapolated to
the size of the camera's own pixels, which leaves 1 to 2 %. The share of saturated pixels likewise: means hide
small highlights.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from functools import cache, lru_cache
from typing import Final, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pepperscene.camera.camera import Camera
from pepperscene.camera.image.electrons import add_stray_light, expected_electrons
from pepperscene.camera.image.expected_image import expected_image
from pepperscene.camera.sensor.readout import block_means
from pepperscene.camera.sensor.sensor import Sensor

Metering = Literal["average", "centre", "subject", "highlights"]
Floats = NDArray[np.float64]

SUBJECT_METERINGS: Final = frozenset({"subject", "highlights"})
"""Those that need to know which pixels show the subject, and the share of them that is saturated."""

_CENTRE_WIDTH: Final = 0.25
"""Standard deviation of the centre's weights, over the width and the height of the image. Chosen: half of the
weight is then on the middle quarter of the area."""
_PIXELS: Final = 320 * 240
"""Of a reduced image. Chosen: in three views of `randomised` by daylight, full of small leaves, the predicted
grey is up to 4 % off with 160 x 120 pixels, and 1.6 % with 320 x 240, which take 0.2 to 0.5 s longer."""
_SATURATED: Final = 250 / 255
"""Expected value from which a colour counts as saturated. Chosen: 4 % of the light below the last code, for
noise and for detail that the reduced image does not show."""


class Reading(NamedTuple):
    """What metering reads off a predicted image, over its weighted pixels."""

    grey: float  # mean code
    saturated: float  # share with a saturated colour; 0 unless the metering needs it


MeterReading = Callable[[float, float, float], Reading]
"""The reading of an exposure time, a gain, and a factor of the light."""


def metering_camera(camera: Camera, size: tuple[int, int] | None = None) -> Camera:
    """The same camera with few large pixels, which need no demosaicing.

    It serves rays and fall-off only: its photosites are larger than the camera's, and collect more light.

    Args:
        camera: the camera.
        size: columns and rows of the reduced image; None for about as many pixels as 320 x 240 with the
            aspect of the camera, and at most the camera's own.
    """
    if size is None:
        factor = max(1.0, math.sqrt(camera.width * camera.height / _PIXELS))
        # Rounded down, so that the field of view does not exceed that of the camera.
        columns, rows = (max(1, math.floor(n / factor + 1e-9)) for n in (camera.width, camera.height))
        size = columns, rows
    return dataclasses.replace(camera, sensor=_metering_sensor(camera.sensor, *size))


@lru_cache(maxsize=8)
def _metering_sensor(sensor: Sensor, columns: int, rows: int) -> Sensor:
    """One sensor for all frames, so that what is computed once per sensor is."""
    binning = 1 if sensor.pattern in ("mono", "bands") else 2
    pitch_m = sensor.pixel_pitch_m * min(sensor.columns / columns, sensor.rows / rows) / binning
    return dataclasses.replace(
        sensor, columns=columns, rows=rows, binning=binning, pitch_m=pitch_m, reduction=None
    )


def image_meter(
    camera: Camera, daylight: Floats, flash: Floats, metering: Metering, subject: Floats | None = None
) -> MeterReading:
    """The readings of the camera's image, from reduced images of the light.

    `metering` says how pixels are weighted, and whether saturated ones are counted. The other arguments are
    those of `choose_exposure`.
    """
    if daylight.shape != flash.shape or daylight.ndim != 3:
        shapes = f"{daylight.shape} and {flash.shape}"
        raise ValueError(f"daylight and flash must be images (h, w, c) of one shape, not {shapes}")
    if camera.flash is None and flash.any():
        raise ValueError("light of a flash needs a camera with a flash")
    rows, columns, _ = daylight.shape
    if subject is not None and subject.shape != (rows, columns):
        raise ValueError(f"subject must be an image ({rows}, {columns}), not {subject.shape}")
    small = dataclasses.replace(metering_camera(camera, (columns, rows)), exposure_s=1.0)
    # Electrons per second in a photosite of the camera itself, not in the large ones.
    area = (camera.sensor.pitch_m / small.sensor.pitch_m) ** 2
    daylight, flash = (expected_electrons(light, small) * area for light in (daylight, flash))
    # The rows of a rolling shutter that see the flash depend on the exposure, and so does its stray light.
    if camera.developing.stray_light and not _has_flash_fractions(camera):
        daylight, flash = (np.asarray(add_stray_light(light, small), float) for light in (daylight, flash))

    counts, weights = metering in SUBJECT_METERINGS, _weights(rows, columns, metering, subject)
    fine = _read_image(camera, daylight, flash, weights, counts)
    size = small.sensor.pixel_pitch_m / camera.sensor.pixel_pitch_m
    if size <= 1.0 or min(rows, columns) < 2:
        return cache(fine)
    if subject is not None:
        subject = block_means(subject, 2)
    weights = _weights(rows // 2, columns // 2, metering, subject)
    coarse = _read_image(camera, block_means(daylight, 2), block_means(flash, 2), weights, counts)

    def read(exposure_s: float, gain: float, factor: float) -> Reading:
        # The excess is proportional to the size of the pixels, and 0 at the camera's own.
        pairs = zip(fine(exposure_s, gain, factor), coarse(exposure_s, gain, factor), strict=True)
        return Reading(*(max(one - (size - 1.0) / size * (other - one), 0.0) for one, other in pairs))

    # Limits of exposure and gain, and what is found, are read again.
    return cache(read)


def _read_image(
    camera: Camera, daylight: Floats, flash: Floats, weights: Floats, counts_saturated: bool
) -> MeterReading:
    """The readings of developed images of electrons per second `(h, w, c)`, by the camera's developing."""
    rows, columns, _ = daylight.shape
    small = metering_camera(camera, (columns, rows))
    pulse_s = 0.0 if camera.flash is None else camera.flash.pulse_s
    # Pixels without weight, which are most of those of a small subject, need no codes.
    used = slice(None) if weights.all() else weights > 0
    weights = weights[used]

    def read(exposure_s: float, gain: float, factor: float) -> Reading:
        flashed = flash * min(pulse_s, exposure_s)
        if _has_flash_fractions(camera):
            flashed = flashed * _flash_fractions(camera, exposure_s, rows)[:, None, None]
        electrons = daylight * exposure_s + flashed
        if _has_flash_fractions(camera) and camera.developing.stray_light:
            electrons = np.asarray(add_stray_light(electrons, small), float)
        sensor = camera.sensor if gain == camera.sensor.gain else camera.sensor.with_settings(gain=gain)
        codes = expected_image(factor * electrons[used], dataclasses.replace(camera, sensor=sensor))
        grey = 255.0 * float((weights[..., None] * codes).sum(dtype=np.float64)) / codes.shape[-1]
        is_saturated = counts_saturated and codes.max(axis=-1) >= _SATURATED
        return Reading(grey, float((weights * is_saturated).sum()))

    return read


def _has_flash_fractions(camera: Camera) -> bool:
    """Whether some rows can see less of the flash than others."""
    return camera.flash is not None and camera.sensor.line_time_s > 0


def _flash_fractions(camera: Camera, exposure_s: float, rows: int) -> Floats:
    """`(h,)` means over the rows of a reduced image of `Shutter.flash_fraction` at an exposure time."""
    pulse_s = 0.0 if camera.flash is None else camera.flash.pulse_s
    share = dataclasses.replace(camera.shutter, exposure_s=exposure_s).flash_fraction(pulse_s)
    # Differences of the integral, as a row of the reduced image need not be a whole number of rows.
    integral = np.concatenate([[0.0], np.cumsum(share)])
    borders = np.interp(np.linspace(0.0, camera.height, rows + 1), np.arange(camera.height + 1), integral)
    return np.asarray(np.diff(borders) * (rows / camera.height))


def _weights(rows: int, columns: int, metering: Metering, subject: Floats | None) -> Floats:
    """`(h, w)` weights of the pixels, with the sum 1; equal ones for a subject that is not in the image."""
    if metering in SUBJECT_METERINGS and subject is not None and subject.any():
        return np.asarray(subject / subject.sum())
    if metering != "centre":
        return np.full((rows, columns), 1.0 / (rows * columns))
    down, right = ((np.arange(n) + 0.5) / n - 0.5 for n in (rows, columns))
    weights = np.exp(-0.5 * (down[:, None] ** 2 + right**2) / _CENTRE_WIDTH**2)
    return np.asarray(weights / weights.sum())
