"""Similarity of two image sets, or of an image set and patches of measured colour.

The measures of Barth et al. 2018, sections 3.1.1 and 4.1.2 (class fractions, spatial distributions, hue
spectra, light), each as a number with its confidence interval, and colours in CIELAB.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

from pepperscene.colour.comparison.appearance import WIDTH_PX, Scale
from pepperscene.colour.comparison.measure import OnProgress, measure_set
from pepperscene.colour.comparison.parts import (
    common_kinds,
    compare_appearance,
    compare_kind,
    compare_light,
    correlate_class_fractions,
    mean_hue_correlation,
)
from pepperscene.colour.comparison.result import Comparison
from pepperscene.colour.patches.extraction import reflectance_file
from pepperscene.colour.patches.open import open_patches
from pepperscene.colour.patches.patch import PatchSet
from pepperscene.dataset.readers import open_images
from pepperscene.dataset.readers.image_set import ImageSet
from pepperscene.dataset.readers.open import half_targets, label_targets
from pepperscene.errors import ArgumentError, InputError
from pepperscene.truth import centre_side

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


def choose_scales(
    sets: Sequence[ImageSet | PatchSet], width_px: int, pixel_mm: tuple[float, float] | None
) -> tuple[Scale, Scale]:
    """Scales of two sets.

    Without sizes of pixels, images have one width, and central squares the same fraction of them. With sizes,
    pixels have one size on the plants, and so have central squares: the smaller of the two that are this
    fraction of the first image of each set. Arguments are those of `compare`.

    Raises:
        ArgumentError: a width or a size is not positive.
        InputError: the first image of a set is damaged.
    """
    if width_px < 1:
        raise ArgumentError("width_px", f"must be at least 1, not {width_px}")
    if pixel_mm is None:
        return Scale(width_px), Scale(width_px)
    if len(pixel_mm) != 2 or not all(0.0 < size < float("inf") for size in pixel_mm):
        raise ArgumentError("pixel_mm", f"must be two sizes above 0 in millimetres, not {pixel_mm}")
    coarsest = max(pixel_mm)
    sides_mm = [
        centre_side(*size) * pixel
        for images, pixel in zip(sets, pixel_mm, strict=True)
        if (size := _first_size(images)) is not None
    ]
    first, second = (
        Scale(
            width_px,
            pixel / coarsest,
            coarsest,
            max(1, round(min(sides_mm) / pixel)) if sides_mm else None,
        )
        for pixel in pixel_mm
    )
    return first, second


def _first_size(images: ImageSet | PatchSet) -> tuple[int, int] | None:
    """Height and width in pixels of the first image of a set; None for patches, and for an empty set."""
    if isinstance(images, PatchSet) or not len(images):
        return None
    picture = images.select("colour", "classes")[0]
    image = picture.classes if picture.colour is None else picture.colour
    return None if image is None else (image.shape[0], image.shape[1])


def open_set(path: str | Path, *, labels: Any = None, half: str | None = None) -> ImageSet | PatchSet:
    """Open a folder as an image set; a file, or the name of shipped reflectances, as patches.

    Raises:
        InputError: it is neither, or an argument does not apply to it.
    """
    if Path(path).is_dir():
        return open_images(path, labels=labels, half=half)
    if not Path(path).exists():
        try:
            reflectance_file(path)
        except InputError:
            allowed = "must be a folder of images, or a file of patches or of measured reflectances"
            raise InputError(path, allowed) from None
    for name, value in (("labels", labels), ("half", half)):
        if value is not None:
            raise InputError(path, "applies only to a folder of images", key=name)
    return open_patches(path)


def open_two_sets(
    first: str | Path, second: str | Path, labels: str | None, half: str | None
) -> tuple[ImageSet | PatchSet, ImageSet | PatchSet]:
    """Open both sets, with the options of the command line.

    Args:
        first: path of the first set.
        second: path of the second set.
        labels: meaning of the masks: one name for each folder of images without a `classes.toml` (if both
            have one, for both, overriding it), or two names for first and second, separated by a comma.
        half: of the published data set: one name for each set that is the published one, or two likewise.

    Raises:
        InputError: see `open_set`; or an option applies to neither set.
    """
    paths = (Path(first), Path(second))
    all_labels = _split_option("labels", labels, label_targets(paths), "a folder of images with masks")
    all_halves = _split_option("half", half, half_targets(paths), "the published data set")
    return (
        open_set(paths[0], labels=all_labels[0], half=all_halves[0]),
        open_set(paths[1], labels=all_labels[1], half=all_halves[1]),
    )


def _split_option(
    option: str, value: str | None, targets: list[bool], what: str
) -> tuple[str | None, str | None]:
    """Value of an option for each set: one name for all sets that it applies to, or one name for each."""
    if value is None:
        return None, None
    first, comma, second = (part.strip() or None for part in value.partition(","))
    if comma:
        return first, second
    if not any(targets):
        raise ArgumentError(option, f"applies only to {what}; neither set is one")
    return (first if targets[0] else None), (first if targets[1] else None)
