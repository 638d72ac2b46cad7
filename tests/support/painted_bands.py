"""Small images of four large regions, which a network learns in seconds, in memory and in folders."""

from __future__ import annotations

import numpy as np
from memory_set import MemorySet
from PIL import Image

from pepperscene.classes import OrganClass
from pepperscene.dataset.readers.image_set import LabelledImage

SIZE = (64, 96)
CLASSES = "background,leaf,pepper,stem"
COLOURS = np.array(
    [(60, 60, 70), (40, 120, 40), (200, 40, 30), (120, 180, 90), (90, 140, 190), (30, 70, 110),
     (220, 220, 220), (230, 180, 60)], np.uint8,
)  # fmt: skip
"""Of the eight organ classes."""


def paint_bands(count, seed=0, size=SIZE):
    """Background above a leaf, a pepper and a stem side by side, in random order and of random sizes."""
    rng = np.random.default_rng(seed)
    images = []
    for number in range(count):
        ids = np.zeros(size, np.uint8)
        top = size[0] // 4 + int(rng.integers(-6, 7))
        left, right = (third * size[1] // 3 + int(rng.integers(-8, 9)) for third in (1, 2))
        organs = rng.permutation([OrganClass.LEAF, OrganClass.PEPPER, OrganClass.STEM])
        ids[top:, :left], ids[top:, left:right], ids[top:, right:] = organs
        noise = rng.integers(-12, 13, (*size, 3))
        colour = np.clip(COLOURS[ids].astype(int) + noise, 0, 255).astype(np.uint8)
        images.append(LabelledImage(f"image{number}", colour, ids))
    return images


def bands_set(count, seed=0, size=SIZE, name="bands"):
    """A set in memory."""
    return MemorySet(name=name, items=tuple(paint_bands(count, seed, size)))


def write_bands(folder, count, seed=0, size=SIZE, masks=True):
    """A folder of images and masks with a table of labels."""
    folder.mkdir(parents=True)
    for image in paint_bands(count, seed, size):
        Image.fromarray(image.colour).save(folder / f"{image.name}.png")
        if masks:
            Image.fromarray(image.classes).save(folder / f"{image.name}_mask.png")
    lines = [f'{value} = "{organ.name.lower()}"' for value, organ in enumerate(OrganClass)]
    (folder / "classes.toml").write_text("\n".join(lines), encoding="utf-8")
    return folder
