"""Comparison of two sets part by part: kinds of organs, class fractions, positions, light and appearance."""

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
from pepperscene.colour.comparison.bootstrap import (
    Estimate,
    Floats,
    estimate_angles,
    estimate_values,
    unknown_estimate,
)
from pepperscene.colour.comparison.measure import PIXELS, SetMeasures, Sets
from pepperscene.colour.comparison.result import (
    AppearanceComparison,
    KindComparison,
    KindMeasures,
    LightComparison,
)
from pepperscene.colour.statistics import circular_emd, delta_e_2000

_BACKGROUND: Final = OrganClass.BACKGROUND.name.lower()
_ORDER: Final = [organ_class.name.lower() for organ_class in OrganClass]
_ALL_GREY: Final = "all its pixels are grey"
_NO_CLASS: Final = "given for classes only"
_NO_DIRECTION: Final = "its hues have no direction"


def common_kinds(sets: Sets) -> list[str]:
    """Kinds that are compared, in the order of the classes.

    The whole centre of the images comes first, if both sets have photographs; then classes in either set,
    each followed by its stages if both sets have them.
    """
    staged = sets[0].classes_with_stages() & sets[1].classes_with_stages()
    names = set[str]()
    for side in sets:
        names |= side.kinds.keys()
        names |= {organ.name.lower() for organ in OrganClass if side.statistics.class_pixels[organ]}
    whole = [WHOLE] if all(WHOLE in side.kinds for side in sets) else []
    return whole + sorted(
        (kind for kind in names - {WHOLE} if "." not in kind or kind.partition(".")[0] in staged),
        key=lambda kind: (_ORDER.index(kind.partition(".")[0]), kind),
    )


def compare_kind(kind: str, sets: Sets) -> KindComparison:
    """All measures of a kind; those that are unknown give the reason."""
    place_similarity = _compare_places(kind, sets)
    sides = [_measure_kind(kind, side) for side in sets]
    rows = [sums for side in sets if (sums := side.totals(kind)) is not None]
    if len(rows) < 2:
        unseen = next(side for side in sets if kind not in side.kinds)
        unknown = unknown_estimate(missing_reason(kind, unseen))
        return KindComparison(kind, unknown, unknown, unknown, *place_similarity, *sides)
    resampled = min(side.kinds[kind].count for side in sets) > 1
    spectra = [similarity.hue_spectra(sums) for sums in rows]
    return KindComparison(
        kind,
        similarity.estimate_pair(similarity.correlation, spectra, resampled, _ALL_GREY),
        similarity.estimate_pair(circular_emd, spectra, resampled, _ALL_GREY),
        estimate_values(delta_e_2000(*(similarity.mean_labs(sums) for sums in rows)), resampled),
        *place_similarity,
        *sides,
    )


def _measure_kind(kind: str, side: SetMeasures) -> KindMeasures:
    fraction = _class_fraction(kind, side)
    sums = side.totals(kind)
    if sums is None:
        unknown = unknown_estimate(missing_reason(kind, side))
        return KindMeasures(0, 0, unknown, unknown, unknown, (unknown,) * 3, (unknown,) * 3, fraction)
    resampled = side.kinds[kind].count > 1
    spectra = similarity.hue_spectra(sums)
    return KindMeasures(
        side.kinds[kind].count,
        int(sums[0, PIXELS]),
        estimate_angles(similarity.mean_hues(spectra), resampled, _NO_DIRECTION),
        estimate_values(similarity.hue_spreads(spectra), resampled, _NO_DIRECTION),
        estimate_values(similarity.grey_fractions(sums), resampled),
        _estimate_channels(similarity.mean_labs(sums), resampled),
        _estimate_channels(similarity.lab_spreads(sums), resampled),
        fraction,
    )


def _estimate_channels(rows: Floats, resampled: bool) -> tuple[Estimate, Estimate, Estimate]:
    """Estimates of the three columns of `(n, 3)`."""
    first, second, third = (estimate_values(column, resampled) for column in rows.T)
    return first, second, third


def _class_fraction(kind: str, side: SetMeasures) -> Estimate:
    if kind not in _ORDER:
        return unknown_estimate(_NO_CLASS)
    if not side.class_pixels.count:
        return unknown_estimate(unlabelled_reason(side))
    fractions = similarity.class_fractions(side.class_pixels.totals())[:, OrganClass[kind.upper()]]
    return estimate_values(fractions, side.class_pixels.count > 1, f"not labelled in {side.name}")


def _compare_places(kind: str, sets: Sets) -> tuple[Estimate, Estimate]:
    """Correlation and structural similarity of the mean masks of a class."""
    if kind not in _ORDER:
        return (unknown_estimate(_NO_CLASS),) * 2
    organ_class, masks = OrganClass[kind.upper()], []
    for side in sets:
        if not side.places.count:
            return (unknown_estimate(unlabelled_reason(side)),) * 2
        if not side.statistics.class_pixels[organ_class]:
            return (unknown_estimate(absence_reason(side)),) * 2
        masks.append(similarity.mean_masks(side.places.totals(), organ_class))
    resampled = min(side.places.count for side in sets) > 1
    constant = "its mean mask is constant"
    return (
        similarity.estimate_pair(similarity.correlation, masks, resampled, constant),
        similarity.estimate_pair(similarity.ssim, masks, resampled),
    )


def mean_hue_correlation(sets: Sets) -> Estimate:
    """Mean over the plant parts (without background) in both sets, each replicate over the same parts."""
    parts = [
        kind
        for kind in common_kinds(sets)
        if kind in _ORDER and kind != _BACKGROUND and all(kind in side.kinds for side in sets)
    ]
    spectra = [[similarity.hue_spectra(side.kinds[kind].totals()) for side in sets] for kind in parts]
    rows = [similarity.pairwise(similarity.correlation, *pair) for pair in spectra]
    rows = [row for row in rows if np.isfinite(row[0])]
    if not rows:
        return unknown_estimate("the sets have no plant part with hues in common")
    resampled = min(side.kinds[kind].count for kind in parts for side in sets) > 1
    return estimate_values(np.mean(rows, axis=0), resampled)


def correlate_class_fractions(sets: Sets) -> Estimate:
    """Correlation of the class fractions over the classes that both sets know."""
    for side in sets:
        if not side.class_pixels.count:
            return unknown_estimate(unlabelled_reason(side))
    fractions = [similarity.class_fractions(side.class_pixels.totals()) for side in sets]
    values = np.array([similarity.class_fraction_correlation(p, q) for p, q in zip(*fractions, strict=True)])
    resampled = min(side.class_pixels.count for side in sets) > 1
    return estimate_values(values, resampled, "fewer than three classes are labelled in both sets")


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
    kinds = [kind for kind in (WHOLE, *_ORDER) if kind in seen]
    return {kind: AppearanceComparison(*(_measure_appearance(kind, side) for side in sets)) for kind in kinds}


def _measure_appearance(kind: str, side: SetMeasures) -> AppearanceMeasures:
    if kind in side.appearance:
        return measure_appearance(side.appearance[kind], side.scale, kind)
    if not side.has_images:
        return unknown_appearance(unlabelled_reason(side))
    if kind == WHOLE:
        return unknown_appearance(f"no photographs in {side.name}")
    return unknown_appearance(missing_reason(kind, side))


def unlabelled_reason(side: SetMeasures) -> str:
    """Reason why a set has no classes."""
    return f"no labels in {side.name}" if side.has_images else f"{side.name} has patches, not images"


def absence_reason(side: SetMeasures) -> str:
    """Reason why a class has no pixel: it was not labelled, or it does not occur."""
    return f"not labelled in {side.name}" if side.statistics.unlabelled_pixels else f"not seen in {side.name}"


def missing_reason(kind: str, side: SetMeasures) -> str:
    """Reason why the colours of a kind are unknown."""
    if not side.has_images:
        return f"no patch of it in {side.name}"
    if not side.statistics.photograph_count:
        return f"no photographs in {side.name}"
    if not side.statistics.labelled_count:
        return f"no labels in {side.name}"
    if "." not in kind and side.statistics.class_pixels[OrganClass[kind.upper()]]:
        return f"not in the centre of the images of {side.name}"
    return absence_reason(side)
