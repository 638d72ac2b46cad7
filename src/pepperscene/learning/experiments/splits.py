"""Which images train a network, which choose its best state, and which test it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from pepperscene.dataset.readers.image_set import ImageSet
from pepperscene.dataset.readers.open import PublishedSet, RenderedSet
from pepperscene.errors import InputError

_PAPER_SYNTHETIC: Final = ((1, 8750), (8751, 8800), (8851, 8900))
_PAPER_REAL: Final = ((1, 30), (31, 40), (41, 50))
"""First and last number of the images for training, validation and test (section 2.8 of the paper)."""


@dataclass(frozen=True)
class Split:
    """Positions of the images of a set, and how they were chosen.

    Attributes:
        train, validation, test: positions; validation may be empty for photographs.
        rule: a sentence that says how the images were chosen.
    """

    train: tuple[int, ...]
    validation: tuple[int, ...]
    test: tuple[int, ...]
    rule: str


def split_synthetic(images: ImageSet, *, as_paper: bool = False) -> Split:
    """Split a synthetic set so that no plant is in two parts, where the set says which plants it shows.

    With `as_paper`, the published data set is split by the paper's numbers of images.

    Raises:
        InputError: the set has fewer than three images.
    """
    if as_paper and isinstance(images, PublishedSet):
        return split_published(images, _PAPER_SYNTHETIC)
    if len(images) < 3:
        raise InputError(images.name, f"must hold three images or more, not {len(images)}")
    plants = plant_sets(images)
    numbers = [] if plants is None else sorted(set(plants))
    if plants is None or len(numbers) < 2:
        why = "does not say which plants it shows" if plants is None else "shows one set of plants only"
        return _split_frames(len(images), why)
    if len(numbers) == 2:
        return _split_last_plants(plants, numbers)

    # The last tenth of the sets of plants validates, the tenth before it tests.
    tenth = max(1, round(len(numbers) / 10))
    parts = (numbers[: -2 * tenth], numbers[-tenth:], numbers[-2 * tenth : -tenth])
    train, validation, test = (_positions(plants, part) for part in parts)
    rule = f"{len(parts[0])} sets of plants train, {tenth} test and {tenth} validate"
    return Split(train, validation, test, f"{rule}; no plant is in two of them")


def real_folds(images: ImageSet, *, as_paper: bool = False) -> tuple[Split, ...]:
    """Folds of photographs: each half of the images tests networks that were trained on the other half.

    With `as_paper`, the published data set has one fold of the paper's numbers of images.

    Raises:
        InputError: there are fewer than two images.
    """
    if as_paper and isinstance(images, PublishedSet):
        return (split_published(images, _PAPER_REAL),)
    count = len(images)
    if count < 2:
        raise InputError(images.name, f"must hold two images with masks or more, not {count}")
    first, second = tuple(range(count // 2)), tuple(range(count // 2, count))
    rule = "two folds: the first half of the images trains and the second half tests, and the other way round"
    return Split(first, (), second, rule), Split(second, (), first, rule)


def has_paper_numbers(synthetic: ImageSet, real: ImageSet) -> bool:
    """Whether both halves of the published data set are there, with all images that the paper names."""
    if not (isinstance(synthetic, PublishedSet) and isinstance(real, PublishedSet)):
        return False
    is_same = synthetic.folder.resolve() == real.folder.resolve()
    is_complete = synthetic.items[-1] >= _PAPER_SYNTHETIC[-1][1] and real.items[-1] >= _PAPER_REAL[-1][1]
    return is_same and (synthetic.half, real.half) == ("synthetic", "empirical") and is_complete


def split_published(images: PublishedSet, ranges: Sequence[tuple[int, int]]) -> Split:
    """Split a half of the published data set by first and last numbers of its images."""
    parts = [
        tuple(position for position, number in enumerate(images.items) if first <= number <= last)
        for first, last in ranges
    ]
    texts = [f"{first}-{last}" for first, last in ranges]
    rule = f"the paper's images: {texts[0]} train, {texts[1]} validate, {texts[2]} test"
    for text, part in zip(texts, parts, strict=True):
        if not part:
            raise InputError(images.name, f"lacks the images {text}, which the paper uses")
    return Split(parts[0], parts[1], parts[2], rule)


def plant_sets(images: ImageSet) -> tuple[int, ...] | None:
    """Number of the set of plants of each image; None if the layout does not say it."""
    if not isinstance(images, RenderedSet):
        return None
    plan = images.dataset.info["recipe"]["plan"]
    per_set = plan["rotations"] * plan["frames"] * plan.get("twins", 1) * plan.get("cameras", 1)
    return tuple(index // per_set for index in images.items)


def _split_frames(count: int, why: str) -> Split:
    frames, tenth = tuple(range(count)), max(1, round(count / 10))
    train, test, validation = frames[: -2 * tenth], frames[-2 * tenth : -tenth], frames[-tenth:]
    rule = f"the set {why}, so that frames are split: {len(train)} train, {tenth} test and {tenth} validate"
    return Split(train, validation, test, f"{rule}; the same plants may be in all three")


def _split_last_plants(plants: Sequence[int], numbers: Sequence[int]) -> Split:
    train, others = _positions(plants, numbers[:1]), _positions(plants, numbers[1:])
    if len(others) < 2:
        return _split_frames(len(plants), "has one image only of its second set of plants")
    half = len(others) // 2
    rule = "one of two sets of plants trains; half of the images of the other test and half validate"
    return Split(train, others[half:], others[:half], rule)


def _positions(plants: Sequence[int], numbers: Sequence[int]) -> tuple[int, ...]:
    return tuple(np.flatnonzero(np.isin(plants, numbers)).tolist())
