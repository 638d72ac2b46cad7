"""Tracing the light of a frame: all light along a pixel's first samples, then more samples of its edges.

The first samples of a pixel trace direct and indirect light along the same rays; where they show edges, more
samples follow that stop at the first hit. `channel_light` and `band_light` say what a sample is.

The parts of an exposure, daylight over all of it and the flash in its pulse, are traced at their own times.
Motion that blurs the daylight of 3 ms is sharp in the light of a pulse of 50 us. If samples at random times
carried both lights, one in sixty would see the flash; traced separately, every sample sees its light.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.camera import Camera, Flash
from pepperscene.camera.sensor.rows import RowWindows
from pepperscene.render.kernel.camera import CameraRays, SpectralResponse
from pepperscene.render.kernel.scene import LightScene, SkyTables
from pepperscene.render.quality import Gathering
from pepperscene.render.transport.accumulate import Counts, SampleAccumulator, SampleVariance, TracedLight
from pepperscene.render.transport.band_light import BandLight
from pepperscene.render.transport.channel_light import ChannelLight
from pepperscene.render.transport.lights import frame_tables


@dataclass(frozen=True, eq=False)
class ExposurePart:
    """Light that reaches the camera at certain times.

    Attributes:
        has_flash, has_daylight: which lights shine.
        windows: when each row sees them.
        share: `(h,)` factor of the light in each row; None for 1.
    """

    has_flash: bool
    has_daylight: bool
    windows: RowWindows
    share: NDArray[np.float64] | None = None


def exposure_parts(camera: Camera, *, has_daylight: bool) -> list[ExposurePart]:
    """Divide an exposure into parts that are traced separately.

    The list is empty if the camera does not move and the flash lights all rows equally: then all light can be
    traced together. Otherwise a scene without any light has one part.
    """
    shutter, flash = camera.shutter, camera.flash
    share = None if flash is None else shutter.flash_fraction(flash.pulse_s)
    if share is not None and (share == 1.0).all():
        share = None
    if not camera.is_moving and share is None:
        return []
    parts = []
    if has_daylight or flash is None:
        parts.append(ExposurePart(False, True, shutter.exposures()))
    if flash is not None:
        parts.append(ExposurePart(True, False, shutter.flash_windows(flash.pulse_s), share))
    return parts


def in_rows(light: TracedLight, share: NDArray[np.float64] | None) -> TracedLight:
    """Light with a factor `(h,)` for each row; None for 1."""
    if share is None:
        return light
    factor = share.astype(np.float32)[:, None, None]
    square = np.square(factor[..., 0])
    variance = light.variance
    return replace(
        light,
        flash=light.flash * factor,
        sky_and_sun=light.sky_and_sun * factor,
        indirect=light.indirect * factor,
        variance=replace(variance, direct=variance.direct * square, indirect=variance.indirect * square),
    )


def sum_of_parts(parts: Sequence[TracedLight]) -> TracedLight:
    """The light of all parts together; albedo, normal and coverage are those of the last.

    Numbers of samples are sums over the parts. The variance of one sample is such that the variance of the
    mean, as `AdaptiveSampler` computes it, is the sum of those of the parts.
    """
    *_, last = parts
    if len(parts) == 1:
        return last
    return replace(
        last,
        flash=_sum([part.flash for part in parts]),
        sky_and_sun=_sum([part.sky_and_sun for part in parts]),
        indirect=_sum([part.indirect for part in parts]),
        variance=_sum_of_variances([part.variance for part in parts]),
    )


def _sum_of_variances(parts: Sequence[SampleVariance]) -> SampleVariance:
    """Variances of one sample; see `sum_of_parts`.

    From the variance s^2 of one sample, that of the mean of n is s^2 n^(-3/2) for direct light, and s^2 / n
    for indirect light.
    """
    samples = np.asarray(_sum([part.samples for part in parts]), np.int32)
    indirect_samples = sum(part.indirect_samples for part in parts)
    direct = _sum([part.direct * part.samples.astype(np.float32) ** np.float32(-1.5) for part in parts])
    indirect = _sum([part.indirect / np.float32(max(part.indirect_samples, 1)) for part in parts])
    return SampleVariance(
        samples,
        indirect_samples,
        np.asarray(direct * samples.astype(np.float32) ** np.float32(1.5)),
        np.asarray(indirect * np.float32(max(indirect_samples, 1))),
        parts[0].white,
    )


def _sum(images: Sequence[NDArray[Any]]) -> NDArray[Any]:
    total = images[0].copy()
    for image in images[1:]:
        total += image
    return total


_REFINEMENT_ROUNDS: Final = 3  # chosen

FrameLight = ChannelLight | BandLight


@dataclass(frozen=True, eq=False)
class Sampling:
    """Numbers of samples; powers of two spread best.

    Attributes:
        samples: per pixel, everywhere.
        indirect: how many of these trace indirect light as well.
        bounces: scattering events after the first hit.
        required: from the samples so far to the number that each pixel should have, `(h * w,)`; None to take
            `samples` everywhere.
        most_bounces: if above `bounces`, paths go on after these until Russian roulette ends them, for up to
            this many.
    """

    samples: int
    indirect: int
    bounces: int
    required: Callable[[SampleAccumulator], Counts] | None = None
    most_bounces: int = 0

    @property
    def lengths(self) -> tuple[int, int]:
        """`bounces` and `most_bounces`."""
        return self.bounces, self.most_bounces


def trace(
    scene: LightScene,
    rays: CameraRays,
    response: SpectralResponse,
    flash: Flash | None,
    sky: SkyTables | None,
    sampling: Sampling,
    seed: int,
) -> TracedLight:
    """Trace the light that reaches each pixel of a camera in a scene with materials over its response."""
    return trace_rows(frame_light(scene, rays, response, flash, sky, sampling.lengths, seed), sampling)


def frame_light(
    scene: LightScene,
    rays: CameraRays,
    response: SpectralResponse,
    flash: Flash | None,
    sky: SkyTables | None,
    lengths: tuple[int, int],
    seed: int,
    gathering: Gathering | None = None,
) -> FrameLight:
    """What `trace_rows` traces: the light of samples in the channels, or in the bands, of a sensor.

    Bands are traced along paths, with or without `gathering`.
    """
    if response.by_band:
        return BandLight(scene, rays, response, flash, sky, lengths, seed)
    return ChannelLight(frame_tables(scene, rays, response, flash, sky), lengths, seed, gathering)


def trace_rows(light: FrameLight, sampling: Sampling, rows: slice = slice(None)) -> TracedLight:
    """Trace the light that reaches the pixels of some rows, with the samples that `trace` takes there.

    `Sampling.required` sees these rows alone.
    """
    width = light.tables.rays.width
    top, bottom, _ = rows.indices(light.tables.rays.height)
    within = (top * width, bottom * width)
    accumulator = light.accumulator(bottom - top)
    first = 0
    # The first samples carry all light in one traversal; the rest of the minimum stops at the first hit.
    if light.tables.has_lights:
        first = min(sampling.indirect, sampling.samples)
        accumulator.add_all(light.sum_all(first, within), first)
    if sampling.samples > first:
        remaining = sampling.samples - first
        accumulator.add_direct(light.sum_direct(None, first, remaining, within), remaining)

    if not light.tables.has_lights or sampling.required is None:
        return accumulator.light()

    # Each round estimates the need anew from all samples so far, and continues the sequences of pixels that
    # need more: those with the same first and last sample are traced together.
    for _ in range(_REFINEMENT_ROUNDS):
        refinements = list(_refinements(accumulator.samples, sampling.required(accumulator)))
        for begin, end, pixels in refinements:
            sums = light.sum_direct(pixels + within[0], begin, end - begin)
            accumulator.add_direct(sums, end - begin, pixels)
        if not refinements:
            break
    return accumulator.light()


def _refinements(taken: Counts, required: Counts) -> Iterator[tuple[int, int, NDArray[np.int64]]]:
    """First sample, end sample and pixels of each refinement."""
    for begin in np.flatnonzero(np.bincount(taken)).tolist():
        pixels = np.flatnonzero((taken == begin) & (required > begin))
        for end in np.flatnonzero(np.bincount(required[pixels])).tolist():
            yield begin, end, pixels[required[pixels] == end]
