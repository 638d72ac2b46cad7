"""Objects as outlines on their photographs, and as results in the format of COCO."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, Final, final

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from pepperscene.atomic import canonical_json
from pepperscene.dataset.store.images import png_bytes
from pepperscene.learning.class_table import ClassTable
from pepperscene.learning.evaluation.average_precision import object_record
from pepperscene.learning.models.trained_model import TrainedModel
from pepperscene.version import __version__

OUTLINES: Final = "outlines"
RESULTS_NAME: Final = "detections.json"
IMAGES_NAME: Final = "images.json"

_SIDE_OF_LINE: Final = 400  # chosen: pixels of an image's longer side for one of a line's width
_LINES_OF_TEXT: Final = 5  # chosen: height of a text in widths of lines, with _LEAST_TEXT pixels or more
_LEAST_TEXT: Final = 9

Outline = tuple[NDArray[np.bool_], tuple[int, ...], str]
"""Mask `(h, w)`, 8-bit RGB, and the text beside it."""


def draw_outlines(colour: NDArray[np.uint8], outlines: Iterable[Outline]) -> NDArray[np.uint8]:
    """An sRGB image `(h, w, 3)` with outlines of objects around their masks."""
    from scipy import ndimage

    drawn, width = colour.copy(), max(1, round(max(colour.shape) / _SIDE_OF_LINE))
    texts = []
    for mask, shade, text in outlines:
        rows, columns = np.nonzero(mask.any(axis=1))[0], np.nonzero(mask.any(axis=0))[0]
        if not len(rows):
            continue
        top, left = max(0, rows[0] - width), max(0, columns[0] - width)
        box = slice(top, rows[-1] + width + 1), slice(left, columns[-1] + width + 1)
        inside = mask[box]
        drawn[box][ndimage.binary_dilation(inside, iterations=width) & ~inside] = shade
        texts.append(((int(left), int(top)), shade, text))
    # Texts are above the outlines, so that they hide no object.
    picture, height = Image.fromarray(drawn), max(_LEAST_TEXT, _LINES_OF_TEXT * width)
    draw, font = ImageDraw.Draw(picture), ImageFont.load_default(height)
    for (left, top), shade, text in texts:
        place = (left, max(0, top - height - 2))
        draw.text(place, text, shade, font, stroke_width=1, stroke_fill=(0, 0, 0))
    return np.asarray(picture)


@final
class ObjectWriter:
    """The files of the objects that a detector finds in images, which are added one after another.

    `detections.json` is a list of COCO's results, with all objects from a score of .05 on. The numbers of
    images and categories are those of `images.json`, which has the form of COCO's annotations, without any.

    Args:
        model: a trained detector.
        table: classes to which the model's are merged.
        least_score: of the objects whose outlines are drawn.
    """

    def __init__(self, model: TrainedModel, table: ClassTable, least_score: float) -> None:
        model.check_task("detect")
        self._model, self._table, self._least_score = model, table, least_score
        self._merged = table.merging(model.classes)
        self._results: list[dict[str, Any]] = []
        self._images: list[dict[str, Any]] = []

    def add(self, name: str, colour: NDArray[np.uint8]) -> dict[str, bytes]:
        """Find the objects of an image; returns its picture with outlines by the folder of such pictures."""
        number, (height, width) = len(self._images) + 1, colour.shape[:2]
        self._images.append({"id": number, "file_name": name, "height": height, "width": width})
        found, outlines = self._model.detections(colour), []
        for position, model_label in enumerate(found.labels):
            for label in np.flatnonzero(self._merged[:, model_label]).tolist():
                mask, score = found.mask(position), float(found.scores[position])
                entry = object_record(number, label + 1, found.boxes[position], mask, score=score)
                self._results.append({key: entry[key] for key in entry if key != "area"})
                if score >= self._least_score:
                    shade = tuple(self._table.colours[label].tolist())
                    outlines.append((mask, shade, f"{self._table.names[label]} {score:.2f}"))
        return {OUTLINES: png_bytes(draw_outlines(colour, outlines))}

    def files(self) -> dict[str, bytes]:
        """The files of all images."""
        categories = [{"id": index, "name": name} for index, name in enumerate(self._table.names, start=1)]
        info = {"description": f"pepperscene {__version__}, detections of {self._model.model}"}
        images = {"info": info, "images": self._images, "categories": categories}
        return {RESULTS_NAME: canonical_json(self._results), IMAGES_NAME: canonical_json(images)}
