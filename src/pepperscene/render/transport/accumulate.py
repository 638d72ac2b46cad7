"""What tracing gives: means and variances over the samples of each pixel, gathered as they come in."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

Images = NDArray[np.float32]
Counts = NDArray[np.int32]
Pictures = Sequence[Images]
"""One after the other, each of all pixels asked for."""


@dataclass(frozen=True, eq=False)
class TracedLight:
    """One frame's light, summed over wavelengths by the sensor, per pixel and channel (c, 3 or 1).

    Attributes:
        flash: `(h, w, c)` straight from the flash to the first hit and back; electrons s-1 m-2 sr-1.
        sky: `(h, w, c)` seen directly, and the sun at the first hit where it is as distinct as the flash.
        soft: `(h, w, c)` all the rest: daylight on surfaces and light that was scattered more than once.
        albedo: `(h, w, c)` of the first hit, weighted by the response to the flash, 0 where there is none;
            for the denoiser, as is what follows.
        normal: `(h, w, 3)` of the first hit, towards the camera, 0 where there is none.
        covered: `(h, w, 2)` share of the samples that hit something, among all and among the soft ones.
        spread: how the samples differ.
    """

    flash: Images
    sky: Images
    soft: Images
    albedo: Images
    normal: Images
    covered: Images
    spread: SampleVariance

    def total(self) -> Images:
        """`(h, w, c)` all light as traced."""
        return self.flash + self.sky + self.soft


@dataclass(frozen=True, eq=False)
class SampleVariance:
    """How the samples of each pixel differ, in units of a white body's light under the flash at one metre.

    Attributes:
        samples: `(h, w)` how many of flash and sky there are.
        soft_samples: how many of soft light, in every pixel.
        sharp: `(h, w)` variance of one sample of flash and sky, summed over the channels.
        soft: `(h, w)` the same of soft light.
        white: `(c,)` the unit, electrons s-1 m-2 sr-1.
    """

    samples: NDArray[np.int32]
    soft_samples: int
    sharp: Images
    soft: Images
    white: NDArray[np.float64]


class SampleAccumulator:
    """Sums over the samples of each pixel.

    Args:
        height: of the image, pixels.
        width: of the image, pixels.
        white: `(c,)` a white body's light under the flash at one metre.
    """

    def __init__(self, height: int, width: int, white: NDArray[np.float64]) -> None:
        self._shape, self.white = (height, width), white
        c = self.channels = len(white)
        # Kind by kind, each a whole picture: sums of pictures are the quickest there are.
        self._sharp = np.zeros((3 * c + 5, height * width), np.float32)
        self._soft = np.zeros((c + 2, height * width), np.float32)
        self.samples = np.zeros(height * width, np.int32)
        self.soft_samples = 0

    def add_sharp(self, found: Pictures, count: int, pixels: NDArray[np.int64] | None = None) -> None:
        """Sums of `count` samples each: flash, sky, albedo, normal, hit, squares, 3 c + 5 times `(n,)`.

        Args:
            found: the sums.
            count: of samples.
            pixels: row-major indices, or None for all.
        """
        where = slice(None) if pixels is None else pixels
        for total, part in zip(self._sharp, found, strict=True):
            total[where] += part
        self.samples[where] += count

    def add_both(self, found: Pictures, count: int) -> None:
        """The same of samples that carry soft light as well: that light and its squares behind the others."""
        sharp = len(self._sharp)
        self.add_sharp(found[:sharp], count)
        for total, part in zip(self._soft, [*found[sharp:], found[sharp - 2]], strict=True):
            total += part
        self.soft_samples += count

    def total(self) -> Images:
        """`(h, w, c)` mean of all light."""
        return self._image(self._sharp_mean() + self._soft_mean())

    def sharp_variance(self) -> Images:
        """`(h, w)` as `SampleVariance.sharp`."""
        return self._image(_variance(self._sharp[-1], self._sharp_mean() * self._per_white, self.samples))

    def soft_variance(self) -> Images:
        """`(h, w)` as `SampleVariance.soft`."""
        means = self._soft_mean() * self._per_white
        return self._image(_variance(self._soft[self.channels], means, self.soft_samples))

    def light(self) -> TracedLight:
        """Means and variances."""
        c, share = self.channels, (1.0 / self.samples).astype(np.float32)
        hit = self._sharp[-2] * share
        soft_hit = self._soft[-1] / np.float32(self.soft_samples) if self.soft_samples else hit
        return TracedLight(
            flash=self._image(self._sharp[:c] * share),
            sky=self._image(self._sharp[c : 2 * c] * share),
            soft=self._image(self._soft_mean()),
            albedo=self._image(self._sharp[2 * c : 3 * c] * share),
            normal=self._image(self._sharp[3 * c : 3 * c + 3] * share),
            covered=self._image(np.stack([hit, soft_hit])),
            spread=SampleVariance(
                samples=self.samples.reshape(self._shape).copy(),
                soft_samples=self.soft_samples,
                sharp=self.sharp_variance(),
                soft=self.soft_variance(),
                white=self.white,
            ),
        )

    def _sharp_mean(self) -> Images:
        """`(c, h w)` of flash and sky."""
        c = self.channels
        both = self._sharp[:c] + self._sharp[c : 2 * c]
        return np.divide(both, self.samples, dtype=np.float32)

    def _soft_mean(self) -> Images:
        """`(c, h w)` of soft light."""
        return self._soft[: self.channels] / np.float32(max(self.soft_samples, 1))

    @cached_property
    def _per_white(self) -> Images:
        return (1.0 / self.white).astype(np.float32)[:, None]

    def _image(self, values: Any) -> Images:
        """`(h, w)` or `(h, w, k)` of `(h w,)` or `(k, h w)`."""
        image = values.reshape(*values.shape[:-1], *self._shape)
        return np.ascontiguousarray(image if image.ndim == 2 else np.moveaxis(image, 0, -1), np.float32)


def _variance(squares: Images, means: Images, count: Any) -> Images:
    """Variance of one sample, summed over channels, from the sum of squares and the means `(c, n)`."""
    number = np.maximum(np.asarray(count, np.float32), np.float32(1.0))
    spread = np.maximum(squares / number - np.square(means).sum(axis=0), np.float32(0.0))
    return np.asarray(spread * (number / np.maximum(number - np.float32(1.0), np.float32(1.0))), np.float32)
