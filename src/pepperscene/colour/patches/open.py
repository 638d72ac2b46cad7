"""Open patches from image sets, patches files or reflectance tables."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.classes import OrganClass
from pepperscene.colour.patches.chart import Calibration, calibrate
from pepperscene.colour.patches.extraction import Clipped, Extraction, open_reflectances
from pepperscene.colour.patches.file import ChartPlace, read_patches_file
from pepperscene.colour.patches.patch import Patch, PatchSet, even_indices
from pepperscene.dataset.readers import KNOWN_LABELS, FolderSet, LabelMap, open_images
from pepperscene.dataset.readers.image_set import ImageSet, LabelledImage
from pepperscene.dataset.readers.pictures import read_mask_of, read_photo
from pepperscene.document import validate
from pepperscene.errors import InputError

CENTRE_PX: Final = 300
"""Side of the central square of Barth et al. 2018, section 3.1.1, in images of 800 x 600 pixels."""

RIPE_FROM: Final = 0.5
"""Ripeness from which a fruit counts as ripe: half way from green to its final colour (chosen)."""

UNRIPE, RIPE = "pepper.unripe", "pepper.ripe"

_MONTOYA: Final[Mapping[str, tuple[int, ...]]] = {UNRIPE: (1,), RIPE: (2, 4)}
"""Values of the fruit masks of Montoya Cavero & Escobedo 2021: green; red and yellow."""

_MONTOYA_TABLES: Final = ("montoya2021", "montoya2021_background")
"""Names of the label tables of those masks."""

_MAX_KIND_PX: Final = 2_000_000
"""Pixels of one kind that are kept of a set: 54 MB. Chosen: the standard error of a mean of so many is a
thousandth of their spread, and a million pictures still contribute some pixels each."""


def open_patches(
    path: str | Path | ImageSet,
    *,
    labels: str | LabelMap | Mapping[Any, Any] | None = None,
    half: str | None = None,
    centre_px: int | None = CENTRE_PX,
    erode_px: int | None = None,
    clipped: Clipped | None = None,
    chart: Mapping[str, Any] | Calibration | None = None,
    pictures: str | Path | None = None,
    limit: int | None = None,
) -> PatchSet:
    """Open patches of measured colour: pixels of pictures by kind of organ, and measured reflectances.

    A set of pictures gives one patch per picture and kind, of the pixels in its centre, as in Barth et al.
    2018. Fruit are "pepper.unripe" or "pepper.ripe" if the harvest output of a rendered set or the masks of
    `montoya2021` say so, else "pepper". At most 20,000 pixels of a patch and two million of a kind are kept,
    evenly spaced; hues are counted in all pixels. The same input gives the same patches.

    Args:
        path: a patches file (TOML), a folder that `open_images` reads (rendered, published, or images with
            masks), an open set of images, or a CSV file of reflectances whose TOML gives their kinds.
        labels: meaning of the masks of a folder, as for `open_images`.
        half: of the published data set, as for `open_images`.
        centre_px: side of the central square of a set's pictures that is used; None uses all of it. A
            patches file has its own.
        erode_px: pixels within this distance of another kind are left out; None: the patches file's, or 0.
        clipped: whether pixels with a channel at 0 or 255 are kept ("keep") or left out of everything but the
            hues ("leave_out"); None: the patches file's, or "keep".
        chart: calibration of a set's colours by a ColorChecker: a `Calibration`, or a table like `[chart]` in
            a patches file. A patches file has its own.
        pictures: folder of a patches file's pictures; overrides its own.
        limit: use at most so many pictures of a set, evenly spaced.

    Raises:
        InputError: the input is missing or damaged, an argument does not apply to it, or nothing is labelled.
    """
    is_set = isinstance(path, ImageSet) or Path(path).is_dir()
    set_options = {"labels": labels, "half": half, "chart": chart, "limit": limit}
    given = [name for name, value in set_options.items() if value is not None]
    if not is_set and given:
        raise InputError(str(path), "applies only to a set of pictures", key=given[0])
    if pictures is not None and (is_set or Path(str(path)).suffix != ".toml"):
        raise InputError(str(path), "applies only to a patches file", key="pictures")
    if (erode_px or 0) < 0 or (centre_px is not None and centre_px < 1) or (limit is not None and limit < 1):
        raise InputError(str(path), "erode_px must be at least 0, centre_px and limit at least 1")

    if isinstance(path, ImageSet) or is_set:
        images = path if isinstance(path, ImageSet) else open_images(path, half=half, labels=labels)
        images = images.take(even_indices(len(images), limit).tolist())
        return _patches_of_images(images, centre_px, erode_px or 0, clipped or "keep", _open_chart(chart))
    if Path(path).suffix == ".toml":
        folder = None if pictures is None else Path(pictures)
        return read_patches_file(Path(path), pictures=folder, erode_px=erode_px, clipped=clipped)
    return open_reflectances(path)


def _patches_of_images(
    images: ImageSet,
    centre_px: int | None,
    erode_px: int,
    clipped: Clipped,
    chart: ChartPlace | Calibration | None,
) -> PatchSet:
    """One patch per picture and kind; one picture at a time is in memory."""
    images = images.select("colour", "classes", "instances", "metadata")
    limit_px = max(1, min(Extraction.limit_px, _MAX_KIND_PX // max(1, len(images))))
    extraction = Extraction(clipped=clipped, erode_px=erode_px, limit_px=limit_px)
    patches: list[Patch] = []
    labelled = False
    for picture in images:
        if picture.colour is None:
            continue
        labelled |= picture.classes is not None
        calibration = chart
        if isinstance(chart, ChartPlace):
            calibration = calibrate(picture.colour, chart.corners, where=picture.name)
        assert not isinstance(calibration, ChartPlace)
        for kind, region in organ_regions(images, picture):
            patch = extraction.patch(
                picture.colour,
                region,
                name=f"{picture.name} {kind}",
                kind=kind,
                picture=picture.name,
                centre_px=centre_px,
                calibration=calibration,
            )
            if patch is not None:
                patches.append(patch)
    if not patches:
        reason = (
            "no organ is in the part of the pictures that is used" if labelled else "no picture is labelled"
        )
        raise InputError(images.name, f"gives no patches: {reason}")
    return PatchSet(images.name, tuple(patches))


def organ_regions(images: ImageSet, picture: LabelledImage) -> Iterator[tuple[str, NDArray[np.bool_]]]:
    """Kind and mask `(h, w)` of all organs in a picture, without the background.

    The ripeness of fruit comes from a rendered frame's harvest output and instance image, or from the masks
    of `montoya2021`; fruit of unknown ripeness are of the kind "pepper".
    """
    if picture.classes is None:
        return
    present = np.flatnonzero(np.bincount(picture.classes.ravel(), minlength=len(OrganClass)))
    for organ_class in OrganClass:
        if organ_class is OrganClass.BACKGROUND or organ_class not in present:
            continue
        mask = picture.classes == organ_class
        if organ_class is OrganClass.PEPPER:
            for kind, pixels in _ripeness_masks(images, picture).items():
                if (staged := mask & pixels).any():
                    yield kind, staged
                    mask &= ~pixels
        if mask.any():
            yield organ_class.name.lower(), mask


def _ripeness_masks(images: ImageSet, picture: LabelledImage) -> Mapping[str, NDArray[np.bool_]]:
    """Masks `(h, w)` of the ripeness stages, as far as the picture has them."""
    if (
        isinstance(images, FolderSet)
        and any(images.labels is KNOWN_LABELS[name] for name in _MONTOYA_TABLES)
        and "mask" in picture.metadata
    ):
        mask = read_mask_of(Path(picture.metadata["image"]), Path(picture.metadata["mask"]))
        values = None if mask is None else mask.values
        return {} if values is None else {kind: np.isin(values, codes) for kind, codes in _MONTOYA.items()}
    if picture.instances is not None and "harvest" in picture.metadata:
        of_stage: dict[str, list[int]] = {UNRIPE: [], RIPE: []}
        for fruit in picture.metadata["harvest"]["fruit"]:
            if (ripeness := fruit.get("ripeness")) is not None:
                of_stage[RIPE if float(ripeness) >= RIPE_FROM else UNRIPE].append(int(fruit["instance"]))
        return {kind: np.isin(picture.instances, fruit) for kind, fruit in of_stage.items()}
    return {}


def _open_chart(chart: Mapping[str, Any] | Calibration | None) -> ChartPlace | Calibration | None:
    """Validate a chart; a chart in a separate picture is measured once, for all pictures."""
    if chart is None or isinstance(chart, Calibration):
        return chart
    position = validate(ChartPlace, chart, "chart")
    if position.pictures is not None:
        raise InputError("chart", "applies only to a patches file", key="pictures")
    if position.picture is None:
        return position
    return calibrate(read_photo(Path(position.picture)), position.corners, where=position.picture)
