"""Means and variances of traced light, accumulated over the samples of each pixel.

Sums are taken in passes of limited size. The samples of a pixel are adjacent in the wavefront, so that the
sum over a pixel is a block reduction: no atomics, and the same bits in each run, however the wavefront is
split.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.interrupts import raise_if_interrupted
from pepperscene.render.arrays import device_array, device_uint
from pepperscene.render.transport.lights import FrameTables
from pepperscene.render.transport.samples import Samples
from pepperscene.render.variant import mitsuba_modules

Images = NDArray[np.float32]
Counts = NDArray[np.int32]
Surfaces = NDArray[np.uint16]
SampleSums = Sequence[Images | None]
"""Sums over samples, one `(n,)` array for each quantity; None for zeros."""


@dataclass(frozen=True, eq=False)
class TracedLight:
    """The light of one frame, integrated over wavelength by the sensor, per pixel and channel (c).

    `pepperscene.render.transport` defines direct and indirect light.

    Attributes:
        flash: `(h, w, c)` direct light of the flash, electrons s-1 m-2 sr-1.
        sky_and_sun: `(h, w, c)` direct light of the sky and the sun.
        indirect: `(h, w, c)` indirect light.
        albedo: `(h, w, c)` of the first hit, weighted by the response to the flash, 0 without a hit; for the
            denoiser, as are normal and coverage. For sensors with bands `(h, w, 3)`, in broad channels.
        normal: `(h, w, 3)` of the relief at the first hit, towards the camera, 0 without a hit.
        coverage: `(h, w, 2)` fraction of the samples that hit a surface: of all, and of the indirect ones.
        variance: between the samples.
        surface: `(h, w)` number of the surface at each pixel's first sample, from 1, or 0 without a hit; for
            the denoiser, where light is gathered, else None.
    """

    flash: Images
    sky_and_sun: Images
    indirect: Images
    albedo: Images
    normal: Images
    coverage: Images
    variance: SampleVariance
    surface: Surfaces | None = None

    def total(self) -> Images:
        """`(h, w, c)` all light as traced."""
        return self.flash + self.sky_and_sun + self.indirect


@dataclass(frozen=True, eq=False)
class GuidedLight:
    """The light of some rows of an image as the denoiser needs it; attributes as of `TracedLight`."""

    indirect: Images
    albedo: Images
    normal: Images
    coverage: Images
    surface: Surfaces | None = None


@dataclass(frozen=True, eq=False)
class SampleVariance:
    """Variance between the samples of each pixel, in units of `white`, summed over the channels.

    Attributes:
        samples: `(h, w)` number of direct samples.
        indirect_samples: number of indirect samples, in every pixel.
        direct: `(h, w)` variance of one sample of direct light.
        indirect: `(h, w)` the same of indirect light.
        white: `(c,)` the light of a white body under the flash at one metre, electrons s-1 m-2 sr-1.
    """

    samples: NDArray[np.int32]
    indirect_samples: int
    direct: Images
    indirect: Images
    white: NDArray[np.float64]


class SampleAccumulator:
    """Sums over the samples of each pixel.

    Args:
        height, width: of the image, pixels.
        white: `(c,)` see `SampleVariance`.
        guides: channels of the albedo; None for c.

    Attributes:
        samples: `(h * w,)` number of direct samples.
        indirect_samples: number of indirect samples, in every pixel.
    """

    def __init__(
        self, height: int, width: int, white: NDArray[np.float64], guides: int | None = None
    ) -> None:
        self._shape, self.white = (height, width), white
        c = self.channels = len(white)
        # One row per quantity: adding whole images is fastest.
        self._guides = c if guides is None else guides
        self._direct = np.zeros((2 * c + self._guides + 5, height * width), np.float32)
        self._indirect = np.zeros((c + 2, height * width), np.float32)
        self.samples = np.zeros(height * width, np.int32)
        self.indirect_samples = 0

    def add_direct(self, sums: SampleSums, count: int, pixels: NDArray[np.int64] | None = None) -> None:
        """Add samples of direct light in some pixels, given as row-major indices, or in all.

        Args:
            sums: over `count` samples: flash, sky and sun, albedo, normal, hits, squares.
            count: number of samples.
            pixels: None for all.
        """
        selection = slice(None) if pixels is None else pixels
        for total, part in zip(self._direct, sums, strict=True):
            if part is not None:
                total[selection] += part
        self.samples[selection] += count

    def add_all(self, sums: SampleSums, count: int) -> None:
        """Add samples of all light in every pixel; sums of indirect light and its squares come last."""
        direct = len(self._direct)
        self.add_direct(sums[:direct], count)
        for total, part in zip(self._indirect, [*sums[direct:], sums[direct - 2]], strict=True):
            if part is not None:
                total += part
        self.indirect_samples += count

    def total(self) -> Images:
        """`(h, w, c)` mean of all light."""
        return self._image(self._direct_mean() + self._indirect_mean())

    def indirect(self) -> Images:
        """`(h, w, c)` mean of indirect light."""
        return self._image(self._indirect_mean())

    def indirect_share(self) -> float:
        """Indirect light as part of all light; see `indirect_share`."""
        return indirect_share(self._indirect_mean(), self._direct_mean())

    def direct_variance(self) -> Images:
        """`(h, w)` see `SampleVariance.direct`."""
        return self._image(_variance(self._direct[-1], self._direct_mean() * self._per_white, self.samples))

    def indirect_variance(self) -> Images:
        """`(h, w)` see `SampleVariance.indirect`."""
        means = self._indirect_mean() * self._per_white
        return self._image(_variance(self._indirect[self.channels], means, self.indirect_samples))

    def light(self) -> TracedLight:
        """Compute means and variances; later samples do not change them."""
        c, per_sample = self.channels, (1.0 / self.samples).astype(np.float32)
        albedo_end = 2 * c + self._guides
        hit = self._direct[-2] * per_sample
        indirect_hit = (
            self._indirect[-1] / np.float32(self.indirect_samples) if self.indirect_samples else hit
        )
        return TracedLight(
            flash=self._image(self._direct[:c] * per_sample),
            sky_and_sun=self._image(self._direct[c : 2 * c] * per_sample),
            indirect=self.indirect(),
            albedo=self._image(self._direct[2 * c : albedo_end] * per_sample),
            normal=self._image(self._direct[albedo_end : albedo_end + 3] * per_sample),
            coverage=self._image(np.stack([hit, indirect_hit])),
            variance=SampleVariance(
                samples=self.samples.reshape(self._shape).copy(),
                indirect_samples=self.indirect_samples,
                direct=self.direct_variance(),
                indirect=self.indirect_variance(),
                white=self.white,
            ),
        )

    def _direct_mean(self) -> Images:
        """`(c, h * w)`."""
        c = self.channels
        light = self._direct[:c] + self._direct[c : 2 * c]
        return np.divide(light, self.samples, dtype=np.float32)

    def _indirect_mean(self) -> Images:
        """`(c, h * w)`."""
        return self._indirect[: self.channels] / np.float32(max(self.indirect_samples, 1))

    @cached_property
    def _per_white(self) -> Images:
        return (1.0 / self.white).astype(np.float32)[:, None]

    def _image(self, values: Any) -> Images:
        """Reshape `(h * w,)` or `(k, h * w)` to `(h, w)` or `(h, w, k)`."""
        image = values.reshape(*values.shape[:-1], *self._shape)
        return np.ascontiguousarray(image if image.ndim == 2 else np.moveaxis(image, 0, -1), np.float32)


def indirect_share(indirect: Images, direct: Images) -> float:
    """Indirect light as part of all light of an image, in electrons of all pixels and channels.

    Args:
        indirect: of any shape.
        direct: of the same shape.
    """
    parts = [float(image.sum(dtype=np.float64)) for image in (indirect, direct)]
    return parts[0] / (parts[0] + max(parts[1], 0.0)) if parts[0] > 0.0 else 0.0


def _variance(squares: Images, means: Images, count: Any) -> Images:
    """Variance of one sample, summed over channels, from the sum of squares and the means `(c, n)`."""
    number = np.maximum(np.asarray(count, np.float32), np.float32(1.0))
    biased = np.maximum(squares / number - np.square(means).sum(axis=0), np.float32(0.0))
    return np.asarray(biased * (number / np.maximum(number - np.float32(1.0), np.float32(1.0))), np.float32)


_LANES: Final = 1 << 20
"""Wavefront of a pass. Chosen: 25 results per sample take 105 MB. With twice as many the first frame of
`demo` takes 130 MB more, and a further one 4.7 instead of 4.9 CPU seconds (medians of eight)."""

Integrand = Callable[[FrameTables, Samples], Iterable[list[Any]]]
"""Values of a wavefront, in batches: those of each are evaluated in one kernel, and summed before those of
the next are asked for."""


def sum_samples(
    tables: FrameTables,
    pixels: NDArray[np.int64] | None,
    first: int,
    count: int,
    seed: int,
    integrand: Integrand,
    lanes: int | None = None,
    within: tuple[int, int] | None = None,
) -> list[Images]:
    """Sum an integrand's k values over samples `first` to `first + count - 1` of n pixels: k times `(n,)`.

    `pixels` are row-major indices, or None for all or those `within` limits; `lanes` is the largest
    wavefront.
    """
    start, end = within or (0, tables.rays.width * tables.rays.height)
    if pixels is not None:
        start, end = 0, len(pixels)
    block = max((lanes or _LANES) // count, 1)
    if end - start <= block:
        return _sum_pass(tables, pixels, (start, end), first, count, seed, integrand)
    # Copied pass by pass, so that the device holds the sums of one pass and not those of the whole image.
    sums: list[Images] = []
    for low in range(start, end, block):
        high = min(low + block, end)
        parts = _sum_pass(tables, pixels, (low, high), first, count, seed, integrand)
        sums = sums or [np.empty(end - start, np.float32) for _ in parts]
        for whole, part in zip(sums, parts, strict=True):
            whole[low - start : high - start] = part
    return sums


def _sum_pass(
    tables: FrameTables,
    pixels: NDArray[np.int64] | None,
    limits: tuple[int, int],
    first: int,
    count: int,
    seed: int,
    integrand: Integrand,
) -> list[Images]:
    """The sums of `sum_samples` for its pixels from one number to another, in the device's memory."""
    raise_if_interrupted()
    mi, dr = mitsuba_modules()
    start, end = limits
    salt, begin, per_pixel = (device_uint(n) for n in (seed & 0xFFFFFFFF, first, count))
    lane = dr.arange(mi.UInt32, (end - start) * count)
    number = lane // per_pixel
    index = begin + lane - number * per_pixel
    if pixels is None:
        pixel = number + device_uint(start)
    else:
        pixel = dr.gather(mi.UInt32, device_array(pixels[start:end], np.uint32), number)
    result: list[Images] = []
    for values in integrand(tables, Samples(tables, pixel, index, salt)):
        # Evaluate all results in one kernel: reduced separately, each would run the kernel again.
        dr.eval(values)
        sums = [dr.block_reduce(dr.ReduceOp.Add, value, count) for value in values]
        dr.eval(sums)
        result += [np.asarray(values_sum) for values_sum in sums]
    return result
