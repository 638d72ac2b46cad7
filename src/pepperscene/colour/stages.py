"""Which pixels of a labelled picture show which kind of organ; fruit by ripeness, where that is told."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.classes import OrganClass
from pepperscene.dataset import ImageSet, Labelled
from pepperscene.dataset.readers import KNOWN_LABELS, FolderSet
from pepperscene.dataset.readers.pictures import read_mask

RIPE_FROM: Final = 0.5
"""Ripeness from which a fruit counts as ripe: half way from green to its last colour (chosen)."""

UNRIPE, RIPE = "pepper.unripe", "pepper.ripe"

_MONTOYA: Final[Mapping[int, str]] = {1: UNRIPE, 2: RIPE, 4: RIPE}
"""Values of the masks of Montoya Cavero & Escobedo 2021 that tell how ripe a fruit is: green, red, yellow."""


def regions(images: ImageSet, picture: Labelled) -> Iterator[tuple[str, NDArray[np.bool_]]]:
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


def _stages(images: ImageSet, picture: Labelled) -> Mapping[str, NDArray[np.bool_]]:
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
