"""Sets of images in memory whose pixels hold their own coordinates, for the torch data sets."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pepperscene.dataset.readers.image_set import ImageSet, LabelledImage

SIZE = (40, 60)


class MemorySet(ImageSet):
    """Its items are images."""

    def names(self):
        return tuple(image.name for image in self.items)

    def read(self, item):
        skipped = {"colour", "classes", "instances", "distance_m"} - set(self.fields)
        return replace(item, **dict.fromkeys(skipped))


def memory_set(*images):
    return MemorySet(name="memory", items=images)


def coded_arrays(height=SIZE[0], width=SIZE[1]):
    """Arrays of a sample: red and green of a pixel are its row and column, labels are their number."""
    rows, columns = np.mgrid[:height, :width]
    numbers = 1 + rows * width + columns
    return {
        "image": np.stack([rows, columns, np.full_like(rows, 9)], axis=-1).astype(np.uint8),
        "mask": (numbers % 8).astype(np.uint8),
        "instances": numbers.astype(np.uint16),
        "distance": numbers.astype(np.float32),
    }


def image_of(arrays, name="coded"):
    return LabelledImage(name, arrays["image"], arrays["mask"], arrays["instances"], arrays["distance"])


def coded_set(count=6):
    """The same image several times."""
    arrays = coded_arrays()
    return memory_set(*(image_of(arrays, f"coded{number}") for number in range(count)))


def labelled(classes, instances, name="hand-made"):
    """An image of one grey with these labels."""
    classes, instances = np.array(classes, np.uint8), np.array(instances, np.uint16)
    return LabelledImage(name, np.full((*classes.shape, 3), 90, np.uint8), classes, instances)
