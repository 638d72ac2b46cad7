"""Similarity of two image sets, or of an image set and patches of measured colour.

The measures of Barth et al. 2018, sections 3.1.1 and 4.1.2 (class fractions, spatial distributions, hue
spectra, light), each as a number with its confidence interval, and colours in CIELAB.
"""

from __future__ import annotations

from pathlib import Path
from typing import Final

from pepperscene.colour.comparison.kinds import (
    common_kinds,
    compare_kind,
    correlate_class_fractions,
    mean_hue_correlation,
)
from pepperscene.colour.comparison.measure import OnProgress, measure_set
from pepperscene.colour.comparison.open_sets import open_set
from pepperscene.colour.comparison.result import Comparison
from pepperscene.colour.comparison.scale import WIDTH_PX, choose_scales
from pepperscene.colour.comparison.whole_images import compare_appearance, compare_light
from pepperscene.colour.patches.patch import PatchSet
from pepperscene.dataset.readers.image_set import ImageSet

DEFAULT_LIMIT: Final = 1000
"""Chosen: a mean over 1,000 images is known to 3 % of the spread between them."""


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

    Hues and CIELAB are those of the central square of each image, which is 3/16 of its area, like the
    300 x 300 of 800 x 600 pixels in the paper; all else is measured in whole images. Every number has a 95 %
    interval from 200 bootstrap replicates over the images of both sets, unless a set has one image (of a
    kind) only. The same images give the same numbers, in any order.

    Args:
        first: a set of images or patches, or the path of one (see `open_images` and `open_patches`).
        second: the second set; with patches, only colours are compared.
        limit: at most so many images of each set are measured, evenly spaced; None measures all.
        width_px: width to which images are reduced before their textures are measured; narrower images have
            none.
        pixel_mm: size of a pixel of each set on the plants, in millimetres. If given, the finer set is
            reduced to the scale of the coarser one, instead of both to one width, and the central squares
            have the same size on the plants.
        on_progress: called after each measured image with the number measured and the total.

    Raises:
        InputError: a path is no set of images or patches, or a file is damaged.
        ArgumentError: a width or a pixel size is not positive.
    """
    opened = [open_set(one) if isinstance(one, str | Path) else one for one in (first, second)]
    scales = choose_scales(opened, width_px, pixel_mm)
    sets = (
        measure_set(opened[0], limit, on_progress, scales[0]),
        measure_set(opened[1], limit, on_progress, scales[1]),
    )
    # A set against itself, or two folders of one name, need different names.
    if sets[0].name == sets[1].name:
        for side, letter in zip(sets, "AB", strict=True):
            side.name = f"{side.name} ({letter})"
    return Comparison(
        *sets,
        kinds={kind: compare_kind(kind, sets) for kind in common_kinds(sets)},
        hue_correlation=mean_hue_correlation(sets),
        share_correlation=correlate_class_fractions(sets),
        light=compare_light(sets),
        appearance=compare_appearance(sets),
    )
