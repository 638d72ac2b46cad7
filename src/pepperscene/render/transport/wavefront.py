"""Sums over the samples of pixels, in passes of limited size.

The samples of a pixel are adjacent in the wavefront, so that the sum over a pixel is a block reduction: no
atomics, and the same bits in each run, however the wavefront is split.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.render.arrays import device_array, device_uint
from pepperscene.render.transport.accumulate import Images
from pepperscene.render.transport.lights import FrameTables
from pepperscene.render.transport.samples import Samples
from pepperscene.render.variant import mitsuba_modules

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
