"""What is compared: integrators, samples, samplers, denoiser, target errors and the named qualities."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any, Final, get_args

from pepperscene.render import QUALITIES, Quality, resolve_quality
from pepperscene.render.quality import Sampler

OURS: Final = "ours, adaptive"
OURS_FIXED: Final = "ours, fixed samples"
OURS_RAW: Final = "ours, no denoiser"
NAMED: Final = "ours, by name"
WHOLE: Final = "ours, whole scene"
PLAIN: Final = "plain path"
PATH: Final = "path, "
"""Families of settings: a line each in the plot."""

OUR_FAMILIES: Final = (NAMED, OURS, OURS_FIXED, OURS_RAW)


@dataclass(frozen=True)
class Setting:
    """One way to render a frame.

    Attributes:
        family: settings that differ in effort alone.
        name: within the family.
        quality: what is traced.
        whole: True keeps what frames cannot tell of the scene, which builds leave out.
    """

    family: str
    name: str
    quality: Quality
    whole: bool = False

    def effort(self) -> dict[str, Any]:
        """The quality's values, for tables."""
        return {**dataclasses.asdict(self.quality), "whole_scene": self.whole}


def settings(*, quick: bool = False) -> tuple[Setting, ...]:
    """The settings in the order of their families, each family from the cheapest on.

    Args:
        quick: a few cheap ones, to see that all works.
    """
    return (
        *_named(("draft",) if quick else ("draft", "standard")),
        *_adaptive((0.5,) if quick else (0.5, 0.25, 0.1, 0.07)),
        *_fixed((1, 4) if quick else (1, 4, 16, 64)),
        *(() if quick else (Setting(WHOLE, "standard", QUALITIES["standard"], whole=True),)),
        *_path((1, 4) if quick else (1, 4, 16, 64, 256), "independent", PLAIN),
        *(one for name in _other_samplers(quick) for one in _path((16, 64), name, f"{PATH}{name}")),
    )


def _named(names: tuple[str, ...]) -> list[Setting]:
    return [Setting(NAMED, name, QUALITIES[name]) for name in names]


def _adaptive(targets: tuple[float, ...]) -> list[Setting]:
    """The standard quality with other target errors."""
    return [Setting(OURS, f"target {one:g}", resolve_quality("standard", one)) for one in targets]


def _fixed(counts: tuple[int, ...]) -> list[Setting]:
    """As many samples everywhere, a quarter of them with soft light, with and without denoiser."""
    standard = QUALITIES["standard"]
    found = []
    for family, denoise in ((OURS_FIXED, True), (OURS_RAW, False)):
        for count in counts:
            quality = dataclasses.replace(
                standard, samples=count, soft=max(count // 4, 1), most=count, target=None, denoise=denoise
            )
            found.append(Setting(family, f"{count} spp", quality))
    return found


def _path(counts: tuple[int, ...], sampler: Sampler, family: str) -> list[Setting]:
    """Mitsuba's own path tracer with as many bounces as the standard quality."""
    standard = QUALITIES["standard"]
    return [
        Setting(
            family,
            f"{count} spp",
            dataclasses.replace(
                standard,
                samples=count,
                soft=count,
                most=count,
                target=None,
                denoise=False,
                integrator="path",
                sampler=sampler,
            ),
        )
        for count in counts
    ]


def _other_samplers(quick: bool) -> tuple[Sampler, ...]:
    return () if quick else tuple(name for name in get_args(Sampler) if name != "independent")
