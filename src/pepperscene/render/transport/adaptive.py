"""Adaptive sampling: stop where the error of the light is hidden by the sensor noise in the image.

Error and noise are compared as they are visible: in 8-bit codes of the developed image, root mean square
over the image. Sensors with bands have no such image: each of their bands counts as one of a monochrome
sensor. Stratified samples of edges and penumbras do better than independent ones: an edge through a pixel
cuts about sqrt(n) of n cells, so the variance of the mean is

    V(n) = VARIANCE_GAIN s^2 n^(-3/2)

with the variance s^2 of one sample (Mitchell 1996, "Consequences of stratified sampling in graphics"). For a
given number of samples, the sum of V over all pixels is smallest where n^(5/2) is proportional to s^2; the
target sets the factor. s^2 is averaged over the pixel and its neighbours: four samples may all miss an edge
that the next pixel shows.

`CodeResponse` says how sensor noise and light appear in the codes, pixel by pixel.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.camera import Camera, correct_colours, electrons_per_light, pedestal
from pepperscene.frame import is_target_met
from pepperscene.render.transport.accumulate import SampleAccumulator, TracedLight, indirect_share

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
    if not makes_images(camera):
        return channels
    level = np.float32(1e-4)
    return correct_colours(channels[None] * level, camera)[0] / level / np.float32(1.0 + pedestal(camera))


def _lift(camera: Camera) -> np.float32:
    """Linear value of black."""
    lifted = pedestal(camera) if makes_images(camera) else 0.0
    return np.float32(lifted / (1.0 + lifted))


def makes_images(camera: Camera) -> bool:
    """Whether there is a white balance; otherwise the camera gives electrons and no images."""
    light = {"flash": camera.flash, "lamps": camera.lamp_light}
    return light.get(str(camera.developing.white_balance), camera) is not None


def _tone_slope(linear: Floats, tone: str) -> Floats:
    """Codes per linear value. The curve is extended above white, because electrons are an output as well."""
    if tone != "srgb":
        return np.full(linear.shape, np.float32(255.0))
    value = np.maximum(linear, np.float32(0.0031308))
    slope = np.float32(255.0 * 1.055 / 2.4) * value ** np.float32(1.0 / 2.4 - 1.0)
    slope[linear <= 0.0031308] = 255.0 * 12.92
    return slope


VARIANCE_GAIN: Final = 0.8
"""Of the equation above, measured on `barth2018`: .4 for 4, .5 for 8 samples in every pixel, .7 to .9 where
samples are distributed by need."""
_INDIRECT_SHARES: Final = (0.2, 0.4)
_DENOISED_ERRORS: Final = (0.15, 0.19)
"""Fraction of the standard error of indirect light after denoising, by the share of indirect light in all
light; chosen: constant outside of these shares, linear between. Measured for 2 to 16 samples: .13 to .17 in
two frames of `barth2018` by flash (share .04); .17 to .20 in two of `greenhouse` (.6) and one of `randomised`
(.4) by daylight, where fine shadows in the light of the sky are lost."""
_GATHERED_ERROR: Final = 0.22
"""The same for gathered light (`transport.gathering`), times the fourth root of the number of samples: what
the denoiser loses does not fall as the noise does. Measured on frame 0 of `greenhouse`, 400x300 pixels: .22
for 1 and for 8 samples."""
_INDIRECT_COST: Final = 18.0
"""Time of a sample of indirect light over that of a further one of direct light; measured: 15 to 23."""
_GATHERED_COST: Final = 9.0
"""The same for gathered light, the cells included; measured for two directions on frame 0 of `greenhouse`."""
_BALANCE_STEPS: Final = 3  # chosen: the next step would change the number of samples by some per cent
_GROWTH: Final = 4  # chosen: largest factor by which the samples of a pixel grow in one round
_SUBSET: Final = 1 << 14  # chosen: pixels that the scale is computed from
_MAX_ERROR: Final = 127.5
"""Codes: error of a pixel of unknown value. Near the sun the tone curve's slope would give thousands."""
_TINY: Final = 1e-30  # chosen: below any change of variance that matters, and above 0, for black images
_MAX_DIFFERENCE: Final = 510.0  # chosen: codes between samples, from black to overexposed


class AdaptiveSampler:
    """Decides how many samples each pixel of a frame needs, and estimates the error that remains.

    Args:
        camera: that takes the image.
        target: error over noise, root mean square in codes; None for a fixed number of samples, or for direct
            light in balance with gathered light.
        max_samples: per pixel.
        denoised: whether indirect light will be denoised.
        gathered: whether indirect light is gathered in several directions; without the denoiser it is as any.
        rows: of the image, the only ones whose error is compared with the noise; all by default.
    """

    def __init__(
        self,
        camera: Camera,
        target: float | None,
        max_samples: int,
        *,
        denoised: bool,
        gathered: bool = False,
        rows: slice = slice(None),
    ) -> None:
        self.camera, self.target, self.max_samples = camera, target, max_samples
        self._denoised, self._gathered, self._rows = denoised, gathered and denoised, rows
        self._codes: CodeResponse | None = None

    def required(self, accumulator: SampleAccumulator) -> NDArray[np.int32]:
        """`(h * w,)` number of samples that each pixel should have by now."""
        taken, count = accumulator.samples, accumulator.indirect_samples
        if self.target is None and not self._gathered:
            return taken
        # The first samples are enough to estimate how light appears in the image.
        codes = self._code_response(accumulator.total, accumulator.white)
        direct = codes.squared(_local_mean(accumulator.direct_variance()), _MAX_DIFFERENCE).ravel()
        indirect = codes.squared(accumulator.indirect_variance(), _MAX_DIFFERENCE)
        remaining = float(np.mean(indirect)) * self._indirect_factor(accumulator.indirect_share(), count)
        allowed = (self.target or 0.0) ** 2 * float(np.mean(np.square(codes.noise)))
        # Direct light may have the error that indirect light leaves of the target, at least half of it.
        wanted = self._distribute(direct, max(allowed - remaining, 0.5 * allowed))
        if self.target is None or remaining > allowed:
            # There is no target, or it cannot be met: more direct samples than in balance are wasted.
            power, cost = (0.5, _GATHERED_COST) if self._gathered else (1.0, _INDIRECT_COST)
            balanced = balanced_samples(direct, remaining, taken, cost * count, power)
            wanted = np.minimum(wanted, self._powers_of_two(balanced))
        # Never fewer than are taken, and not many more at once: their variance is only estimated.
        limit = np.minimum(taken * _GROWTH, np.maximum(self.max_samples, taken))
        return np.clip(wanted, taken, limit).astype(np.int32)

    def metadata(self, light: TracedLight) -> dict[str, Any]:
        """Describe the samples of a finished frame and their error, for its JSON file."""
        return sampling_metadata([self.error(light)], self.target)

    def error(self, light: TracedLight) -> SamplingError:
        """Estimate the error that remains in the rows."""
        variance, codes = light.variance, self._code_response(light.total, light.variance.white)
        per_sample = variance.samples.astype(np.float32) ** np.float32(-1.5)
        # Direct light has stratified samples; indirect light independent ones, whose noise is partly removed.
        of_mean = VARIANCE_GAIN * _local_mean(variance.direct) * per_sample
        share = indirect_share(light.indirect, light.flash + light.sky_and_sun)
        of_mean += variance.indirect * np.float32(self._indirect_factor(share, variance.indirect_samples))
        # Both in codes of the image, where their mean squares are compared.
        error, noise = codes.squared(of_mean, _MAX_ERROR), np.square(codes.noise)
        return SamplingError(
            pixels=error.size,
            samples=float(variance.samples.mean()),
            indirect_samples=variance.indirect_samples,
            squared_error=error.mean(),
            squared_noise=noise.mean(),
            below_half_of_noise=float((error <= 0.25 * noise).mean()),
        )

    def _indirect_factor(self, share: float, samples: int) -> float:
        """Variance of the mean of indirect light over that of a sample; `share` is its part of all light."""
        count = max(samples, 1)
        if self._gathered:
            return _GATHERED_ERROR**2 * count**-0.5
        return (denoised_error(share) ** 2 if self._denoised else 1.0) / count

    def _code_response(self, signal: Callable[[], Floats], white: NDArray[np.float64]) -> CodeResponse:
        if self._codes is None:
            self._codes = code_response(signal(), white, self.camera, self._rows)
        return self._codes

    def _distribute(self, variance: Floats, allowed: float) -> Floats:
        """Powers of two whose mean variance is the allowed one, with the fewest samples."""
        # An odd step does not follow the columns of an image, whose width is even.
        subset = variance[:: variance.size // _SUBSET | 1]
        scale = _variance_scale(subset, allowed, self.max_samples)
        # n^(5/2) is proportional to the variance.
        return self._powers_of_two(np.power(scale * variance, 0.4))

    def _powers_of_two(self, samples: Floats) -> Floats:
        """Within the limits; they keep the samples of each pixel a net."""
        return np.exp2(np.rint(np.log2(np.clip(samples, 1.0, self.max_samples))))


@dataclass(frozen=True)
class SamplingError:
    """Samples of some pixels of an image, and means over these pixels; in squared codes where squared."""

    pixels: int
    samples: float
    indirect_samples: int
    squared_error: np.float32
    squared_noise: np.float32
    below_half_of_noise: float


def sampling_metadata(
    parts: Sequence[SamplingError],
    target: float | None,
    stray_light: float = 1.0,
    measured: float | None = None,
) -> dict[str, Any]:
    """Describe the samples of an image and their error for its JSON file, from those of its parts.

    Args:
        parts: of the image.
        target: error over noise, or None.
        stray_light: what the camera's stray light leaves of the error; see `stray_light_factor`.
        measured: the error of the whole image, where it was measured, in codes.
    """
    rms_error, rms_noise = (
        float(np.sqrt(np.float32(_mean_over_pixels(parts, name))))
        for name in ("squared_error", "squared_noise")
    )
    rms_error = rms_error * stray_light if measured is None else measured
    # Both are 0 in an overexposed image.
    ratio = rms_error / rms_noise if rms_noise > 0.0 else 0.0
    return {
        "target": target,
        "samples_per_pixel": _mean_over_pixels(parts, "samples"),
        "soft_samples_per_pixel": parts[0].indirect_samples,
        "error_codes": rms_error,
        "noise_codes": rms_noise,
        "error_to_noise": ratio,
        "target_met": None if target is None else is_target_met(ratio, target),
        "below_half_of_noise": _mean_over_pixels(parts, "below_half_of_noise"),
    }


def _mean_over_pixels(parts: Sequence[SamplingError], name: str) -> float:
    """The mean of a value over the pixels of all parts; exactly that of a single part."""
    first = float(getattr(parts[0], name))
    pixels = sum(part.pixels for part in parts)
    return first + sum((float(getattr(part, name)) - first) * (part.pixels / pixels) for part in parts)


def balanced_samples(
    variance: Floats, remaining: float, taken: NDArray[np.int32], indirect_time: float, power: float
) -> Floats:
    """`(n,)` samples of direct light at which time^power times the variance of the image is smallest.

    With n_p samples in pixel p, at least those that are taken, the time is proportional to T = t + <n_p>, and
    the variance of the image is V = r + <v_p>, v_p = VARIANCE_GAIN s_p^2 n_p^(-3/2). The derivative of
    T^power V by n_p is 0 at 3/2 v_p / n_p = power V / T.

    Args:
        variance: s^2 of one sample, by pixel.
        remaining: r, the variance of indirect light.
        taken: samples of each pixel.
        indirect_time: t, that of the indirect light of a pixel over that of a sample of direct light.
        power: by which the variance of indirect light falls as its samples become more.
    """
    least = taken.astype(np.float32)
    wanted = least
    for _ in range(_BALANCE_STEPS):
        image = remaining + float(np.mean(VARIANCE_GAIN * variance * wanted**-1.5))
        per_sample = power * image / (indirect_time + float(wanted.mean()))
        balanced = np.power(1.5 * VARIANCE_GAIN / max(per_sample, _TINY) * variance, 0.4)
        wanted = np.maximum(balanced, least)
    return np.asarray(balanced, np.float32)


def denoised_error(share: float) -> float:
    """Fraction of the standard error of indirect light after denoising.

    Args:
        share: indirect light as part of all light of the image.
    """
    return float(np.interp(share, _INDIRECT_SHARES, _DENOISED_ERRORS))


def _variance_scale(variance: Floats, allowed: float, max_samples: int) -> float:
    """The factor between variances and samples^(5/2), by bisection of its logarithm."""
    if not variance.any():
        return 0.0
    # The lower end gives one sample per pixel, the upper end the maximum in every pixel.
    low, high = -80.0, 80.0
    for _ in range(40):
        # Would the samples that this factor gives leave more than the allowed mean variance?
        middle = 0.5 * (low + high)
        samples = np.clip(np.power(np.exp2(middle) * variance.astype(np.float64), 0.4), 1.0, max_samples)
        is_enough = np.mean(VARIANCE_GAIN * variance * samples**-1.5) <= allowed
        low, high = (low, middle) if is_enough else (middle, high)
    return float(np.exp2(high))


def _local_mean(variance: Floats) -> Floats:
    """Means over squares of 3x3 pixels."""
    from scipy.ndimage import uniform_filter

    # Next to a highlight, running sums can fall slightly below 0.
    return np.asarray(np.maximum(uniform_filter(variance, 3, mode="nearest"), 0.0), np.float32)
