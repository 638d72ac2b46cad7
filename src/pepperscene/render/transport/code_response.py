"""How sensor noise and light appear in the 8-bit codes of an image, pixel by pixel.

Each band of a sensor with bands counts as an image of a monochrome sensor: there is no developed image.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.camera import Camera, correct_colours, electrons_per_light, pedestal

_ROWS_PIXELS: Final = 1 << 20  # chosen: pixels whose noise is computed at a time; each takes 0.2 KB meanwhile

Floats = NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class CodeResponse:
    """Appearance of sensor noise and light in each pixel of an image, root mean square over its colours."""

    noise: Floats  # `(h, w)` standard deviation, codes
    per_white: Floats  # `(h, w)` codes per unit of `SampleVariance.white`

    def squared(self, variance: Floats, limit: float) -> Floats:
        """A variance of `SampleVariance` in squared codes; deviations are limited to `limit` codes."""
        return np.square(np.minimum(self.per_white * np.sqrt(variance), np.float32(limit)))


def code_response(
    signal: Floats, white: NDArray[np.float64], camera: Camera, rows: slice = slice(None)
) -> CodeResponse:
    """Compute how noise and light appear in a camera's image, or in some `rows` of it.

    Args:
        signal: `(h, w, c)` light of these rows, electrons s-1 m-2 sr-1.
        white: `(c,)` see `SampleVariance`.
        camera: with the sensor's noise and the developing from light to codes.
        rows: of the image; all by default.
    """
    height, width, channels = signal.shape
    electrons = electrons_per_light(camera, rows).astype(np.float32)[..., None]
    matrix = None if camera.sensor.pattern == "bands" else _colour_matrix(camera)
    # By whole rows, so that intermediate results of a large image take little memory.
    noise, per_white = (np.empty((height, width), np.float32) for _ in range(2))
    # As much memory for any number of bands.
    step = max(_ROWS_PIXELS // (width * max(channels // 3, 1)), 1)
    for top in range(0, height, step):
        part = slice(top, top + step)
        noise[part], per_white[part] = _rows_response(signal[part], electrons[part], white, matrix, camera)
    return CodeResponse(noise, per_white)


def _rows_response(
    signal: Floats, electrons: Floats, white: NDArray[np.float64], matrix: Floats | None, camera: Camera
) -> tuple[Floats, Floats]:
    """Noise and codes per unit of white of some rows; `electrons` are those of a unit of light.

    Without a matrix, each channel is an image of its own, as of a monochrome sensor.
    """
    sensor = camera.sensor
    full_scale = np.float32(1.0 / (sensor.gain_e_per_dn * (sensor.full_scale_dn - sensor.black_level_dn)))
    charge = np.maximum(signal * electrons, np.float32(0.0))
    quantisation = sensor.gain_e_per_dn**2 / 12.0 if camera.developing.quantise else 0.0
    variance = (charge + np.float32(sensor.read_noise_e**2 + quantisation)) * (
        full_scale**2 / np.array(sensor.photosites, np.float32)
    )
    linear = charge * full_scale if matrix is None else (charge * full_scale) @ matrix + _lift(camera)
    slope = _tone_slope(linear, camera.developing.tone)
    # Noise above the signal itself is clipped at black, where the tone curve would be steepest.
    deviation = np.sqrt(variance if matrix is None else variance @ np.square(matrix))
    noise = deviation * _tone_slope(np.maximum(linear, deviation), camera.developing.tone)
    noise = np.sqrt(np.mean(np.square(noise), axis=-1))
    # The error has the pixel's own colour, normalised in units of white.
    colour = _normalised(signal, white) * white.astype(np.float32) * electrons * full_scale
    codes = slope * (colour if matrix is None else colour @ matrix)
    return noise, np.sqrt(np.mean(np.square(codes), axis=-1))


def _normalised(signal: Floats, white: NDArray[np.float64]) -> Floats:
    """`(..., c)` the colour of a signal in units of white, with the norm 1."""
    colour = np.maximum(signal / white.astype(np.float32), np.float32(0.0)) + np.float32(1e-12)
    colour /= np.sqrt(np.sum(np.square(colour), axis=-1, keepdims=True))
    return colour


def _colour_matrix(camera: Camera) -> Floats:
    """`(c, k)` linear part of developing: the contribution of each channel far below saturation."""
    channels = np.eye(camera.sensor.channels, dtype=np.float32)
    if not _makes_images(camera):
        return channels
    level = np.float32(1e-4)
    return correct_colours(channels[None] * level, camera)[0] / level / np.float32(1.0 + pedestal(camera))


def _lift(camera: Camera) -> np.float32:
    """Linear value of black."""
    lifted = pedestal(camera) if _makes_images(camera) else 0.0
    return np.float32(lifted / (1.0 + lifted))


def _makes_images(camera: Camera) -> bool:
    """Whether there is a white balance; otherwise the camera gives electrons and no images."""
    return camera.developing.white_balance != "flash" or camera.flash is not None


def _tone_slope(linear: Floats, tone: str) -> Floats:
    """Codes per linear value. The curve is extended above white, because electrons are an output as well."""
    if tone != "srgb":
        return np.full(linear.shape, np.float32(255.0))
    value = np.maximum(linear, np.float32(0.0031308))
    slope = np.float32(255.0 * 1.055 / 2.4) * value ** np.float32(1.0 / 2.4 - 1.0)
    slope[linear <= 0.0031308] = 255.0 * 12.92
    return slope
