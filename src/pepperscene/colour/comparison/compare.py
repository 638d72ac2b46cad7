"""How alike two sets of images are, or a set and patches of measured colour.

The measures of Barth et al. 2018, sections 3.1.1 and 4.1.2 (class shares, places, hue spectra, light), each
as a number with the interval that it is known within, and beside them colours in CIELAB.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Final

import numpy as np

from pepperscene.classes import OrganClass
from pepperscene.colour.comparison import similarity
from pepperscene.colour.comparison.measure import (
    MOST,
    PIXELS,
    SetMeasures,
    Told,
    measure_set,
    open_comparison_side,
)
from pepperscene.colour.comparison.result import Comparison, KindComparison, KindSide, LightComparison
from pepperscene.colour.patches.patch import PatchSet
from pepperscene.colour.statistics.bootstrap import (
    Estimate,
    Floats,
    estimate_angles,
    estimate_values,
    unknown_estimate,
)
from pepperscene.colour.statistics.colours import delta_e_2000
from pepperscene.dataset import ImageSet

_BACKGROUND: Final = OrganClass.BACKGROUND.name.lower()


def compare(
    one: str | Path | ImageSet | PatchSet,
    other: str | Path | ImageSet | PatchSet,
    *,
    limit: int | None = MOST,
    on_progress: Told | None = None,
) -> Comparison:
    """Compare two sets of images, or a set and patches of measured colour.

    Colours are those of the middle 300 x 300 pixels of each picture, as in the paper; shares, places and
    light those of whole pictures. Every number has a 95 % interval, by weighting the pictures of both sets
    otherwise 200 times; where a side has but one picture (of a kind) there is none. The same pictures give
    the same numbers, in whatever order.

    Args:
        one: a set of images or patches, or the path of one (see `open_images` and `open_patches`).
        other: the second set; of patches alone, colours are compared, and nothing else.
        limit: most pictures of each set that are measured, evenly over the set; None measures all.
        on_progress: called after each picture measured with how many are, out of how many.

    Raises:
        InputError: a path is no set of images or patches, or a file is damaged.
    """
    sides = [open_comparison_side(side) if isinstance(side, str | Path) else side for side in (one, other)]
    first, second = (measure_set(side, limit, on_progress) for side in sides)
    # A set against itself, or two folders of one name, must be told apart.
    names = (first.name, second.name)
    if first.name == second.name:
        names = (f"{first.name} (A)", f"{second.name} (B)")
    kinds = {kind: _kind(kind, first, second, names) for kind in _kinds(first, second)}
    return Comparison(
        first, second, names, kinds, _mean_hue_correlation(first, second), _shares(first, second, names),
        _light(first, second, names),
    )  # fmt: skip


def _kinds(one: SetMeasures, other: SetMeasures) -> list[str]:
    """Classes that either side shows, each with its stages if both tell them, in the order of the classes."""
    staged = one.staged() & other.staged()
    seen = one.kinds.keys() | other.kinds.keys()
    for side in (one, other):
        counts = side.statistics.pixels
        seen |= {organ.name.lower() for organ in OrganClass if counts[organ]}
    order = [organ.name.lower() for organ in OrganClass]
    return sorted(
        (kind for kind in seen if "." not in kind or kind.partition(".")[0] in staged),
        key=lambda kind: (order.index(kind.partition(".")[0]), kind != kind.partition(".")[0], kind),
    )


def _kind(kind: str, one: SetMeasures, other: SetMeasures, names: tuple[str, str]) -> KindComparison:
    """All measures of a kind; those that one side cannot tell say why."""
    rows = (one.totals(kind), other.totals(kind))
    sides = [
        _kind_side(kind, side, sums, name)
        for side, sums, name in zip((one, other), rows, names, strict=True)
    ]  # fmt: skip
    places = _places(kind, one, other, names)
    missing = [_unseen(kind, side, name) for sums, side, name in zip(rows, (one, other), names, strict=True)
               if sums is None]  # fmt: skip
    if rows[0] is None or rows[1] is None:
        none = unknown_estimate(missing[0])
        return KindComparison(kind, none, none, none, *places, *sides)
    known = min(one.kinds[kind].count, other.kinds[kind].count) > 1
    spectra = [similarity.hue_spectra(sums) for sums in rows if sums is not None]
    labs = [similarity.mean_labs(sums) for sums in rows if sums is not None]
    return KindComparison(
        kind,
        estimate_values(
            similarity.paired(similarity.correlation, *spectra, resampled=known),
            known,
            "all its pixels are grey",
        ),
        estimate_values(
            similarity.paired(similarity.hue_distance, *spectra, resampled=known),
            known,
            "all its pixels are grey",
        ),
        estimate_values(delta_e_2000(*labs), known),
        *places,
        *sides,
    )


def _kind_side(kind: str, side: SetMeasures, sums: Floats | None, name: str) -> KindSide:
    share = _class_share(kind, side, name)
    if sums is None:
        none = unknown_estimate(_unseen(kind, side, name))
        return KindSide(0, 0, none, none, none, (none,) * 3, (none,) * 3, share)
    known = side.kinds[kind].count > 1
    spectra = similarity.hue_spectra(sums)
    labs, spreads = similarity.mean_labs(sums).T, similarity.lab_spreads(sums).T
    return KindSide(
        side.kinds[kind].count,
        int(sums[0, PIXELS]),
        estimate_angles(similarity.mean_hues(spectra), known, "its hues have no direction"),
        estimate_values(similarity.hue_spreads(spectra), known, "its hues have no direction"),
        estimate_values(similarity.grey_shares(sums), known),
        _three(labs, known),
        _three(spreads, known),
        share,
    )


def _three(rows: Floats, known: bool) -> tuple[Estimate, Estimate, Estimate]:
    first, second, third = (estimate_values(row, known) for row in rows)
    return first, second, third


def _places(
    kind: str, one: SetMeasures, other: SetMeasures, names: tuple[str, str]
) -> tuple[Estimate, Estimate]:
    """Where a class lies: correlation and structural similarity of its mean masks."""
    maps = []
    for side, name in zip((one, other), names, strict=True):
        if "." in kind:
            return (unknown_estimate("places are told of classes, not of their stages"),) * 2
        if not side.places.count:
            return (unknown_estimate(_unlabelled(side, name)),) * 2
        organ_class = OrganClass[kind.upper()]
        if not side.statistics.pixels[organ_class]:
            return (unknown_estimate(_nowhere(side, name)),) * 2
        maps.append(similarity.place_maps(side.places.totals(), organ_class))
    known = min(one.places.count, other.places.count) > 1
    return (
        estimate_values(
            similarity.paired(similarity.correlation, *maps, resampled=known),
            known,
            "it lies everywhere alike",
        ),
        estimate_values(similarity.paired(similarity.structure, *maps, resampled=known), known),
    )


def _class_share(kind: str, side: SetMeasures, name: str) -> Estimate:
    if "." in kind:
        return unknown_estimate("shares are told of classes, not of their stages")
    if not side.shares.count:
        return unknown_estimate(_unlabelled(side, name))
    shares = similarity.class_shares(side.shares.totals())[:, OrganClass[kind.upper()]]
    return estimate_values(shares, side.shares.count > 1, f"not labelled in {name}")


def _mean_hue_correlation(one: SetMeasures, other: SetMeasures) -> Estimate:
    """Over the plant parts that both show, so not the background, each replicate over the same parts."""
    parts = [
        kind for kind in _kinds(one, other)
        if "." not in kind and kind != _BACKGROUND and kind in one.kinds and kind in other.kinds
    ]  # fmt: skip
    rows = []
    for kind in parts:
        spectra = [similarity.hue_spectra(side.kinds[kind].totals()) for side in (one, other)]
        rows.append(similarity.paired(similarity.correlation, *spectra))
    rows = [row for row in rows if np.isfinite(row[0])]
    if not rows:
        return unknown_estimate("there is no plant part whose hues both sets show")
    known = min(side.kinds[kind].count for kind in parts for side in (one, other)) > 1
    return estimate_values(np.mean(rows, axis=0), known)


def _shares(one: SetMeasures, other: SetMeasures, names: tuple[str, str]) -> Estimate:
    for side, name in zip((one, other), names, strict=True):
        if not side.shares.count:
            return unknown_estimate(_unlabelled(side, name))
    shares = [similarity.class_shares(side.shares.totals()) for side in (one, other)]
    values = np.array([similarity.share_correlation(p, q) for p, q in zip(*shares, strict=True)])
    known = min(one.shares.count, other.shares.count) > 1
    return estimate_values(values, known, "fewer than three classes are labelled in both sets")


def _light(one: SetMeasures, other: SetMeasures, names: tuple[str, str]) -> LightComparison:
    means: list[Estimate] = []
    spreads: list[float | None] = []
    reason = ""
    for side, name in zip((one, other), names, strict=True):
        if side.light.count:
            means.append(estimate_values(similarity.mean_greys(side.light.totals()), side.light.count > 1))
            spreads.append(float(np.std(np.sort(side.statistics.intensities))))
        else:
            why = f"no photographs in {name}" if side.pictured else f"{name} has patches, not pictures"
            reason = reason or why
            means.append(unknown_estimate(why))
            spreads.append(None)
    if reason:
        return LightComparison(*(unknown_estimate(reason),) * 3, means[0], means[1], spreads[0], spreads[1])
    known = min(one.light.count, other.light.count) > 1
    maps = [similarity.intensity_maps(side.light.totals()) for side in (one, other)]
    rings = [np.array([similarity.falloff(image) for image in some]) for some in maps]

    def alike(measure: Callable[[Floats, Floats], float], some: list[Floats]) -> Estimate:
        return estimate_values(
            similarity.paired(measure, *some, resampled=known), known, "a mean picture is flat"
        )

    return LightComparison(
        alike(similarity.correlation, maps), alike(similarity.structure, maps),
        alike(similarity.correlation, rings), means[0], means[1], spreads[0], spreads[1],
    )  # fmt: skip


def _unlabelled(side: SetMeasures, name: str) -> str:
    return f"no labels in {name}" if side.pictured else f"{name} has patches, not pictures"


def _nowhere(side: SetMeasures, name: str) -> str:
    """Why a class has no pixel: nobody drew it, or it is not there."""
    return f"not labelled in {name}" if side.statistics.unlabelled else f"not seen in {name}"


def _unseen(kind: str, side: SetMeasures, name: str) -> str:
    """Why a kind's colours are not known."""
    if not side.pictured:
        return f"no patch of it in {name}"
    if not side.statistics.photographs:
        return f"no photographs in {name}"
    if not side.statistics.labelled:
        return f"no labels in {name}"
    if "." not in kind and side.statistics.pixels[OrganClass[kind.upper()]]:
        return f"not in the middle of the pictures of {name}"
    return _nowhere(side, name)
