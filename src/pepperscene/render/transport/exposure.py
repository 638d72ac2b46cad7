"""An exposure in parts: daylight over all of it, and the flash in its pulse, each traced at its own times.

Motion that blurs the daylight of 3 ms is sharp in the light of a pulse of 50 us. If samples at random times
carried both lights, one in sixty would see the flash; traced separately, every sample sees its light.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pepperscene.camera import Camera
from pepperscene.camera.sensor.rows import RowWindows
from pepperscene.render.transport.accumulate import SampleVariance, TracedLight


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
