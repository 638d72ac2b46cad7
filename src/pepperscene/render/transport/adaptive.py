"""Where to stop: as soon as the light's own error hides behind the sensor's noise in the picture.

Errors and noise are weighed as they show: in 8-bit codes of the developed picture, root mean square over the
picture. Well-spread samples of edges and half-shadows do better than independent ones: an edge through a
pixel cuts some sqrt(n) of n cells, which makes the variance of the mean

    V(n) = GAIN s^2 n^(-3/2)

with the variance s^2 of a single sample (Mitchell 1996, "Consequences of stratified sampling in graphics").
The sum of V over all pixels is least, for a given number of samples, where n^(5/2) goes with s^2; that number
is what the target asks for. s^2 is taken from the pixel's samples and its neighbours', as four samples may
all miss an edge that the next pixel shows.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.camera import Camera, correct_colours, expected_electrons
from pepperscene.render.transport.accumulate import SampleAccumulator, TracedLight

GAIN: Final = 0.8
"""Of the law above, measured on `barth2018`: .4 for 4, .5 for 8 samples in every pixel, .7 to .9 where
samples go to where they are needed."""
SOFT_LEFT: Final = 0.15
"""Share of the soft light's standard error that the denoiser leaves: .14 to .17 for 2 and 4 samples."""
_GROWTH: Final = 4  # chosen: of a pixel's samples from one look at it to the next
_ASKED: Final = 1 << 14  # chosen: pixels that the sum is worked out for

_WORST: Final = 127.5
"""Codes: the error of a pixel that may be anything. Beside the sun the slope of the tone curve would tell of
thousands."""
_WIDEST: Final = 510.0  # chosen: codes by which samples differ that show black and what is blown out

Floats = NDArray[np.float32]


class AdaptiveSampler:
    """Decides how many samples each pixel of a frame needs, and tells what came of it.

    Args:
        camera: whose picture it is.
        target: error over noise, root mean square in codes; None where nothing is to be decided.
        most: samples a pixel.
        denoised: whether soft light will be filtered.
    """

    def __init__(self, camera: Camera, target: float | None, most: int, *, denoised: bool) -> None:
        self.camera, self.target, self.most, self.denoised = camera, target, most, denoised
        self._shown: Shown | None = None

    def wanted(self, there: SampleAccumulator) -> NDArray[np.int32]:
        """`(h w,)` samples that each pixel should have by now."""
        if self.target is None:
            return there.samples
        # How light shows in the picture is clear enough from the first look.
        shows = self._shows(there.total(), there.white)
        spread = _in_codes(_nearby(there.sharp_variance()), shows, _WIDEST)
        soft = float(np.mean(_in_codes(there.soft_variance(), shows, _WIDEST))) * self._left
        # What soft light leaves of the error is the sharp light's; half of it, where soft light takes more.
        allowed = self.target**2 * float(np.mean(np.square(shows.noise)))
        allowed = max(allowed - soft / there.soft_samples, 0.5 * allowed)
        now = there.samples
        most = np.minimum(now * _GROWTH, np.maximum(self.most, now))
        return np.clip(self._shared_out(spread.ravel(), allowed), now, most).astype(np.int32)

    def achieved(self, light: TracedLight) -> dict[str, Any]:
        """What a frame's JSON says of its samples and their error."""
        spread, shows = light.spread, self._shows(light.total(), light.spread.white)
        variance = GAIN * _nearby(spread.sharp) * spread.samples.astype(np.float32) ** np.float32(-1.5)
        variance += spread.soft * np.float32(self._left / max(spread.soft_samples, 1))
        error, noise = _in_codes(variance, shows, _WORST), np.square(shows.noise)
        rms_error, rms_noise = (float(np.sqrt(part.mean())) for part in (error, noise))
        return {
            "target": self.target,
            "samples_per_pixel": float(spread.samples.mean()),
            "soft_samples_per_pixel": spread.soft_samples,
            "error_codes": rms_error,
            "noise_codes": rms_noise,
            # Where all is blown out neither shows.
            "error_to_noise": rms_error / rms_noise if rms_noise > 0.0 else 0.0,
            "below_half_of_noise": float((error <= 0.25 * noise).mean()),
        }

    @property
    def _left(self) -> float:
        return SOFT_LEFT**2 if self.denoised else 1.0

    def _shows(self, signal: Floats, white: NDArray[np.float64]) -> Shown:
        if self._shown is None:
            self._shown = shown(signal, white, self.camera)
        return self._shown

    def _shared_out(self, spread: Floats, allowed: float) -> NDArray[np.float32]:
        """Powers of two whose mean variance is as allowed, for the least samples."""
        # An odd step does not follow the columns of a picture, whose widths are even.
        some = spread[:: spread.size // _ASKED | 1]
        scale = _least_scale(some, allowed, self.most)
        need = np.power(np.maximum(scale * spread, 1e-9), 0.4)
        return np.exp2(np.rint(np.log2(np.clip(need, 1.0, self.most))))


def _least_scale(spread: Floats, allowed: float, most: int) -> float:
    """The factor of the variances that samples go with, by bisection of its logarithm."""
    if not spread.any():
        return 0.0
    # With one sample a pixel it is low enough, with the most in the pixel of the least spread high enough.
    low, high = -80.0, 80.0
    for _ in range(40):
        middle = 0.5 * (low + high)
        samples = np.clip(np.power(np.exp2(middle) * spread.astype(np.float64), 0.4), 1.0, most)
        enough = np.mean(GAIN * spread * samples**-1.5) <= allowed
        low, high = (low, middle) if enough else (middle, high)
    return float(np.exp2(high))


@dataclass(frozen=True, eq=False)
class Shown:
    """How noise and light show in each pixel of a picture, root mean square over its colours.

    Attributes:
        noise: `(h, w)` of the sensor, codes.
        per_white: `(h, w)` codes per unit of `SampleVariance`.
    """

    noise: Floats
    per_white: Floats


def shown(signal: Floats, white: NDArray[np.float64], camera: Camera) -> Shown:
    """How noise and light show in a camera's picture.

    Args:
        signal: `(h, w, c)` light, electrons s-1 m-2 sr-1.
        white: `(c,)` the unit of `SampleVariance`.
        camera: its sensor has the noise, and its developing makes codes of light.
    """
    sensor, c = camera.sensor, camera.sensor.channels
    per_light = expected_electrons(np.ones((camera.height, camera.width, 1)).repeat(c, -1), camera)
    electrons = per_light.astype(np.float32)
    full_scale = np.float32(1.0 / (sensor.gain_e_per_dn * (sensor.full_scale_dn - sensor.black_level_dn)))
    matrix = _developing(camera)

    charge = np.maximum(signal * electrons, np.float32(0.0))
    linear = (charge * full_scale) @ matrix
    slope = _slope(linear, camera.developing.tone)
    steps = sensor.gain_e_per_dn**2 / 12.0 if camera.developing.quantise else 0.0
    variance = (charge + np.float32(sensor.read_noise_e**2 + steps)) * (
        full_scale**2 / np.array(sensor.photosites, np.float32)
    )
    # Noise above the signal itself is cut off at black, where the tone curve would be steepest.
    deviation = np.sqrt(variance @ np.square(matrix))
    noise = deviation * _slope(np.maximum(linear, deviation), camera.developing.tone)
    noise = np.sqrt(np.mean(np.square(noise), axis=-1))
    # An error in the colour of the pixel itself, in units of white summed over the channels in squares.
    unit = white.astype(np.float32)
    colour = np.maximum(signal / unit, np.float32(0.0)) + np.float32(1e-12)
    colour /= np.sqrt(np.sum(np.square(colour), axis=-1, keepdims=True))
    in_codes = slope * ((colour * unit * electrons * full_scale) @ matrix)
    return Shown(noise, np.sqrt(np.mean(np.square(in_codes), axis=-1)))


def _developing(camera: Camera) -> Floats:
    """`(c, k)` what developing makes of each channel, as far as it is linear: far below saturation."""
    channels = np.eye(camera.sensor.channels, dtype=np.float32)
    if camera.developing.white_balance == "flash" and camera.flash is None:
        return channels  # such a camera gives electrons and no pictures
    little = np.float32(1e-4)
    return correct_colours(channels[None] * little, camera)[0] / little


def _slope(linear: Floats, tone: str) -> Floats:
    """Codes per linear value. Above white the curve is thought to go on: electrons are an output as well."""
    if tone != "srgb":
        return np.full(linear.shape, np.float32(255.0))
    value = np.maximum(linear, np.float32(0.0031308))
    power = np.float32(255.0 * 1.055 / 2.4) * value ** np.float32(1.0 / 2.4 - 1.0)
    power[linear <= 0.0031308] = 255.0 * 12.92
    return power


def _in_codes(variance: Floats, shows: Shown, most: float) -> Floats:
    """Squared codes of a variance in units of `SampleVariance`; deviations are at most `most` codes."""
    return np.square(np.minimum(shows.per_white * np.sqrt(variance), np.float32(most)))


def _nearby(spread: Floats) -> Floats:
    """Means over squares of 3x3 pixels."""
    from scipy.ndimage import uniform_filter

    # Beside a glint, running sums leave a little less than nothing.
    return np.asarray(np.maximum(uniform_filter(spread, 3, mode="nearest"), 0.0), np.float32)
