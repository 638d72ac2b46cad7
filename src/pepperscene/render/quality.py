"""Qualities: how many samples are traced for a frame, and how."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Final, Literal, get_args

from pepperscene.errors import ArgumentError

MIN_TARGET: Final = 0.01
MAX_TARGET: Final = 10.0
"""Chosen: smaller targets take a day per frame, larger ones need no more samples than a draft."""

Integrator = Literal["flash", "path"]
Sampler = Literal["independent", "stratified", "multijitter", "orthogonal", "ldsampler"]


@dataclass(frozen=True)
class Gathering:
    """How the indirect light of a frame is gathered.

    Attributes:
        directions: rays from the first hit of each sample.
        paths: about how many fill the cache, over all of the image.
        sun_at_hits: whether second hits have a shadow ray to the sun each, instead of the mean sunlight of a
            cell.
    """

    directions: int
    paths: int
    sun_at_hits: bool = False


@dataclass(frozen=True)
class Quality:
    """Numbers of samples, and the methods of a frame.

    Attributes:
        samples: per pixel, everywhere; the minimum if sampling is adaptive.
        soft: how many of them trace indirect light as well: daylight on surfaces, and light that was
            scattered more than once.
        most: largest number per pixel, for adaptive sampling of edges.
        bounces: scattering events after the first hit. Of the light of `barth2018` two lose 0.15 %, one 1 %.
        most_bounces: where that would lose much (see `transport.path_lengths`), paths go on until Russian
            roulette ends them, for up to this many bounces; 0 for `bounces` in all frames.
        target: standard error of a pixel's mean over the sensor noise at that signal, at which sampling
            stops; None for `samples` in every pixel, or more where direct light has more noise than is in
            balance with light that is gathered in several `directions`.
        denoise: whether indirect light is denoised.
        integrator: "flash" for `pepperscene.render.transport.trace`, which traces daylight too; "path" for
            Mitsuba's own path tracer with `samples` in every pixel, the reference to compare with.
        sampler: for "path"; "flash" has its own.
        soft_by_daylight: `soft` of frames by daylight, or by daylight and a weaker flash, if it is greater,
            but not above `most`: there, with few samples, the denoiser takes the relief of leaves for noise.
        directions: for the same frames, rays from the first hit of each sample of indirect light, which end
            at their second hits: see `transport.gathering`; 0 for paths. With such rays, pixels have at least
            four samples for each of indirect light, but not more than `most`.

    Raises:
        ValueError: a value is out of range or unknown.
    """

    samples: int
    soft: int
    most: int
    bounces: int
    target: float | None
    denoise: bool
    integrator: Integrator = "flash"
    sampler: Sampler = "independent"
    most_bounces: int = 0
    soft_by_daylight: int = 0
    directions: int = 0

    def __post_init__(self) -> None:
        if not 1 <= self.soft <= self.samples <= self.most:
            raise ValueError(f"quality: 1 <= soft <= samples <= most must hold, not {self}")
        if min(self.bounces, self.most_bounces, self.soft_by_daylight, self.directions) < 0 or (
            self.target is not None and not self.target > 0.0
        ):
            raise ValueError(f"quality: counts must be at least 0 and the target above 0, not {self}")
        if self.directions and not self.bounces:
            raise ValueError(f"quality: directions need at least one bounce, not {self}")
        if self.integrator not in get_args(Integrator) or self.sampler not in get_args(Sampler):
            raise ValueError(f"quality: unknown integrator or sampler in {self}")

    def for_light(self, *, mainly_daylight: bool) -> Quality:
        """The numbers of samples of frames whose light is mainly daylight, or of others."""
        if not mainly_daylight:
            return replace(self, directions=0)
        soft = max(min(self.soft_by_daylight, self.most), self.soft)
        least = min(_SAMPLES_PER_SOFT * soft, self.most) if self.directions else soft
        return replace(self, soft=soft, samples=max(self.samples, least))

    def gathering(self, pixels: int, *, mainly_sun: bool = False) -> Gathering | None:
        """How the indirect light of an image with so many pixels is gathered; None along paths.

        `mainly_sun` says whether most daylight comes from the sun, whose patches are smaller than cells. With
        a shadow ray for each second hit, frames 160 and 1 of `randomised` have 9 and 3 % less error for 5 %
        more time: there the sun has .80 and .73 of the light. Where it has .3 (`greenhouse`), and in drafts,
        the error is not less. Chosen: half.
        """
        if self.directions == 0:
            return None
        paths = min(max(int(self.soft * pixels * _PATHS_PER_SAMPLE), _LEAST_PATHS), _MOST_PATHS)
        return Gathering(self.directions, paths, mainly_sun and self.directions > 1)


_SAMPLES_PER_SOFT: Final = 4
"""Chosen: in `greenhouse`, the error of a draft is 12 % less with four than with two, for 9 to 14 % more
time, and that of a standard frame 7 % less than with one, for a tenth."""
_PATHS_PER_SAMPLE: Final = 1 / 8
"""Paths that fill the cache for each sample of indirect light. Chosen: with twice as many, the error of a
frame of `greenhouse` is 2 % less, for 15 % more time; with eight times as many 5 % less, for twice the
time."""
_LEAST_PATHS, _MOST_PATHS = 1 << 17, 1 << 20
"""Chosen: fewer are a small part of a frame's time, and more would be a wavefront of their own."""
_LONGEST: Final = 64
"""Chosen: in `greenhouse` at 850 nm, longer paths carry less than 1e-4 of the light."""

QUALITIES: Final[Mapping[str, Quality]] = {
    "draft": Quality(
        samples=4,
        soft=1,
        most=64,
        bounces=1,
        target=None,
        denoise=True,
        most_bounces=_LONGEST,
        soft_by_daylight=2,
        directions=1,
    ),
    "standard": Quality(
        samples=4,
        soft=2,
        most=256,
        bounces=2,
        target=0.15,
        denoise=True,
        most_bounces=_LONGEST,
        # Chosen: the error of soft light in `greenhouse` is a third less than with 2, for 8 s of CPU a frame.
        soft_by_daylight=8,
        directions=2,
    ),
    "reference": Quality(
        samples=256, soft=256, most=256, bounces=6, target=None, denoise=False, most_bounces=_LONGEST
    ),
}


def find_quality(name: str) -> Quality:
    """Return the quality of a name.

    Raises:
        InputError: there is none.
    """
    if name not in QUALITIES:
        raise ArgumentError("quality", f"unknown quality {name!r}; allowed are {', '.join(QUALITIES)}")
    return QUALITIES[name]


def check_depth_camera_quality(quality: Quality) -> None:
    """Raise `ArgumentError` for a quality that cannot trace the imagers of a depth camera.

    Mitsuba's path tracer has no emitter for the dots of a projector.
    """
    if quality.integrator != "flash":
        problem = f'the outputs of a depth camera need the integrator "flash", not "{quality.integrator}"'
        raise ArgumentError("quality", problem)


def resolve_quality(quality: str | Quality, target_error: float | None = None) -> Quality:
    """Return a quality by name or as it is, with another target and enough samples for it if one is given.

    Args:
        quality: a `Quality`, or a name out of `QUALITIES`.
        target_error: standard error over the sensor noise at which sampling stops.

    Raises:
        InputError: unknown quality, or target out of range.
    """
    base = find_quality(quality) if isinstance(quality, str) else quality
    if target_error is None:
        return base
    if not MIN_TARGET <= target_error <= MAX_TARGET:
        raise ArgumentError(
            "target_error",
            f"must be between {MIN_TARGET:g} and {MAX_TARGET:g} (error of the light over the sensor noise), "
            f"not {target_error:g}",
        )
    # Errors of direct light fall with samples^(-3/4), which sets `most`; `soft` grows with the ratio.
    finer = max((base.target or QUALITIES["standard"].target or 1.0) / target_error, 1.0)
    maximum = 2 ** math.ceil(math.log2(max(base.most, 64) * finer ** (4 / 3)))
    soft = math.ceil(base.soft * finer)
    samples = max(base.samples, 2 ** math.ceil(math.log2(soft)))
    by_daylight = 2 ** math.ceil(math.log2(base.soft_by_daylight * finer)) if base.soft_by_daylight else 0
    most = max(maximum, samples, by_daylight)
    return replace(
        base,
        target=float(target_error),
        most=most,
        soft=soft,
        samples=samples,
        soft_by_daylight=by_daylight,
    )
