"""What is measured of one of two sets: sums over its pictures, or over the pictures that patches are from.

What the paper shows (Figs. 10 to 13) is gathered by `truth.ImageStatistics`; here are the sums that
numbers are made of, plain and resampled. Memory is that of a few pictures, however many are added.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pepperscene.camera import decode_tone
from pepperscene.camera.colorimetry import XYZ_TO_SRGB, adapted_xyz, d65_spectrum
from pepperscene.classes import OrganClass
from pepperscene.colour.patches.extraction import reflectance_file
from pepperscene.colour.patches.open import open_patches, organ_regions
from pepperscene.colour.patches.patch import MeasuredSpectrum, Patch, PatchSet
from pepperscene.colour.statistics.bootstrap import BootstrapSums, Floats, weights_of
from pepperscene.colour.statistics.colours import encoded, hue_counts_of, linear_srgb_to_lab
from pepperscene.dataset import ImageSet
from pepperscene.dataset.readers import open_images
from pepperscene.dataset.readers.labels import LABEL_FILE
from pepperscene.dataset.readers.published import published_halves
from pepperscene.dataset.report.data import evenly_spaced, read_ahead
from pepperscene.dataset.store.dataset import MARK
from pepperscene.errors import ArgumentError, InputError
from pepperscene.spectra import Spectrum
from pepperscene.truth import HUE_BINS, ImageStatistics, centre_crop, grey_values

CLASSES: Final = len(OrganClass)
CELLS: Final = (30, 40)
"""Rows and columns of the cells in which places are compared. Chosen: 20 x 20 pixels of an 800 x 600 picture,
narrower than a fruit and wider than a wire, so that a few dozen pictures already fill them."""

# Columns of a kind's sums.
HUES: Final = slice(0, HUE_BINS + 1)
PICTURES: Final = HUE_BINS + 1
PIXELS: Final = PICTURES + 1
LIGHT: Final = slice(PIXELS + 1, PIXELS + 4)
LAB: Final = slice(PIXELS + 4, PIXELS + 7)
SQUARES: Final = slice(PIXELS + 7, PIXELS + 10)
_WIDTH: Final = PIXELS + 10


class SetMeasures:
    """Sums over one set.

    Attributes:
        name: of the set.
        of: how many pictures it has, of which `units` were measured.
        pictured: whether it has whole pictures, so that shares, places and light can be told.
        kinds: sums of each kind's colours, in the middle of the pictures; by `HUES` and so on.
        shares: labelled pixels of each class `(8,)` and those without a label, in whole pictures.
        places: share of each class in each cell, `(8 * rows * columns,)`.
        light: mean grey value of each cell, `(rows * columns,)`, that of the picture, and 1.
        statistics: the measures of the paper.
        units: pictures measured, or pictures and spectra that patches are from.
    """

    def __init__(self, name: str, of: int, *, pictured: bool) -> None:
        self.name, self.of, self.pictured, self.units = name, of, pictured, 0
        self.kinds: dict[str, BootstrapSums] = {}
        self.shares = BootstrapSums(CLASSES + 1)
        self.places = BootstrapSums(CLASSES * CELLS[0] * CELLS[1])
        self.light = BootstrapSums(CELLS[0] * CELLS[1] + 2)
        self.statistics = ImageStatistics()

    def add_picture(
        self,
        colour: NDArray[np.uint8] | None,
        classes: NDArray[np.uint8] | None,
        stages: Mapping[str, NDArray[np.bool_]] | None = None,
    ) -> None:
        """Count a picture in.

        Args:
            colour: `(h, w, 3)` sRGB, or None.
            classes: `(h, w)` class ids, or None; values above 7 are unlabelled.
            stages: `(h, w)` of each kind with a stage ("pepper.ripe"), where it is seen.
        """
        self.statistics.add(colour, classes)
        self.units += 1
        content = b"".join(image.tobytes() for image in (colour, classes) if image is not None)
        weights = weights_of(content)
        if classes is not None:
            self._add_classes(classes, weights)
        if colour is not None:
            grey = grey_values(colour)
            self.light.add([*_cell_means(grey), grey.mean(dtype=np.float64), 1.0], weights)
        if colour is not None and classes is not None:
            middle, ids = centre_crop(colour), centre_crop(classes)
            masks = {one.name.lower(): ids == one for one in OrganClass}
            masks |= {kind: centre_crop(mask) for kind, mask in (stages or {}).items()}
            for kind, mask in masks.items():
                if mask.any():
                    codes = middle[mask]
                    self._add_kind(kind, hue_counts_of(codes), _light(decode_tone(codes)), weights)

    def add_patches(self, patches: Iterable[Patch]) -> None:
        """Count in all patches of one picture; a patch with a stage counts for its class as well."""
        found: dict[str, list[Patch]] = {}
        for patch in sorted(patches, key=lambda one: one.name):
            for kind in {patch.kind, patch.kind.partition(".")[0]}:
                found.setdefault(kind, []).append(patch)
        weights = weights_of(b"".join(one.codes.tobytes() for some in found.values() for one in some))
        for kind, some in found.items():
            # Of a large patch a part of its pixels is there, which stand for all.
            light = np.sum([_light(one.linear, one.pixels) for one in some], axis=0)
            self._add_kind(kind, np.sum([one.hues for one in some], axis=0), light, weights)
        self.units += 1

    def add_spectrum(self, measured: MeasuredSpectrum) -> None:
        """Count in a measured reflectance, as one pixel of its colour under D65."""
        linear = reflectance_colour(measured.spectrum)[None]
        weights = weights_of(np.ascontiguousarray(measured.spectrum.values).tobytes())
        for kind in {measured.kind, measured.kind.partition(".")[0]}:
            self._add_kind(kind, hue_counts_of(encoded(linear)), _light(linear), weights)
        self.units += 1

    def totals(self, kind: str) -> Floats | None:
        """Sums of a kind's colours; None where it was not seen."""
        return self.kinds[kind].totals() if kind in self.kinds else None

    def staged(self) -> frozenset[str]:
        """Classes of which it tells stages."""
        return frozenset(kind.partition(".")[0] for kind in self.kinds if "." in kind)

    def _add_kind(self, kind: str, hues: ArrayLike, light: Floats, weights: Floats) -> None:
        """Hues count the same for each picture, as in the paper; light counts by the pixel."""
        counts = np.asarray(hues, float)
        row = np.concatenate([counts / counts.sum(), [1.0], light])
        self.kinds.setdefault(kind, BootstrapSums(_WIDTH)).add(row, weights)

    def _add_classes(self, classes: NDArray[np.uint8], weights: Floats) -> None:
        counts = np.bincount(np.minimum(classes, CLASSES).ravel(), minlength=CLASSES + 1)
        self.shares.add(counts, weights)
        ids, cells = _cells(np.minimum(classes, CLASSES))
        area = CELLS[0] * CELLS[1]
        found = np.bincount((ids.astype(np.int64) * area + cells).ravel(), minlength=(CLASSES + 1) * area)
        sizes = np.bincount(cells.ravel(), minlength=area)
        self.places.add((found.reshape(-1, area)[:CLASSES] / sizes).ravel(), weights)


def _light(linear: Floats, pixels: int | None = None) -> Floats:
    """Sums of pixels `(n, 3)` from `PIXELS` on; brought to a number of pixels that they stand for."""
    seen = linear_srgb_to_lab(linear)
    sums = [linear.sum(axis=0), seen.sum(axis=0), (seen**2).sum(axis=0)]
    factor = 1.0 if pixels is None else pixels / len(linear)
    return factor * np.concatenate([[len(linear)], *sums])


def reflectance_colour(reflectance: Spectrum) -> Floats:
    """`(3,)` linear sRGB of a reflectance as the CIE 1931 observer sees it under D65.

    Beyond the range that was measured its end values hold; the observer sees little there.
    """
    held = Spectrum(reflectance.wavelength_nm, reflectance.values, "hold")
    (xyz,) = adapted_xyz(d65_spectrum(), held.at(np.arange(300.0, 1101.0))[None])
    return np.asarray(xyz @ XYZ_TO_SRGB.T)


def _cell_means(grey: NDArray[np.uint8]) -> Floats:
    """Mean of an image `(h, w)` in each cell."""
    values, cells = _cells(grey)
    area = CELLS[0] * CELLS[1]
    sums = np.bincount(cells.ravel(), values.ravel(), minlength=area)
    return np.asarray(sums / np.bincount(cells.ravel(), minlength=area))


def _cells(image: NDArray[Any]) -> tuple[NDArray[Any], NDArray[np.int64]]:
    """An image, its pixels repeated where it has fewer than there are cells, and the cell of each pixel."""
    places = []
    for axis, cells in enumerate(CELLS):
        image = np.repeat(image, -(-cells // image.shape[axis]), axis=axis)
        # A pixel belongs to the cell that its middle lies in.
        places.append((2 * np.arange(image.shape[axis]) + 1) * cells // (2 * image.shape[axis]))
    return image, places[0][:, None] * CELLS[1] + places[1][None, :]


Told = Callable[[int, int], None]
"""Called with how many pictures are measured, and out of how many."""

MOST: Final = 1000
"""Chosen: a mean over 1,000 pictures is known to 3 % of the spread between them."""


def open_comparison_side(
    path: str | Path, *, labels: Any = None, half: str | None = None
) -> ImageSet | PatchSet:
    """A folder as a set of images; a file, or the name of shipped reflectances, as patches.

    Raises:
        InputError: it is neither, or an argument does not go with it.
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
            raise InputError(path, "goes only with a folder of images", key=name)
    return open_patches(path)


def open_comparison_sides(
    one: str | Path, other: str | Path, labels: str | None, half: str | None
) -> tuple[ImageSet | PatchSet, ImageSet | PatchSet]:
    """Both sides, with what the command line says of them.

    Args:
        one: the first side's path.
        other: the second side's.
        labels: what masks mean; one name for every side that is a folder of images without a `classes.toml`
            (if all have one, instead of it), or two with a comma between, for one and other.
        half: of the published data set; one name for every side that is one, or two likewise.

    Raises:
        InputError: see `open_comparison_side`; or an option goes with neither side.
    """
    paths = (Path(one), Path(other))
    halves = [len(published_halves(path)) if path.is_dir() else 0 for path in paths]
    published = [count > 0 for count in halves]
    plain = [
        path.is_dir() and not found and not (path / MARK).exists()
        for path, found in zip(paths, published, strict=True)
    ]
    # A folder that explains its own masks keeps that, as long as the other one needs what is told.
    silent = [found and not (path / LABEL_FILE).exists() for path, found in zip(paths, plain, strict=True)]
    all_labels = _each("labels", labels, silent if any(silent) else plain, "a folder of images with masks")
    both = [count > 1 for count in halves]
    all_halves = _each("half", half, both if any(both) else published, "the published data set")
    first, second = (
        open_comparison_side(path, labels=labels_told, half=half_told)
        for path, labels_told, half_told in zip(paths, all_labels, all_halves, strict=True)
    )
    return first, second


def measure_set(side: ImageSet | PatchSet, limit: int | None, told: Told | None = None) -> SetMeasures:
    """The sums of one side, of at most `limit` of its pictures, evenly over the set.

    Raises:
        InputError: a file is damaged, or nothing is there to measure.
    """
    if isinstance(side, PatchSet):
        return _of_patches(side, limit)
    sums = SetMeasures(side.name, len(side), pictured=True)
    places = evenly_spaced(len(side), len(side) if limit is None else limit)
    images = side.select("colour", "classes", "instances", "facts")
    for picture in read_ahead(images, places):
        staged = (
            {} if picture.colour is None else {k: m for k, m in organ_regions(images, picture) if "." in k}
        )
        sums.add_picture(picture.colour, picture.classes, staged)
        if told is not None:
            told(sums.units, len(places))
    return sums


def _of_patches(patches: PatchSet, limit: int | None) -> SetMeasures:
    """Patches count by the picture they are from, spectra one by one."""
    if not patches.patches and not patches.spectra:
        raise InputError(patches.name, "holds no patches")
    pictures = patches.pictures
    sums = SetMeasures(patches.name, len(pictures) + len(patches.spectra), pictured=False)
    for place in evenly_spaced(len(pictures), len(pictures) if limit is None else limit):
        sums.add_patches(patch for patch in patches.patches if patch.picture == pictures[place])
    for spectrum in patches.spectra:
        sums.add_spectrum(spectrum)
    return sums


def _each(option: str, told: str | None, concerned: list[bool], what: str) -> tuple[str | None, str | None]:
    """An option's value for each side: one for all that it concerns, or one for each by its place."""
    if told is None:
        return None, None
    first, comma, second = (part.strip() or None for part in told.partition(","))
    if comma:
        return first, second
    if not any(concerned):
        raise ArgumentError(option, f"goes only with {what}, and neither side is one")
    return (first if concerned[0] else None), (first if concerned[1] else None)
