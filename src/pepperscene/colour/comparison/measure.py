"""Sums over one image set, or over the images of a patch set, from which comparisons are computed.

`truth.ImageStatistics` holds what the paper shows (Figs. 10 to 13); the sums here, plain and bootstrapped,
give the numbers. Memory is that of a few images, however large the set.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pepperscene.camera import decode_tone
from pepperscene.camera.image.colorimetry import NM, XYZ_TO_SRGB, adapted_xyz, d65_spectrum
from pepperscene.classes import OrganClass
from pepperscene.colour.comparison.appearance import WHOLE, Scale, add_appearance
from pepperscene.colour.comparison.bootstrap import BootstrapSums, Floats, bootstrap_weights
from pepperscene.colour.patches.open import organ_regions
from pepperscene.colour.patches.patch import MeasuredSpectrum, Patch, PatchSet
from pepperscene.colour.statistics import hue_histogram, linear_srgb_to_lab, srgb_codes
from pepperscene.dataset.readers.image_set import ImageSet
from pepperscene.errors import InputError
from pepperscene.review.report.data import evenly_spaced, read_ahead
from pepperscene.spectra import Spectrum
from pepperscene.truth import HUE_BINS, ImageStatistics, centre_crop, grey_values

OnProgress = Callable[[int, int], None]
"""Called with the number of measured images and their total."""
CLASSES: Final = len(OrganClass)
CELLS: Final = (30, 40)
"""Rows and columns of the grid in which spatial distributions are compared. Chosen: cells of 20 x 20 pixels
of an 800 x 600 image, narrower than a fruit and wider than a wire, which a few dozen images fill."""
DEFAULT_SCALE: Final = Scale()
_CELLS_TOTAL: Final = CELLS[0] * CELLS[1]
# Columns of the sums of a kind: hue fractions, images, pixels, linear sRGB, L*a*b* and its squares.
HUES: Final = slice(0, HUE_BINS + 1)
IMAGES: Final = HUE_BINS + 1
PIXELS: Final = IMAGES + 1
LINEAR: Final = slice(PIXELS + 1, PIXELS + 4)
LAB: Final = slice(PIXELS + 4, PIXELS + 7)
LAB_SQUARED: Final = slice(PIXELS + 7, PIXELS + 10)
_KIND_WIDTH: Final = PIXELS + 10


class SetMeasures:
    """Sums over one set.

    Attributes:
        name: of the set, with escape sequences for what is not UTF-8 in the name of a folder.
        available: number of images in the set, `units` of which were measured.
        has_images: whether it has whole images: class fractions, places and light need them.
        kinds: colour sums of each kind in the centre of the images, and of the whole centre as `WHOLE`;
            columns `HUES` and so on.
        class_pixels: labelled pixels of each class `(8,)` and unlabelled ones, in whole images.
        places: fraction of each class in each cell, `(8 * rows * columns,)`.
        light: mean grey value of each cell, `(rows * columns,)`, of the image, and 1.
        statistics: the measures of the paper.
        appearance: saturation, texture, gloss and clipping of whole images and of each class.
        scale: at which these are measured, with the size of the centre.
        centres: side in pixels of the central square of images of each size (height, width).
        units: images measured, or images and spectra of a patch set.
    """

    def __init__(self, name: str, available: int, *, has_images: bool, scale: Scale = DEFAULT_SCALE) -> None:
        self.name = printable_name(name)
        self.available, self.has_images, self.units = available, has_images, 0
        self.kinds: dict[str, BootstrapSums] = {}
        self.class_pixels = BootstrapSums(CLASSES + 1)
        self.places = BootstrapSums(CLASSES * _CELLS_TOTAL)
        self.light = BootstrapSums(_CELLS_TOTAL + 2)
        self.statistics = ImageStatistics()
        self.appearance: dict[str, BootstrapSums] = {}
        self.scale = scale
        self.centres: dict[tuple[int, int], int] = {}

    def add_image(
        self,
        colour: NDArray[np.uint8] | None,
        classes: NDArray[np.uint8] | None,
        stages: Mapping[str, NDArray[np.bool_]] | None = None,
        instances: NDArray[np.uint16] | None = None,
    ) -> None:
        """Add an image `(h, w, 3)` in sRGB, class ids `(h, w)` or both; ids above 7 are unlabelled.

        `stages` are masks `(h, w)` of the kinds with a stage ("pepper.ripe"); instances `(h, w)` are 0 for
        none.
        """
        centre_px = self._centre(colour if classes is None else classes)
        self.statistics.add(colour, classes, centre_px)
        self.units += 1
        content = b"".join(image.tobytes() for image in (colour, classes) if image is not None)
        weights = bootstrap_weights(content)
        if classes is not None:
            self._add_classes(classes, weights)
        if colour is not None:
            grey = grey_values(colour)
            self.light.add([*_cell_means(grey), grey.mean(dtype=np.float64), 1.0], weights)
            add_appearance(self.appearance, colour, classes, instances, self.scale, weights)
            central = centre_crop(colour, centre_px)
            masks = {WHOLE: np.ones(central.shape[:2], bool)}
            if classes is not None:
                ids = centre_crop(classes, centre_px)
                masks |= {organ_class.name.lower(): ids == organ_class for organ_class in OrganClass}
                masks |= {kind: centre_crop(mask, centre_px) for kind, mask in (stages or {}).items()}
            for kind, mask in masks.items():
                if mask.any():
                    codes = central[mask]
                    self._add_kind(kind, hue_histogram(codes), _colour_sums(decode_tone(codes)), weights)

    def add_patches(self, patches: Iterable[Patch]) -> None:
        """Add all patches of one image; a patch with a stage counts for its class as well."""
        by_kind: dict[str, list[Patch]] = {}
        for patch in sorted(patches, key=lambda patch: patch.name):
            for kind in dict.fromkeys((patch.kind, _class_of(patch.kind))):
                by_kind.setdefault(kind, []).append(patch)
        content = b"".join(patch.codes.tobytes() for same in by_kind.values() for patch in same)
        weights = bootstrap_weights(content)
        for kind, same in by_kind.items():
            # A large patch keeps a sample of its pixels, which is scaled to the whole patch.
            sums = np.sum([_colour_sums(patch.linear, patch.pixels) for patch in same], axis=0)
            self._add_kind(kind, np.sum([patch.hues for patch in same], axis=0), sums, weights)
        self.units += 1

    def add_spectrum(self, measured: MeasuredSpectrum) -> None:
        """Add a measured reflectance, as one pixel of its colour under D65."""
        linear = reflectance_to_linear_srgb(measured.spectrum)[None]
        weights = bootstrap_weights(np.ascontiguousarray(measured.spectrum.values).tobytes())
        for kind in dict.fromkeys((measured.kind, _class_of(measured.kind))):
            self._add_kind(kind, hue_histogram(srgb_codes(linear)), _colour_sums(linear), weights)
        self.units += 1

    def totals(self, kind: str) -> Floats | None:
        """Colour sums of a kind; None if it was not seen."""
        return self.kinds[kind].totals() if kind in self.kinds else None

    def classes_with_stages(self) -> frozenset[str]:
        """Classes that are also measured by stage."""
        return frozenset(_class_of(kind) for kind in self.kinds if "." in kind)

    def _centre(self, image: NDArray[Any] | None) -> int | None:
        """Side of the central square of an image `(h, w, ...)`, which is recorded."""
        if image is None:
            return None
        size = (image.shape[0], image.shape[1])
        return self.centres.setdefault(size, self.scale.centre(*size))

    def _add_kind(self, kind: str, hues: ArrayLike, colour_sums: Floats, weights: Floats) -> None:
        """Hues have the same weight in each image, as in the paper; colours are weighted by pixels."""
        counts = np.asarray(hues, float)
        vector = np.concatenate([counts / counts.sum(), [1.0], colour_sums])
        self.kinds.setdefault(kind, BootstrapSums(_KIND_WIDTH)).add(vector, weights)

    def _add_classes(self, classes: NDArray[np.uint8], weights: Floats) -> None:
        ids = np.minimum(classes, CLASSES)
        self.class_pixels.add(np.bincount(ids.ravel(), minlength=CLASSES + 1), weights)
        ids, cells = _assign_cells(ids)
        counts = np.bincount(
            (ids.astype(np.int64) * _CELLS_TOTAL + cells).ravel(), minlength=(CLASSES + 1) * _CELLS_TOTAL
        )
        sizes = np.bincount(cells.ravel(), minlength=_CELLS_TOTAL)
        self.places.add((counts.reshape(-1, _CELLS_TOTAL)[:CLASSES] / sizes).ravel(), weights)


def reflectance_to_linear_srgb(reflectance: Spectrum) -> Floats:
    """`(3,)` linear sRGB of a reflectance as the CIE 1931 observer sees it under D65.

    Outside the measured range its end values are used; the observer sees little there.
    """
    extended = Spectrum(reflectance.wavelength_nm, reflectance.values, "hold")
    (xyz,) = adapted_xyz(d65_spectrum(), extended.at(NM)[None])
    return np.asarray(xyz @ XYZ_TO_SRGB.T)


def _class_of(kind: str) -> str:
    return kind.partition(".")[0]


def _colour_sums(linear: Floats, pixels: int | None = None) -> Floats:
    """Sums over pixels `(n, 3)` for the columns from `PIXELS` on, scaled to a number of pixels."""
    lab = linear_srgb_to_lab(linear)
    sums = [linear.sum(axis=0), lab.sum(axis=0), (lab**2).sum(axis=0)]
    factor = 1.0 if pixels is None else pixels / len(linear)
    return factor * np.concatenate([[len(linear)], *sums])


def _cell_means(grey: NDArray[np.uint8]) -> Floats:
    """Mean of an image `(h, w)` in each cell."""
    values, cells = _assign_cells(grey)
    sums = np.bincount(cells.ravel(), values.ravel(), minlength=_CELLS_TOTAL)
    return np.asarray(sums / np.bincount(cells.ravel(), minlength=_CELLS_TOTAL))


def _assign_cells(image: NDArray[Any]) -> tuple[NDArray[Any], NDArray[np.int64]]:
    """An image, enlarged if it has fewer pixels than the grid has cells, and the cell of each pixel."""
    indices = []
    for axis, cells in enumerate(CELLS):
        image = np.repeat(image, -(-cells // image.shape[axis]), axis=axis)
        # A pixel belongs to the cell that contains its centre.
        indices.append((2 * np.arange(image.shape[axis]) + 1) * cells // (2 * image.shape[axis]))
    return image, indices[0][:, None] * CELLS[1] + indices[1][None, :]


Sets = tuple[SetMeasures, SetMeasures]
"""The first and the second set of a comparison."""


# --- measuring ----------------------------------------------------------------------------------------------


def measure_set(
    images: ImageSet | PatchSet,
    limit: int | None,
    on_progress: OnProgress | None = None,
    scale: Scale = DEFAULT_SCALE,
) -> SetMeasures:
    """Measure at most `limit` images of a set, evenly spaced.

    Textures are measured at a scale, all else in the images as they are.

    Raises:
        InputError: a file is damaged, or there is nothing to measure.
    """
    if isinstance(images, PatchSet):
        return _measure_patches(images, limit)
    sums = SetMeasures(images.name, len(images), has_images=True, scale=scale)
    indices = evenly_spaced(len(images), len(images) if limit is None else limit)
    images = images.select("colour", "classes", "instances", "metadata")
    for picture in read_ahead(images, indices):
        stages = {}
        if picture.colour is not None:
            stages = {kind: mask for kind, mask in organ_regions(images, picture) if "." in kind}
        sums.add_image(picture.colour, picture.classes, stages, picture.instances)
        if on_progress is not None:
            on_progress(sums.units, len(indices))
    return sums


def _measure_patches(patches: PatchSet, limit: int | None) -> SetMeasures:
    """Patches are added image by image, spectra singly."""
    if not patches.patches and not patches.spectra:
        raise InputError(patches.name, "holds no patches")
    pictures = patches.pictures
    sums = SetMeasures(patches.name, len(pictures) + len(patches.spectra), has_images=False)
    for index in evenly_spaced(len(pictures), len(pictures) if limit is None else limit):
        sums.add_patches(patch for patch in patches.patches if patch.picture == pictures[index])
    for spectrum in patches.spectra:
        sums.add_spectrum(spectrum)
    return sums


def printable_name(name: str) -> str:
    """A name with escape sequences instead of characters that a text file, or XML, cannot hold."""
    return "".join(one if one.isprintable() else one.encode("unicode_escape").decode() for one in name)
