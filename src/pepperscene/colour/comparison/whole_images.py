"""Comparison of the light of whole images, and of the appearance of images and classes."""

from __future__ import annotations

from typing import Final

import numpy as np

from pepperscene.classes import OrganClass
from pepperscene.colour.comparison import similarity
from pepperscene.colour.comparison.appearance import (
    WHOLE,
    AppearanceMeasures,
    measure_appearance,
    unknown_appearance,
)
from pepperscene.colour.comparison.bootstrap import Estimate, estimate_values, unknown_estimate
from pepperscene.colour.comparison.measure import SetMeasures, Sets
from pepperscene.colour.comparison.reasons import missing_reason, unlabelled_reason
from pepperscene.colour.comparison.result import AppearanceComparison, LightComparison

_KINDS: Final = (WHOLE, *(organ_class.name.lower() for organ_class in OrganClass))


def compare_light(sets: Sets) -> LightComparison:
    """Mean grey values, and similarities of the mean images and of their radial falloff."""
    greys = [_mean_grey(side) for side in sets]
    spreads = [_grey_spread(side) for side in sets]
    if unknown := [grey for grey in greys if grey.value is None]:
        return LightComparison(unknown[0], unknown[0], unknown[0], greys[0], greys[1], *spreads)
    resampled = min(side.light.count for side in sets) > 1
    images = [similarity.mean_images(side.light.totals()) for side in sets]
    falloffs = [similarity.radial_falloffs(rows) for rows in images]
    constant = "a mean image is constant"
    return LightComparison(
        similarity.estimate_pair(similarity.correlation, images, resampled, constant),
        similarity.estimate_pair(similarity.ssim, images, resampled, constant),
        similarity.estimate_pair(similarity.correlation, falloffs, resampled, constant),
        greys[0],
        greys[1],
        *spreads,
    )


def _mean_grey(side: SetMeasures) -> Estimate:
    if side.light.count:
        return estimate_values(similarity.mean_greys(side.light.totals()), side.light.count > 1)
    return unknown_estimate(f"no photographs in {side.name}" if side.has_images else unlabelled_reason(side))


def _grey_spread(side: SetMeasures) -> float | None:
    """Standard deviation of the mean grey value between images; None without photographs."""
    return float(np.std(np.sort(side.statistics.intensities))) if side.light.count else None


def compare_appearance(sets: Sets) -> dict[str, AppearanceComparison]:
    """Whole images, then the classes in either set in their order; nothing for patches."""
    seen = {kind for side in sets for kind in side.appearance}
    kinds = [kind for kind in _KINDS if kind in seen]
    return {kind: AppearanceComparison(*(_measure_appearance(kind, side) for side in sets)) for kind in kinds}


def _measure_appearance(kind: str, side: SetMeasures) -> AppearanceMeasures:
    if kind in side.appearance:
        return measure_appearance(side.appearance[kind], side.scale, kind)
    if not side.has_images:
        return unknown_appearance(unlabelled_reason(side))
    if kind == WHOLE:
        return unknown_appearance(f"no photographs in {side.name}")
    return unknown_appearance(missing_reason(kind, side))
