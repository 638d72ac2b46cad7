"""Image sets in memory, and models that predict what a test chooses."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from dataclasses import dataclass, field

import numpy as np
from memory_set import MemorySet

from pepperscene.classes import IGNORE_CLASS
from pepperscene.dataset.readers.image_set import LabelledImage
from pepperscene.learning.class_table import ClassTable

ORGANS = ClassTable.organs()


def image_set(*classes, name="toy", instances=None):
    """A set of images whose red channel is the class id; a mask of None is an image without a mask."""
    images = []
    for number, mask in enumerate(classes):
        ids = np.zeros((4, 5), np.uint8) if mask is None else np.asarray(mask, np.uint8)
        noise = np.random.default_rng(number).integers(0, 256, (*ids.shape, 2)).astype(np.uint8)
        colour = np.dstack([ids, noise])
        own = None if instances is None else np.asarray(instances[number], np.uint16)
        images.append(LabelledImage(f"image{number}", colour, None if mask is None else ids, own))
    return MemorySet(name=name, items=tuple(images))


def random_masks(count, seed=0, shape=(12, 16), void=True):
    rng = np.random.default_rng(seed)
    masks = rng.integers(0, 8, (count, *shape)).astype(np.uint8)
    if void:
        masks[rng.random(masks.shape) < 0.1] = IGNORE_CLASS
    return list(masks)


@dataclass(frozen=True)
class ReadsRed:
    """Predicts the class whose id is in the red channel, after `changes` (new id by old id)."""

    classes: ClassTable = ORGANS
    changes: dict = field(default_factory=dict)
    task: str = "segment"

    def probabilities(self, colour):
        ids = colour[..., 0].copy()
        for old, new in self.changes.items():
            ids[colour[..., 0] == old] = new
        indices = self.classes.indices(ids)
        return (indices == np.arange(len(self.classes))[:, None, None]).astype(np.float32)


@dataclass(frozen=True)
class Constant:
    """Gives every pixel the same probabilities."""

    values: tuple[float, ...]
    classes: ClassTable = ORGANS

    def probabilities(self, colour):
        values = np.array(self.values, np.float32)[:, None, None]
        return np.broadcast_to(values, (len(self.values), *colour.shape[:2]))


def parse_page(page):
    """The root of an HTML page, whose elements must be closed in order."""
    assert page.startswith("<!DOCTYPE html>")
    body = re.sub(r"<meta[^>]*>|<!DOCTYPE html>", "", page)
    return ET.fromstring(re.sub(r"(<(?:img|br)[^>]*)>", r"\1/>", body))
