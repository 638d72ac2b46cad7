"""Images of large shapes, whose colours say their classes, for trainings of seconds."""

from __future__ import annotations

import numpy as np
from PIL import Image, ImageDraw
from toy_models import ListedImages

from pepperscene.dataset.readers.image_set import LabelledImage

COLOURS = {0: (40, 40, 50), 1: (40, 140, 60), 2: (210, 40, 40), 4: (200, 180, 120)}


def shape_images(count, size=(64, 64), seed=0):
    """`count` labelled images with a leaf, a fruit and a stem on a background."""
    images = []
    for number in range(count):
        rng = np.random.default_rng([seed, number])
        mask = Image.new("L", (size[1], size[0]), 0)
        draw = ImageDraw.Draw(mask)
        for class_id in (1, 4, 2):
            x, y = rng.uniform(0.1, 0.6, 2) * (size[1], size[0])
            width, height = rng.uniform(0.3, 0.5, 2) * (size[1], size[0])
            shape = draw.rectangle if class_id == 4 else draw.ellipse
            shape((x, y, x + width, y + height), fill=class_id)
        classes = np.array(mask)
        table = np.zeros((256, 3))
        for class_id, colour in COLOURS.items():
            table[class_id] = colour
        colour = np.clip(table[classes] + rng.normal(0, 8, (*size, 3)), 0, 255).astype(np.uint8)
        images.append(LabelledImage(f"shapes{number}", colour, classes))
    return images


def shapes(count, size=(64, 64), seed=0, name="shapes"):
    """A set of such images in memory."""
    return ListedImages(name=name, items=tuple(shape_images(count, size, seed)))


def write_shapes(folder, count, size=(64, 64), seed=0):
    """A folder of such images and their masks, whose values are class ids."""
    folder.mkdir(parents=True)
    for image in shape_images(count, size, seed):
        Image.fromarray(image.colour).save(folder / f"{image.name}.png")
        Image.fromarray(image.classes).save(folder / f"{image.name}_mask.png")
    return folder
