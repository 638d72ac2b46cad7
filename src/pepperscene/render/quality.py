"""How much light is traced for a frame."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Final, Literal, get_args

from pepperscene.errors import ArgumentError

MOST_EXACT: Final = 0.01
LEAST_EXACT: Final = 10.0
"""Chosen: targets beyond take a day a frame, or no more samples than a draft."""

Integrator = Literal["flash", "path"]
Sampler = Literal["independent", "stratified", "multijitter", "orthogonal", "ldsampler"]


@dataclass(frozen=True)
class Quality:
    """How much light is traced.

    Attributes:
        samples: per pixel, everywhere; with an adaptive stop the least.
        soft: how many of them carry soft light as well: daylight on surfaces, and light scattered more than
            once.
        most: per pixel where edges ask for more.
        bounces: scattering events after the first hit. Of the light of `barth2018` two bounces lose 0.15 %,
            one loses 1 %.
        target: standard error of a pixel's mean over the sensor's noise at that signal, at which sampling
            stops; None for `samples` in every pixel.
        denoise: whether soft light goes through the denoiser.
        integrator: "flash" for the one of `pepperscene.render.transport.trace`, "path" for Mitsuba's own path
            tracer with `samples` in every pixel, the reference to compare with.
        sampler: that "path" draws from; "flash" has its own.
    """

    samples: int
    soft: int
    most: int
    bounces: int
    target: float | None
    denoise: bool
    integrator: Integrator = "flash"
    sampler: Sampler = "independent"

    def __post_init__(self) -> None:
        if not 1 <= self.soft <= self.samples <= self.most:
            raise ValueError(f"1 <= soft <= samples <= most is needed, not {self}")
        if self.bounces < 0 or (self.target is not None and not self.target > 0.0):
            raise ValueError(f"bounces of at least 0 and a target above 0 are needed, not {self}")
        if self.integrator not in get_args(Integrator) or self.sampler not in get_args(Sampler):
            raise ValueError(f"unknown integrator or sampler: {self}")


QUALITIES: Final[Mapping[str, Quality]] = {
    "draft": Quality(samples=4, soft=1, most=4, bounces=1, target=None, denoise=True),
    "standard": Quality(samples=4, soft=2, most=64, bounces=2, target=0.15, denoise=True),
    "reference": Quality(samples=256, soft=256, most=256, bounces=6, target=None, denoise=False),
}


def find_quality(name: str) -> Quality:
    """The quality of that name.

    Raises:
        InputError: there is none.
    """
    if name not in QUALITIES:
        raise ArgumentError("quality", f"unknown quality {name!r}; allowed are {', '.join(QUALITIES)}")
    return QUALITIES[name]


def resolve_quality(quality: str | Quality, target_error: float | None = None) -> Quality:
    """A quality, or the one of that name, with another target where one is given.

    Args:
        quality: itself or its name.
        target_error: standard error over the sensor's noise at which sampling stops. A quality that has none
            gets it with as many samples at most as are worth it.

    Raises:
        InputError: there is no such quality, or the target is not above 0 or asks for what takes forever.
    """
    found = find_quality(quality) if isinstance(quality, str) else quality
    if target_error is None:
        return found
    if not MOST_EXACT <= target_error <= LEAST_EXACT:
        raise ArgumentError(
            "target_error",
            f"must lie in [{MOST_EXACT:g}, {LEAST_EXACT:g}], the light's error over the sensor's noise, "
            f"not {target_error:g}",
        )
    # Errors of the sharp light fall with samples^(-3/4): the most goes with that; soft light with the ratio.
    finer = max((found.target or QUALITIES["standard"].target or 1.0) / target_error, 1.0)
    most = 2 ** math.ceil(math.log2(max(found.most, 64) * finer ** (4 / 3)))
    soft = math.ceil(found.soft * finer)
    samples = max(found.samples, 2 ** math.ceil(math.log2(soft)))
    return replace(found, target=float(target_error), most=max(most, samples), soft=soft, samples=samples)
