"""Tracing the light of a frame: all light along a pixel's first samples, then more samples of its edges.

The first samples of a pixel trace direct and indirect light along the same rays; where they show edges, more
samples follow that stop at the first hit. `channel_light` and `band_light` say what a sample is.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.camera import Flash
from pepperscene.render.kernel.camera import CameraRays, SpectralResponse
from pepperscene.render.kernel.scene import LightScene, SkyTables
from pepperscene.render.transport.accumulate import Counts, SampleAccumulator, TracedLight
from pepperscene.render.transport.band_light import BandLight
from pepperscene.render.transport.channel_light import ChannelLight
from pepperscene.render.transport.lights import frame_tables

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
) -> FrameLight:
    """What `trace_rows` traces: the light of samples in the channels, or in the bands, of a sensor."""
    if response.by_band:
        return BandLight(scene, rays, response, flash, sky, lengths, seed)
    return ChannelLight(frame_tables(scene, rays, response, flash, sky), lengths, seed)


def trace_rows(light: FrameLight, sampling: Sampling, rows: slice = slice(None)) -> TracedLight:
    """Trace the light that reaches the pixels of some rows, with the samples that `trace` takes there.

    `Sampling.required` sees these rows alone.
    """
    width = light.tables.rays.width
    top, bottom, _ = rows.indices(light.tables.rays.height)
    within = (top * width, bottom * width)
    accumulator = light.accumulator(bottom - top)
    first = 0
    # One traversal for all light, then the samples without indirect light.
    if light.tables.has_lights:
        first = min(sampling.indirect, sampling.samples)
        accumulator.add_all(light.sum_all(first, within), first)
    if sampling.samples > first:
        remaining = sampling.samples - first
        accumulator.add_direct(light.sum_direct(None, first, remaining, within), remaining)

    if not light.tables.has_lights or sampling.required is None:
        return accumulator.light()

    # Continue the sample sequences of pixels that need more.
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
