"""The compared settings: integrators, sample counts, samplers, denoiser, target errors, named qualities."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any, Final, get_args

from pepperscene.render import QUALITIES, Quality, resolve_quality
from pepperscene.render.quality import Sampler

NAMED: Final = "pepperscene, named qualities"
ADAPTIVE: Final = "pepperscene, other target errors"
FIXED: Final = "pepperscene, fixed samples"
NO_DENOISER: Final = "pepperscene, fixed samples without denoiser"
FULL_SCENE: Final = "pepperscene, whole scene"
PLAIN: Final = "path tracer"
PATH: Final = "path tracer with sampler "
"""Families of settings: settings of one family differ in effort only."""

OUR_FAMILIES: Final = (NAMED, ADAPTIVE, FIXED, NO_DENOISER)

_LIGHT_EXPONENT: Final = 4.0 / 3.0
"""Samples that adaptive sampling takes for a target, as a power of 1 / target: see `resolve_quality`."""


@dataclass(frozen=True)
class Setting:
    """One way to render a frame."""

    family: str  # settings of one family differ in effort only
    name: str  # within the family
    quality: Quality  # of the renderer
    full_scene: bool = False  # True also renders what the frames cannot see, which builds leave out

    def effort(self) -> dict[str, Any]:
        """Values of the quality, for tables."""
        return {**dataclasses.asdict(self.quality), "whole_scene": self.full_scene}

    def relative_samples(self, other: Setting) -> float | None:
        """Approximate number of samples relative to another setting; None if their methods differ."""
        ours, others = self.quality, other.quality
        if (ours.target is None) != (others.target is None) or any(
            getattr(ours, name) != getattr(others, name)
            for name in ("integrator", "sampler", "bounces", "denoise")
        ):
            return None
        if ours.target is None or others.target is None:
            return ours.samples / others.samples
        return (others.target / ours.target) ** _LIGHT_EXPONENT


def settings(*, quick: bool = False, all_settings: bool = False) -> tuple[Setting, ...]:
    """Settings by family, the named qualities first and each family from the cheapest on.

    Args:
        quick: only a few cheap ones, as a test.
        all_settings: also fixed samples, no denoiser, the whole scene, and other samplers.
    """
    standard = QUALITIES["standard"]
    named = [Setting(NAMED, name, QUALITIES[name]) for name in ("draft", "standard")]
    if quick:
        return (*named, _adaptive_setting(0.3), *_path_settings(PLAIN, "independent", 4, 16))
    default = (
        *named,
        *(_adaptive_setting(target) for target in (0.3, 0.1, 0.07)),
        *_path_settings(PLAIN, "independent", 4, 16, 64),
    )
    if not all_settings:
        return default
    samplers: tuple[Sampler, ...] = get_args(Sampler)
    return (
        *default,
        *_path_settings(PLAIN, "independent", 256),
        # Equal samples in every pixel, a quarter of them for soft light; with and without denoiser.
        *(
            _fixed_setting(family, count, soft=max(count // 4, 1), denoise=denoise)
            for family, denoise in ((FIXED, True), (NO_DENOISER, False))
            for count in (1, 4, 16, 64)
        ),
        Setting(FULL_SCENE, "standard", standard, full_scene=True),
        *(
            setting
            for name in samplers
            if name != "independent"
            for setting in _path_settings(f"{PATH}{name}", name, 16, 64)
        ),
    )


def _adaptive_setting(target: float) -> Setting:
    """The standard quality with another target error."""
    return Setting(ADAPTIVE, f"target {target:g}", resolve_quality("standard", target))


def _path_settings(family: str, sampler: Sampler, *counts: int) -> list[Setting]:
    """Mitsuba's own path tracer with as many bounces as the standard quality."""
    return [
        _fixed_setting(family, count, soft=count, denoise=False, integrator="path", sampler=sampler)
        for count in counts
    ]


def _fixed_setting(family: str, count: int, **changes: Any) -> Setting:
    base = dataclasses.replace(QUALITIES["standard"], target=None, soft_by_daylight=0)
    quality = dataclasses.replace(base, samples=count, most=count, **changes)
    return Setting(family, f"{count} spp", quality)
