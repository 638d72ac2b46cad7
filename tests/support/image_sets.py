"""Image sets in memory, for tests that compare sets."""

from __future__ import annotations

import colorsys

import numpy as np
from memory_set import MemorySet

from pepperscene.classes import OrganClass
from pepperscene.dataset.readers.image_set import LabelledImage


def image_set(*pictures, name="memory"):
    """A set of `(colour, classes)`; either may be None."""
    items = tuple(
        LabelledImage(f"{name}{k}", colour, classes) for k, (colour, classes) in enumerate(pictures)
    )
    return MemorySet(name=name, items=items)


def noisy_set(seed, count=5, size=(48, 64), name="noisy"):
    """Pictures with all classes, each in a random colour with noise."""
    rng = np.random.default_rng(seed)
    pictures = []
    for _ in range(count):
        classes = rng.integers(0, 8, (size[0] // 4, size[1] // 4)).repeat(4, 0).repeat(4, 1).astype(np.uint8)
        paint = rng.integers(30, 226, (8, 3))
        colour = np.clip(paint[classes] + rng.normal(0, 12, (*size, 3)), 0, 255).astype(np.uint8)
        pictures.append((colour, classes))
    return image_set(*pictures, name=name)


def saturated(hue_deg):
    """8-bit sRGB of a fully saturated hue."""
    return tuple(round(255 * part) for part in colorsys.hsv_to_rgb(hue_deg / 360.0 % 1.0, 1.0, 1.0))


def uniform(colour, organ=OrganClass.LEAF, size=(30, 40)):
    """A picture of one colour and class."""
    return np.full((*size, 3), colour, np.uint8), np.full(size, organ, np.uint8)


def flatten(value, path=""):
    """Every number in JSON data by its path."""
    if isinstance(value, dict):
        return {k: v for key, item in value.items() for k, v in flatten(item, f"{path}/{key}").items()}
    if isinstance(value, list):
        return {k: v for key, item in enumerate(value) for k, v in flatten(item, f"{path}/{key}").items()}
    return {path: value} if isinstance(value, int | float) else {}
