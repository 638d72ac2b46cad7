"""The compared settings: integrators, sample counts, samplers, denoiser, target errors, named qualities."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any, Final, get_args

from pepperscene.render import QUALITIES, Quality, resolve_quality
from pepperscene.render.quality import Sampler

NAMED: Final = "ours, by name"
ADAPTIVE: Final = "ours, adaptive"
FIXED: Final = "ours, fixed samples"
NO_DENOISER: Final = "ours, no denoiser"
FULL_SCENE: Final = "ours, whole scene"
PLAIN: Final = "plain path"
PATH: Final = "path, "
"""Families of settings: one line each in the plot."""

OUR_FAMILIES: Final = (NAMED, ADAPTIVE, FIXED, NO_DENOISER)


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


def settings(*, quick: bool = False) -> tuple[Setting, ...]:
    """All settings by family, each family from the cheapest on.

    Args:
        quick: only a few cheap ones, as a test.
    """
    standard = QUALITIES["standard"]
    if quick:
        return (
            Setting(NAMED, "draft", QUALITIES["draft"]),
            _adaptive_setting(0.5),
            *_fixed_settings(1, 4),
            *_path_settings(PLAIN, "independent", 1, 4),
        )
    samplers: tuple[Sampler, ...] = get_args(Sampler)
    return (
        *(Setting(NAMED, name, QUALITIES[name]) for name in ("draft", "standard")),
        *(_adaptive_setting(target) for target in (0.5, 0.25, 0.1, 0.07)),
        *_fixed_settings(1, 4, 16, 64),
        Setting(FULL_SCENE, "standard", standard, full_scene=True),
        *_path_settings(PLAIN, "independent", 1, 4, 16, 64, 256),
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


def _fixed_settings(*counts: int) -> list[Setting]:
    """Equal samples in every pixel, a quarter of them for soft light; with and without denoiser."""
    return [
        _fixed_setting(family, count, soft=max(count // 4, 1), denoise=denoise)
        for family, denoise in ((FIXED, True), (NO_DENOISER, False))
        for count in counts
    ]


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
