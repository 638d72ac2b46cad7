"""Automatic exposure: the exposure time, and then the gain, that give an image the wanted mean grey.

Daylight adds to an image for as long as it is exposed, the flash only during its pulse, and with a rolling
shutter only to the rows that are exposed then. So two small images of the light, one of each, predict the
grey of the developed image for every exposure and gain: with the lens' stray light, the pedestal, and the
noise of the sensor, without which dark images would be predicted too dark.

The mean grey of a reduced image is too bright, because the tone curve raises means of bright and dark: by 3
to 9 % in images of plants of 120 x 90 pixels. The excess grows with the size of the pixels, as the fraction
of them with an edge inside does. So it is measured once more, with pixels twice as large, and extrapolated to
the size of the camera's own pixels, which leaves 1 to 2 %.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import Final, Literal, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pepperscene.camera.camera import Camera
from pepperscene.camera.image.electrons import add_stray_light, expected_electrons
from pepperscene.camera.image.expected_image import expected_image
from pepperscene.camera.sensor.sensor import Sensor
from pepperscene.errors import InputError

Metering = Literal["average", "centre"]
ExposureLimit = Literal["shortest exposure", "longest exposure and gain", "saturation", "no light"]
Floats = NDArray[np.float64]
GreyOf = Callable[[float, float, float], float]
"""The mean grey of an exposure time, a gain, and a factor of the light."""

_TOLERANCE: Final = 1e-3
"""Relative error of the grey at which the search stops. Chosen: a tenth of a code at the usual grey."""
_MOST_STEPS: Final = 60  # chosen: halves any range of exposures to the resolution of double precision
_MORE_LIGHT: Final = 2.0  # chosen: an image that so much more light leaves as it is shows what is saturated
_CENTRE_WIDTH: Final = 0.25
"""Standard deviation of the centre's weights, over the width and the height of the image. Chosen: half of the
weight is then on the middle quarter of the area."""
_PIXELS: Final = 320 * 240
"""Of a reduced image. Chosen: in three views of `randomised` by daylight, full of small leaves, the predicted
grey is up to 4 % off with 160 x 120 pixels, and 1.6 % with 320 x 240, which take 0.2 to 0.5 s longer."""


@dataclass(frozen=True)
class ExposureControl:
    """What automatic exposure aims at, and the settings that it may use.

    The exposure time is chosen first; the gain is raised only if the longest exposure is too dark. The lowest
    gain is the camera's own.

    Attributes:
        target_grey: mean of the 8-bit codes of the developed image, over pixels and colours, in (0, 255];
            of a sensor with bands, which develops no image, 255 times the mean signal as a fraction of full
            scale, over pixels and bands. The default is chosen: near the middle of the codes, with a margin
            for highlights.
        shortest_s, longest_s: range of exposure times. The defaults are chosen: electronic shutters are
            rarely faster than 10 us, and in 10 ms a camera at walking pace moves by a centimetre.
        most_gain: highest gain of the sensor's amplifier, at least 1. The default is chosen: 12 dB.
        metering: "average" gives all pixels the same weight, "centre" gives more to the middle.

    Raises:
        InputError: a value is out of range or unknown.
    """

    target_grey: float = 110.0
    shortest_s: float = 10e-6
    longest_s: float = 10e-3
    most_gain: float = 4.0
    metering: Metering = "average"

    def __post_init__(self) -> None:
        # Written so that nan fails too.
        if not 0 < self.target_grey <= 255:
            raise _invalid("target_grey", self.target_grey, "must be above 0 and at most 255")
        if not 0 < self.shortest_s < math.inf:
            raise _invalid("shortest_s", self.shortest_s, "must be positive and finite")
        if not self.shortest_s <= self.longest_s < math.inf:
            allowed = f"must be finite and at least shortest_s, {self.shortest_s:g}"
            raise _invalid("longest_s", self.longest_s, allowed)
        if not 1 <= self.most_gain < math.inf:
            raise _invalid("most_gain", self.most_gain, "must be finite and at least 1")
        if self.metering not in get_args(Metering):
            raise _invalid("metering", self.metering, f"must be one of {', '.join(get_args(Metering))}")


def _invalid(key: str, value: object, allowed: str) -> InputError:
    return InputError("exposure_control", allowed, key=key, value=value)


@dataclass(frozen=True)
class ChosenExposure:
    """Settings chosen by automatic exposure.

    Attributes:
        exposure_s: exposure time.
        gain: of the sensor's amplifier.
        grey: predicted mean of the image's codes, weighted as the metering says.
        limited_by: why the grey is not the target; None if it is. "saturation": more light would not make the
            image brighter; then the exposure is the shortest that gives this grey. "shortest exposure": also
            the shortest with which a rolling shutter exposes all rows to the flash, if that is too bright.
    """

    exposure_s: float
    gain: float
    grey: float
    limited_by: ExposureLimit | None = None


def choose_exposure(
    camera: Camera, daylight: ArrayLike, flash: ArrayLike, control: ExposureControl
) -> ChosenExposure:
    """Choose the exposure time and gain with which the developed image has the wanted mean grey.

    Deterministic: found by bisection, to 0.1 % of the grey.

    Args:
        camera: its optics, sensor, flash and developing; its exposure has no effect.
        daylight: `(h, w, c)` constant light of a reduced image over the camera's whole field of view, in the
            unit of the signal of `expected_electrons`.
        flash: `(h, w, c)` the same of the flash while it is on; zeros without a flash.
        control: the wanted grey and the allowed settings.

    Raises:
        InputError: the camera's own gain is above the highest allowed, or its sensor cannot distinguish
            colours under the reference light.
        ValueError: the images' shapes do not fit, light is not finite, the flash has light and the camera has
            no flash, or the white balance needs a missing flash.
    """
    lowest = camera.sensor.gain
    if lowest > control.most_gain:
        raise _invalid("most_gain", control.most_gain, f"must be at least the camera's own gain, {lowest:g}")
    grey_at = _grey_predictor(camera, np.asarray(daylight, float), np.asarray(flash, float), control.metering)
    longest, most = control.longest_s, control.most_gain

    # A target that no setting reaches.
    brightest = grey_at(longest, most, 1.0)
    target = control.target_grey
    limit: ExposureLimit | None = None
    if not (np.any(daylight) or np.any(flash)):
        return ChosenExposure(longest, most, brightest, "no light")
    if brightest < target * (1.0 - _TOLERANCE):
        # What light adds to the grey of black, which is not 0.
        added = brightest - grey_at(longest, most, 0.0)
        if grey_at(longest, most, _MORE_LIGHT) - brightest >= _TOLERANCE * added:
            return ChosenExposure(longest, most, brightest, "longest exposure and gain")
        target, limit = brightest * (1.0 - _TOLERANCE), "saturation"

    # The exposure time first, then the gain.
    def grey_of_exposure(exposure_s: float) -> float:
        return grey_at(exposure_s, lowest, 1.0)

    def grey_of_gain(gain: float) -> float:
        return grey_at(longest, gain, 1.0)

    gain = lowest
    if grey_of_exposure(longest) < target * (1.0 - _TOLERANCE):
        exposure_s, (gain, grey) = longest, _search(grey_of_gain, lowest, most, target)
    else:
        exposure_s, grey = _search(grey_of_exposure, control.shortest_s, longest, target)
    if grey > control.target_grey * (1.0 + _TOLERANCE):
        limit = "shortest exposure"
    return ChosenExposure(exposure_s, gain, grey, limit)


def with_exposure(camera: Camera, chosen: ChosenExposure) -> Camera:
    """The same camera with the chosen exposure time and gain."""
    sensor = camera.sensor
    if chosen.gain != sensor.gain:
        sensor = sensor.with_settings(gain=chosen.gain)
    return dataclasses.replace(camera, sensor=sensor, exposure_s=chosen.exposure_s)


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


def _grey_predictor(camera: Camera, daylight: Floats, flash: Floats, metering: Metering) -> GreyOf:
    """The mean grey of the camera's image, from reduced images of the light."""
    if daylight.shape != flash.shape or daylight.ndim != 3:
        shapes = f"{daylight.shape} and {flash.shape}"
        raise ValueError(f"daylight and flash must be images (h, w, c) of one shape, not {shapes}")
    if camera.flash is None and flash.any():
        raise ValueError("light of a flash needs a camera with a flash")
    rows, columns, _ = daylight.shape
    small = dataclasses.replace(metering_camera(camera, (columns, rows)), exposure_s=1.0)
    # Electrons per second in a photosite of the camera itself, not in the large ones.
    area = (camera.sensor.pitch_m / small.sensor.pitch_m) ** 2
    daylight, flash = (expected_electrons(light, small) * area for light in (daylight, flash))
    # The rows of a rolling shutter that see the flash depend on the exposure, and so does its stray light.
    if camera.developing.stray_light and not _has_flash_fractions(camera):
        daylight, flash = (np.asarray(add_stray_light(light, small), float) for light in (daylight, flash))

    fine = _mean_grey(camera, daylight, flash, metering)
    size = small.sensor.pixel_pitch_m / camera.sensor.pixel_pitch_m
    if size <= 1.0 or min(rows, columns) < 2:
        return fine
    coarse = _mean_grey(camera, _half_resolution(daylight), _half_resolution(flash), metering)

    def grey_at(exposure_s: float, gain: float, factor: float) -> float:
        # The excess is proportional to the size of the pixels, and 0 at the camera's own.
        grey = fine(exposure_s, gain, factor)
        excess = (size - 1.0) / size * (coarse(exposure_s, gain, factor) - grey)
        return max(grey - excess, 0.0)

    return grey_at


def _half_resolution(image: Floats) -> Floats:
    """Means of 2 x 2 pixels, without the last row or column if there is an odd number."""
    rows, columns = (n // 2 for n in image.shape[:2])
    blocks = image[: 2 * rows, : 2 * columns].reshape(rows, 2, columns, 2, -1)
    return np.asarray(blocks.mean(axis=(1, 3)))


def _mean_grey(camera: Camera, daylight: Floats, flash: Floats, metering: Metering) -> GreyOf:
    """The mean grey of developed images of electrons per second `(h, w, c)`, by the camera's developing."""
    rows, columns, _ = daylight.shape
    small = metering_camera(camera, (columns, rows))
    pulse_s = 0.0 if camera.flash is None else camera.flash.pulse_s
    weights = _weights(rows, columns, metering)[..., None]

    def grey_at(exposure_s: float, gain: float, factor: float) -> float:
        flashed = flash * min(pulse_s, exposure_s)
        if _has_flash_fractions(camera):
            flashed = flashed * _flash_fractions(camera, exposure_s, rows)[:, None, None]
        electrons = daylight * exposure_s + flashed
        if _has_flash_fractions(camera) and camera.developing.stray_light:
            electrons = np.asarray(add_stray_light(electrons, small), float)
        sensor = camera.sensor if gain == camera.sensor.gain else camera.sensor.with_settings(gain=gain)
        codes = expected_image(factor * electrons, dataclasses.replace(camera, sensor=sensor))
        return 255.0 * float((weights * codes).sum(dtype=np.float64)) / codes.shape[-1]

    return grey_at


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


def _weights(rows: int, columns: int, metering: Metering) -> Floats:
    """`(h, w)` weights of the pixels, with the sum 1."""
    if metering == "average":
        return np.full((rows, columns), 1.0 / (rows * columns))
    down, right = ((np.arange(n) + 0.5) / n - 0.5 for n in (rows, columns))
    weights = np.exp(-0.5 * (down[:, None] ** 2 + right**2) / _CENTRE_WIDTH**2)
    return np.asarray(weights / weights.sum())


def _search(grey_of: Callable[[float], float], low: float, high: float, target: float) -> tuple[float, float]:
    """The value in [low, high] whose grey is the target, and its grey; `low` if even that is too bright."""
    grey = grey_of(low)
    if grey >= target:
        return low, grey
    for _ in range(_MOST_STEPS):
        middle = math.sqrt(low * high)
        grey = grey_of(middle)
        if abs(grey - target) <= _TOLERANCE * target:
            return middle, grey
        low, high = (middle, high) if grey < target else (low, middle)
    # The grey jumps over the target: that of a rolling shutter does where all rows begin to see the flash.
    return high, grey_of(high)
