"""Which pixels of a labelled picture show which kind of organ; fruit by ripeness, where that is told."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np
from numpy.typing import NDArray

from pepperscene.classes import OrganClass
from pepperscene.colour.patches.chart import Calibration, calibrate
from pepperscene.colour.patches.extraction import Extraction, open_reflectances
from pepperscene.colour.patches.file import ChartPlace, read_patches_file
from pepperscene.colour.patches.patch import Patch, PatchSet, evenly
from pepperscene.dataset import ImageSet, LabelledImage, open_images
from pepperscene.dataset.readers import KNOWN_LABELS, FolderSet, LabelMap
from pepperscene.dataset.readers.pictures import read_mask, read_photo
from pepperscene.document import validate
from pepperscene.errors import InputError
from pepperscene.truth.statistics import CENTRE_PX

RIPE_FROM: Final = 0.5
"""Ripeness from which a fruit counts as ripe: half way from green to its last colour (chosen)."""

UNRIPE, RIPE = "pepper.unripe", "pepper.ripe"

_MONTOYA: Final[Mapping[int, str]] = {1: UNRIPE, 2: RIPE, 4: RIPE}
"""Values of the masks of Montoya Cavero & Escobedo 2021 that tell how ripe a fruit is: green, red, yellow."""


def organ_regions(images: ImageSet, picture: LabelledImage) -> Iterator[tuple[str, NDArray[np.bool_]]]:
    """Kind and pixels `(h, w)` of all that a picture shows, but for the background.

    The ripeness of fruit is told by a rendered frame's harvest and instance image, and by the masks of
    `montoya2021`; fruit whose ripeness nobody tells are of the kind "pepper".
    """
    if picture.classes is None:
        return
    present = np.flatnonzero(np.bincount(picture.classes.ravel(), minlength=len(OrganClass)))
    for organ in OrganClass:
        if organ is OrganClass.BACKGROUND or organ not in present:
            continue
        mask = picture.classes == organ
        if organ is OrganClass.PEPPER:
            stages = _stages(images, picture)
            for kind, pixels in stages.items():
                if (staged := mask & pixels).any():
                    yield kind, staged
                    mask &= ~pixels
        if mask.any():
            yield organ.name.lower(), mask


def _stages(images: ImageSet, picture: LabelledImage) -> Mapping[str, NDArray[np.bool_]]:
    """Pixels of the stages that are told of the fruit."""
    montoya = isinstance(images, FolderSet) and images.labels is KNOWN_LABELS["montoya2021"]
    if montoya and "mask" in picture.facts:
        return _by_mask(Path(picture.facts["mask"]))
    if picture.instances is not None and "harvest" in picture.facts:
        return _by_harvest(picture.instances, picture.facts["harvest"])
    return {}


def _by_mask(file: Path) -> dict[str, NDArray[np.bool_]]:
    values = read_mask(file).values
    if values is None:
        return {}
    told = {kind: [value for value, meant in _MONTOYA.items() if meant == kind] for kind in (UNRIPE, RIPE)}
    return {kind: np.isin(values, wanted) for kind, wanted in told.items()}


def _by_harvest(instances: NDArray[np.uint16], harvest: Mapping[str, Any]) -> dict[str, NDArray[np.bool_]]:
    """By the ripeness that the harvest's JSON tells of each value of the instance image."""
    ripeness = {int(fruit["instance"]): float(fruit["ripeness"]) for fruit in harvest["fruit"]}
    ripe = [instance for instance, value in ripeness.items() if value >= RIPE_FROM]
    unripe = [instance for instance, value in ripeness.items() if value < RIPE_FROM]
    return {UNRIPE: np.isin(instances, unripe), RIPE: np.isin(instances, ripe)}


_ALL_PX: Final = 2_000_000
"""Pixels of one kind that a set of pictures keeps at most: 54 MB. Chosen: the standard error of a mean of so
many is a thousandth of their spread, and a million pictures still leave some of each."""


def open_patches(
    path: str | Path | ImageSet,
    *,
    labels: str | LabelMap | Mapping[Any, Any] | None = None,
    half: str | None = None,
    centre_px: int | None = CENTRE_PX,
    erode_px: int | None = None,
    clipped: Literal["keep", "leave_out"] | None = None,
    chart: Mapping[str, Any] | Calibration | None = None,
    pictures: str | Path | None = None,
    limit: int | None = None,
) -> PatchSet:
    """Patches of measured colour: pixels of pictures by kind of organ, and measured reflectances.

    A set of pictures gives one patch per picture and kind, of the pixels in its middle, as Barth et al. 2018
    take them. Fruit are "pepper.unripe" or "pepper.ripe" where a rendered set's harvest or the masks of
    `montoya2021` tell, else "pepper". Of a patch at most 20,000 pixels are kept, and of a kind two million,
    evenly spread; hues are counted in all. The same input gives the same patches.

    Args:
        path: a patches file (TOML), a folder that `open_images` reads (rendered, published, or images with
            masks), an open set of images, or a CSV file of reflectances whose TOML tells their kinds.
        labels: what the masks of a folder mean, as `open_images` takes it.
        half: of the published data set, as `open_images` takes it.
        centre_px: side of the middle part of a set's pictures that counts; None for all. A patches file
            tells its own.
        erode_px: pixels within this distance of another kind are left out; None: a patches file's own, or 0.
        clipped: whether pixels with a channel at 0 or 255 are kept ("keep") or left out of everything but the
            hues ("leave_out"); None: a patches file's own, or "keep".
        chart: calibration of a set's colours by a ColorChecker: a `Calibration`, or a table as a patches
            file's `[chart]`. A patches file tells its own.
        pictures: folder of a patches file's pictures, instead of its own.
        limit: of a set, take at most so many pictures, evenly spread.

    Raises:
        InputError: the input is missing or damaged, an argument does not go with it, or nothing is labelled.
    """
    folder = isinstance(path, ImageSet) or Path(path).is_dir()
    of_sets = {"labels": labels, "half": half, "chart": chart, "limit": limit}
    given = [name for name, value in of_sets.items() if value is not None]
    if not folder and given:
        raise InputError(str(path), "goes only with a set of pictures", key=given[0])
    if pictures is not None and (folder or Path(str(path)).suffix != ".toml"):
        raise InputError(str(path), "goes only with a patches file", key="pictures")
    if (erode_px or 0) < 0 or (centre_px is not None and centre_px < 1) or (limit is not None and limit < 1):
        raise InputError(str(path), "erode_px must not be below 0, centre_px and limit not below 1")

    if isinstance(path, ImageSet) or folder:
        images = path if isinstance(path, ImageSet) else open_images(path, half=half, labels=labels)
        return _of_images(images, centre_px, erode_px or 0, clipped or "keep", _calibration(chart), limit)
    if Path(path).suffix == ".toml":
        where = None if pictures is None else Path(pictures)
        return read_patches_file(Path(path), pictures=where, erode_px=erode_px, clipped=clipped)
    return open_reflectances(path)


def _of_images(
    images: ImageSet,
    centre_px: int | None,
    erode_px: int,
    clipped: Literal["keep", "leave_out"],
    chart: ChartPlace | Calibration | None,
    limit: int | None,
) -> PatchSet:
    """One patch per picture and kind; a picture at a time is in memory."""
    chosen = images.take(evenly(len(images), limit).tolist()).select(
        "colour", "classes", "instances", "facts"
    )
    most = max(1, min(Extraction.most_px, _ALL_PX // max(1, len(chosen))))
    how = Extraction(clipped=clipped, erode_px=erode_px, most_px=most)
    patches: list[Patch] = []
    seen: Counter[str] = Counter()
    for picture in chosen:
        if picture.colour is None:
            continue
        seen["labelled"] += picture.classes is not None
        calibration = _of_picture(chart, picture) if isinstance(chart, ChartPlace) else chart
        height, width = picture.size
        within = slice(*_middle(height, centre_px)), slice(*_middle(width, centre_px))
        for kind, region in organ_regions(chosen, picture):
            patch = how.patch(
                picture.colour,
                region,
                name=f"{picture.name} {kind}",
                kind=kind,
                of=picture.name,
                within=within,
                calibration=calibration,
            )
            if patch is not None:
                patches.append(patch)
    if not patches:
        why = "no organ lies in the part that counts" if seen["labelled"] else "no picture is labelled"
        raise InputError(images.name, f"gives no patches: {why}")
    return PatchSet(images.name, tuple(patches))


def _middle(length: int, size: int | None) -> tuple[int, int]:
    """First and last row of the middle, as `pepperscene.truth.statistics.centre_crop` cuts it."""
    if size is None:
        return 0, length
    first = max(0, (length - size) // 2)
    return first, min(length, first + size)


def _calibration(chart: Mapping[str, Any] | Calibration | None) -> ChartPlace | Calibration | None:
    """What is told of a chart; one that serves all pictures is measured at once."""
    if chart is None or isinstance(chart, Calibration):
        return chart
    told = validate(ChartPlace, chart, "chart")
    if told.pictures is not None:
        raise InputError("chart", "goes only with a patches file", key="pictures")
    if told.picture is None:
        return told
    return calibrate(read_photo(Path(told.picture)), told.corners, where=told.picture)


def _of_picture(chart: ChartPlace, picture: LabelledImage) -> Calibration:
    assert picture.colour is not None
    return calibrate(picture.colour, chart.corners, where=picture.name)
