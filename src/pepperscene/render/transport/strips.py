"""The light of an image, traced and denoised in strips of rows, so that a large image takes little memory.

A sample of a pixel is the same in a strip as in the whole image. What differs: samples stop where the error
of a strip is below the noise of that strip; and the denoiser sees a tile of a strip with `SURROUNDINGS`
pixels around it, in all directions, for which the light of the neighbouring strips waits. What the denoiser
takes from a whole image, its mean light and the kind of the filter, comes from a few of its rows, traced
beforehand: so it is the same in all tiles. The means of surfaces by daylight are those of a tile: from one
strip of 150 rows of 800 pixels to the next, drafts of `greenhouse` step by .1 to .3 codes, by less than .1
without these means. A small image is a single strip, with nothing around it.
"""

from __future__ import annotations

import functools
from collections import deque
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.camera import Camera, stray_light_factor
from pepperscene.camera.sensor.rows import row_strips
from pepperscene.render.quality import Quality
from pepperscene.render.transport.accumulate import GuidedLight, TracedLight
from pepperscene.render.transport.adaptive import AdaptiveSampler, makes_images, sampling_metadata
from pepperscene.render.transport.channel_light import ChannelLight
from pepperscene.render.transport.denoise import (
    FilterSetting,
    denoised,
    filtered_indirect,
    setting_of_part,
)
from pepperscene.render.transport.measured_error import measured_error, samples_of_mean
from pepperscene.render.transport.trace import FrameLight, Sampling, in_rows, sum_of_parts, trace_rows
from pepperscene.render.variant import mitsuba_modules

Image = NDArray[np.float32]
FinishedRows = Iterable[tuple[slice, Image]]
"""Rows of an image and all their light, `(n, w, c)`."""

SURROUNDINGS: Final = 48
"""Pixels around a tile that the denoiser sees. Chosen: the reach of the mean that it restores. Two plants by
flash, 480x360, in strips of 60 rows: the difference to the whole image is .0036 codes (root mean square) with
32 pixels, and .0034 with 64 and with 96, beside a noise of 2.8; rows at seams step by .0003 codes."""
_ALIGNMENT: Final = 32
"""Pixels that the filter joins to one at most: its result depends on which of them are joined."""
TILE_PIXELS: Final = 1 << 19
"""Pixels that the denoiser filters at a time, at most, with the surroundings. Chosen: its memory is then that
of an 800x600 image."""
_FIRST_ROWS: Final = 32
"""Rows that are traced beforehand. Chosen: their mean light is within some per cent of that of the image."""


@dataclass(frozen=True, eq=False)
class LightPart:
    """Light that is traced by itself: all light of an image, or a part of its exposure.

    Attributes:
        source: what is traced.
        share: `(h,)` factor of the light in each row; None for 1.
    """

    source: FrameLight
    share: NDArray[np.float64] | None = None

    def light(self, quality: Quality, rows: slice, adaptive: AdaptiveSampler | None) -> TracedLight:
        """The light of some rows; without an adaptive sampler only the samples that all pixels have."""
        sampling = Sampling(
            quality.samples if adaptive is not None else quality.soft,
            quality.soft,
            quality.bounces,
            None if adaptive is None else adaptive.required,
            quality.most_bounces,
        )
        light = trace_rows(self.source, sampling, rows)
        if quality.denoise and isinstance(self.source, ChannelLight) and self.source.gathering is not None:
            light = replace(light, surface=self.source.first_surfaces(rows))
        return in_rows(light, None if self.share is None else self.share[rows])

    def independent(self, samples: int, pixels: NDArray[np.int64], number: int) -> Image:
        """`(n, c)` gathered light in some pixels, from samples of their own; see `measured_error`."""
        assert isinstance(self.source, ChannelLight)
        light = self.source.independent(pixels, samples, number)
        if self.share is None:
            return light
        return light * self.share[pixels // self.source.tables.rays.width, None].astype(np.float32)


def trace_in_strips(
    camera: Camera, quality: Quality, parts: Sequence[LightPart], *, is_divided: bool = False
) -> tuple[Image, dict[str, Any]]:
    """Trace the parts of an image's light, each with samples and a denoiser of its own, and add them.

    Args:
        camera: that takes the image.
        quality: samples, target and whether to denoise.
        parts: of the light.
        is_divided: whether these are the parts of an exposure.

    Returns:
        Light `(h, w, c)` in electrons s-1 m-2 sr-1, and the description of its samples.
    """
    strips = row_strips(camera.width, camera.height)
    # The variances of the parts add up to that of the whole.
    target = None if quality.target is None else quality.target / len(parts) ** 0.5
    finishers = [_finisher(part, quality, camera, strips) for part in parts]
    signal = np.empty((camera.height, camera.width, camera.sensor.channels), np.float32)
    errors = []

    def sampler(target: float | None, rows: slice) -> AdaptiveSampler:
        gathered = quality.directions > 0
        return AdaptiveSampler(
            camera, target, quality.most, denoised=quality.denoise, gathered=gathered, rows=rows
        )

    for rows in strips:
        lights = []
        for number, (part, finish) in enumerate(zip(parts, finishers, strict=True)):
            adaptive = sampler(target, rows)
            lights.append(part.light(quality, rows, adaptive))
            for finished, image in finish(rows, lights[-1]):
                if number:
                    signal[finished] += image
                else:
                    signal[finished] = image
        if is_divided:
            errors.append(sampler(quality.target, rows).error(sum_of_parts(lights)))
        else:
            errors.append(adaptive.error(lights[-1]))
    measured = None
    if quality.denoise and quality.directions and makes_images(camera):
        independent = functools.partial(_independent, parts, samples_of_mean(quality.soft))
        measured = measured_error(camera, signal, independent)
    if len(strips) > 1:
        # What the device keeps for later would add to the memory of developing the image.
        mitsuba_modules()[1].flush_malloc_cache()
    factor = stray_light_factor(camera)
    return signal, sampling_metadata(errors, quality.target, factor, measured)


def _independent(parts: Sequence[LightPart], samples: int, pixels: NDArray[np.int64], number: int) -> Image:
    """`(n, c)` light of the parts in some pixels, from samples of their own; see `measured_error`."""
    return np.asarray(sum(part.independent(samples, pixels, number) for part in parts), np.float32)


def _finisher(
    part: LightPart, quality: Quality, camera: Camera, strips: Sequence[slice]
) -> Callable[[slice, TracedLight], FinishedRows]:
    """What turns the light of one strip after the other into rows of the image."""
    if not quality.denoise:
        return _unfiltered
    if len(strips) == 1:
        return _denoised_whole
    first = np.unique(np.linspace(0, camera.height - 1, _FIRST_ROWS).astype(int))
    lights = [part.light(quality, slice(row, row + 1), None) for row in first.tolist()]
    return StripDenoiser(camera.width, camera.height, setting_of_part(_stacked(lights))).add


def _unfiltered(rows: slice, light: TracedLight) -> FinishedRows:
    return [(rows, light.total())]


def _denoised_whole(rows: slice, light: TracedLight) -> FinishedRows:
    return [(rows, denoised(light))]


class StripDenoiser:
    """Denoises the strips of an image, each when the rows below it are known.

    Args:
        width, height: of the image, pixels.
        setting: of the filter.
    """

    def __init__(self, width: int, height: int, setting: FilterSetting) -> None:
        self._width, self._height, self._setting = width, height, setting
        self._known: deque[tuple[slice, GuidedLight]] = deque()
        self._waiting: deque[tuple[slice, Image]] = deque()

    def add(self, rows: slice, light: TracedLight) -> FinishedRows:
        """Take the light of the next strip; yield the rows that are finished, and all light in them."""
        guided = GuidedLight(light.indirect, light.albedo, light.normal, light.coverage, light.surface)
        self._known.append((rows, guided))
        self._waiting.append((rows, light.flash + light.sky_and_sun))
        while self._waiting:
            strip, direct = self._waiting[0]
            if rows.stop < min(strip.stop + SURROUNDINGS, self._height):
                break
            self._waiting.popleft()
            yield strip, direct + self._indirect(strip)
            needed = strip.stop - SURROUNDINGS - _ALIGNMENT
            while self._known and self._known[0][0].stop <= needed:
                self._known.popleft()

    def _indirect(self, rows: slice) -> Image:
        """The denoised indirect light of a strip, `(n, w, c)`."""
        around = _widened(rows, self._height)
        tall, count = around.stop - around.start, 1
        # Tiles as wide as the number of pixels allows, but at least as wide as their surroundings.
        while (-(-self._width // count) + 2 * SURROUNDINGS) * tall > TILE_PIXELS and (
            self._width // count > 4 * SURROUNDINGS
        ):
            count += 1
        step = -(-self._width // count)
        result = np.empty(
            (rows.stop - rows.start, self._width, self._known[0][1].indirect.shape[-1]), np.float32
        )
        for left in range(0, self._width, step):
            columns = slice(left, min(left + step, self._width))
            result[:, columns] = self._tile(rows, columns)
        return result

    def _tile(self, rows: slice, columns: slice) -> Image:
        """The denoised indirect light of a part of a strip."""
        around, across = _widened(rows, self._height), _widened(columns, self._width)
        light = self._part(around, across)
        has_light = self._setting.level > 0.0
        image = filtered_indirect(light, self._setting) if has_light else light.indirect
        top, left = rows.start - around.start, columns.start - across.start
        return image[top : top + rows.stop - rows.start, left : left + columns.stop - columns.start]

    def _part(self, rows: slice, columns: slice) -> GuidedLight:
        """The light of a rectangle, out of the strips that are known."""
        parts = []
        for strip, light in self._known:
            inside = slice(max(rows.start, strip.start), min(rows.stop, strip.stop))
            if inside.start < inside.stop:
                at = np.s_[inside.start - strip.start : inside.stop - strip.start, columns]
                images = light.indirect, light.albedo, light.normal, light.coverage, light.surface
                parts.append([image[at] for image in images if image is not None])
        return GuidedLight(*(np.concatenate(images) for images in zip(*parts, strict=True)))


def _widened(part: slice, length: int) -> slice:
    """A part of a line with its surroundings, from a multiple of `_ALIGNMENT` on."""
    start = max(part.start - SURROUNDINGS, 0) // _ALIGNMENT * _ALIGNMENT
    return slice(start, min(part.stop + SURROUNDINGS, length))


def _stacked(lights: Sequence[TracedLight]) -> TracedLight:
    """The light of several rows below each other, with the variance of the first."""
    names = ("flash", "sky_and_sun", "indirect", "albedo", "normal", "coverage")
    flash, sky_and_sun, indirect, albedo, normal, coverage = (
        np.concatenate([getattr(light, name) for light in lights]) for name in names
    )
    return TracedLight(flash, sky_and_sun, indirect, albedo, normal, coverage, lights[0].variance)
