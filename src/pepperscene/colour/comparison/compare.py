"""Similarity of two image sets, or of an image set and patches of measured colour.

The measures of Barth et al. 2018, sections 3.1.1 and 4.1.2 (class fractions, spatial distributions, hue
spectra, light), each as a number with its confidence interval, and colours in CIELAB.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Final

import numpy as np

from pepperscene.classes import OrganClass
from pepperscene.colour.comparison import similarity
from pepperscene.colour.comparison.appearance import (
    WHOLE,
    WIDTH_PX,
    AppearanceMeasures,
    Scale,
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
from pepperscene.colour.comparison.measure import PIXELS, OnProgress, SetMeasures, measure_set
from pepperscene.colour.comparison.result import (
    AppearanceComparison,
    Comparison,
    KindComparison,
    KindMeasures,
    LightComparison,
)
from pepperscene.colour.patches.patch import PatchSet
from pepperscene.colour.statistics import circular_emd, delta_e_2000
from pepperscene.dataset import ImageSet
from pepperscene.errors import ArgumentError

DEFAULT_LIMIT: Final = 1000
"""Chosen: a mean over 1,000 images is known to 3 % of the spread between them."""

_BACKGROUND: Final = OrganClass.BACKGROUND.name.lower()
_ORDER: Final = [organ_class.name.lower() for organ_class in OrganClass]

_ALL_GREY: Final = "all its pixels are grey"
_NO_DIRECTION: Final = "its hues have no direction"

Sets = tuple[SetMeasures, SetMeasures]


def compare(
    first: str | Path | ImageSet | PatchSet,
    second: str | Path | ImageSet | PatchSet,
    *,
    limit: int | None = DEFAULT_LIMIT,
    width_px: int = WIDTH_PX,
    pixel_mm: tuple[float, float] | None = None,
    on_progress: OnProgress | None = None,
) -> Comparison:
    """Compare two sets of images, or a set and patches of measured colour.

    Colours are those of the central 300 x 300 pixels of each image, as in the paper; class fractions,
    spatial distributions and light those of whole images. Every number has a 95 % interval from 200
    bootstrap replicates over the images of both sets, unless a set has one image (of a kind) only. The
    same images give the same numbers, in any order.

    Args:
        first: a set of images or patches, or the path of one (see `open_images` and `open_patches`).
        second: the second set; with patches, only colours are compared.
        limit: at most so many images of each set are measured, evenly spaced; None measures all.
        width_px: width to which images are reduced before their textures are measured; narrower images have
            none.
        pixel_mm: size of a pixel of each set on the plants, in millimetres. If given, the finer set is
            reduced to the scale of the coarser one, instead of both to one width.
        on_progress: called after each measured image with the number measured and the total.

    Raises:
        InputError: a path is no set of images or patches, or a file is damaged.
        ArgumentError: a width or a pixel size is not positive.
    """
    scales = _scales(width_px, pixel_mm)
    sets = (
        measure_set(first, limit, on_progress, scales[0]),
        measure_set(second, limit, on_progress, scales[1]),
    )
    # A set against itself, or two folders of one name, need different names.
    if sets[0].name == sets[1].name:
        for side, letter in zip(sets, "AB", strict=True):
            side.name = f"{side.name} ({letter})"
    return Comparison(
        *sets,
        kinds={kind: _compare_kind(kind, sets) for kind in _common_kinds(sets)},
        hue_correlation=_mean_hue_correlation(sets),
        share_correlation=_class_fraction_correlation(sets),
        light=_compare_light(sets),
        appearance=_compare_appearance(sets),
    )


def _scales(width_px: int, pixel_mm: tuple[float, float] | None) -> tuple[Scale, Scale]:
    """Scales of both sets, at which pixels have one size on the plants or images have one width."""
    if width_px < 1:
        raise ArgumentError("width_px", f"must be at least 1, not {width_px}")
    if pixel_mm is None:
        return Scale(width_px), Scale(width_px)
    if len(pixel_mm) != 2 or not all(0.0 < size < float("inf") for size in pixel_mm):
        raise ArgumentError("pixel_mm", f"must be two sizes above 0 in millimetres, not {pixel_mm}")
    first, second = (Scale(width_px, size / max(pixel_mm)) for size in pixel_mm)
    return first, second


def _common_kinds(sets: Sets) -> list[str]:
    """Classes in either set, and their stages if both sets have them, in the order of the classes."""
    staged = sets[0].classes_with_stages() & sets[1].classes_with_stages()
    names = set[str]()
    for side in sets:
        names |= side.kinds.keys()
        names |= {organ.name.lower() for organ in OrganClass if side.statistics.class_pixels[organ]}
    return sorted(
        (kind for kind in names if "." not in kind or kind.partition(".")[0] in staged),
        key=lambda kind: (_ORDER.index(kind.partition(".")[0]), kind),
    )


def _estimate_pair(
    measure: Callable[[Floats, Floats], float],
    rows: list[Floats],
    resampled: bool,
    why: str = "it is not defined",
) -> Estimate:
    """Estimate a measure of two sets from their rows, the plain ones first."""
    return estimate_values(similarity.pairwise(measure, *rows, resampled=resampled), resampled, why)


# --- kinds --------------------------------------------------------------------------------------------------


def _compare_kind(kind: str, sets: Sets) -> KindComparison:
    """All measures of a kind; those that are unknown give the reason."""
    place_similarity = _compare_places(kind, sets)
    sides = [_measure_kind(kind, side) for side in sets]
    rows = [sums for side in sets if (sums := side.totals(kind)) is not None]
    if len(rows) < 2:
        unseen = next(side for side in sets if kind not in side.kinds)
        unknown = unknown_estimate(_missing_reason(kind, unseen))
        return KindComparison(kind, unknown, unknown, unknown, *place_similarity, *sides)
    resampled = min(side.kinds[kind].count for side in sets) > 1
    spectra = [similarity.hue_spectra(sums) for sums in rows]
    return KindComparison(
        kind,
        _estimate_pair(similarity.correlation, spectra, resampled, _ALL_GREY),
        _estimate_pair(circular_emd, spectra, resampled, _ALL_GREY),
        estimate_values(delta_e_2000(*(similarity.mean_labs(sums) for sums in rows)), resampled),
        *place_similarity,
        *sides,
    )


def _measure_kind(kind: str, side: SetMeasures) -> KindMeasures:
    fraction = _class_fraction(kind, side)
    sums = side.totals(kind)
    if sums is None:
        unknown = unknown_estimate(_missing_reason(kind, side))
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
    if "." in kind:
        return unknown_estimate("given for classes, not for their stages")
    if not side.class_pixels.count:
        return unknown_estimate(_unlabelled_reason(side))
    fractions = similarity.class_fractions(side.class_pixels.totals())[:, OrganClass[kind.upper()]]
    return estimate_values(fractions, side.class_pixels.count > 1, f"not labelled in {side.name}")


def _compare_places(kind: str, sets: Sets) -> tuple[Estimate, Estimate]:
    """Correlation and structural similarity of the mean masks of a class."""
    masks = []
    for side in sets:
        if "." in kind:
            return (unknown_estimate("given for classes, not for their stages"),) * 2
        if not side.places.count:
            return (unknown_estimate(_unlabelled_reason(side)),) * 2
        organ_class = OrganClass[kind.upper()]
        if not side.statistics.class_pixels[organ_class]:
            return (unknown_estimate(_absence_reason(side)),) * 2
        masks.append(similarity.mean_masks(side.places.totals(), organ_class))
    resampled = min(side.places.count for side in sets) > 1
    constant = "its mean mask is constant"
    return (
        _estimate_pair(similarity.correlation, masks, resampled, constant),
        _estimate_pair(similarity.ssim, masks, resampled),
    )


# --- complete sets -----------------------------------------------------------------------------------------


def _mean_hue_correlation(sets: Sets) -> Estimate:
    """Mean over the plant parts (without background) in both sets, each replicate over the same parts."""
    parts = [
        kind
        for kind in _common_kinds(sets)
        if "." not in kind and kind != _BACKGROUND and all(kind in side.kinds for side in sets)
    ]
    spectra = [[similarity.hue_spectra(side.kinds[kind].totals()) for side in sets] for kind in parts]
    rows = [similarity.pairwise(similarity.correlation, *pair) for pair in spectra]
    rows = [row for row in rows if np.isfinite(row[0])]
    if not rows:
        return unknown_estimate("the sets have no plant part with hues in common")
    resampled = min(side.kinds[kind].count for kind in parts for side in sets) > 1
    return estimate_values(np.mean(rows, axis=0), resampled)


def _class_fraction_correlation(sets: Sets) -> Estimate:
    for side in sets:
        if not side.class_pixels.count:
            return unknown_estimate(_unlabelled_reason(side))
    fractions = [similarity.class_fractions(side.class_pixels.totals()) for side in sets]
    values = np.array([similarity.class_fraction_correlation(p, q) for p, q in zip(*fractions, strict=True)])
    resampled = min(side.class_pixels.count for side in sets) > 1
    return estimate_values(values, resampled, "fewer than three classes are labelled in both sets")


def _compare_light(sets: Sets) -> LightComparison:
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
        _estimate_pair(similarity.correlation, images, resampled, constant),
        _estimate_pair(similarity.ssim, images, resampled, constant),
        _estimate_pair(similarity.correlation, falloffs, resampled, constant),
        greys[0],
        greys[1],
        *spreads,
    )


def _mean_grey(side: SetMeasures) -> Estimate:
    if side.light.count:
        return estimate_values(similarity.mean_greys(side.light.totals()), side.light.count > 1)
    return unknown_estimate(f"no photographs in {side.name}" if side.has_images else _unlabelled_reason(side))


def _grey_spread(side: SetMeasures) -> float | None:
    """Standard deviation of the mean grey value between images; None without photographs."""
    return float(np.std(np.sort(side.statistics.intensities))) if side.light.count else None


def _compare_appearance(sets: Sets) -> dict[str, AppearanceComparison]:
    """Whole images, then the classes in either set in their order; nothing for patches."""
    seen = {kind for side in sets for kind in side.appearance}
    kinds = [kind for kind in (WHOLE, *_ORDER) if kind in seen]
    return {kind: AppearanceComparison(*(_measure_appearance(kind, side) for side in sets)) for kind in kinds}


def _measure_appearance(kind: str, side: SetMeasures) -> AppearanceMeasures:
    if kind in side.appearance:
        return measure_appearance(side.appearance[kind], side.scale, kind)
    if not side.has_images:
        return unknown_appearance(_unlabelled_reason(side))
    if kind == WHOLE:
        return unknown_appearance(f"no photographs in {side.name}")
    return unknown_appearance(_missing_reason(kind, side))


# --- reasons for missing values -----------------------------------------------------------------------------


def _unlabelled_reason(side: SetMeasures) -> str:
    return f"no labels in {side.name}" if side.has_images else f"{side.name} has patches, not images"


def _absence_reason(side: SetMeasures) -> str:
    """Reason why a class has no pixel: it was not labelled, or it does not occur."""
    return f"not labelled in {side.name}" if side.statistics.unlabelled_pixels else f"not seen in {side.name}"


def _missing_reason(kind: str, side: SetMeasures) -> str:
    """Reason why the colours of a kind are unknown."""
    if not side.has_images:
        return f"no patch of it in {side.name}"
    if not side.statistics.photograph_count:
        return f"no photographs in {side.name}"
    if not side.statistics.labelled_count:
        return f"no labels in {side.name}"
    if "." not in kind and side.statistics.class_pixels[OrganClass[kind.upper()]]:
        return f"not in the centre of the images of {side.name}"
    return _absence_reason(side)
