"""The files of an evaluation: JSON, and a page with its tables and three images."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.atomic import canonical_json, check_can_write, write_files
from pepperscene.dataset.readers.image_set import ImageSet
from pepperscene.errors import InputError
from pepperscene.learning.class_table import ClassTable
from pepperscene.learning.evaluation.evaluate import Segmenter, label_image
from pepperscene.learning.evaluation.evaluation import EvaluatedImage, Evaluation
from pepperscene.learning.page_parts import (
    class_legend,
    class_palette_of,
    page_document,
    picture_row,
    table_section,
)
from pepperscene.review.report.colours import jpeg_data_uri, png_data_uri
from pepperscene.review.report.markup import Html, element, fragment

JSON_NAME: Final = "evaluation.json"
PAGE_NAME: Final = "evaluation.html"


@dataclass(frozen=True)
class EvaluationFiles:
    """The files of an evaluation.

    Attributes:
        data: the JSON file.
        page: the HTML file.
    """

    data: Path
    page: Path


def write_evaluation(
    evaluation: Evaluation, model: Segmenter, sets: ImageSet | Sequence[ImageSet], out: str | Path
) -> EvaluationFiles:
    """Write `evaluation.json` and `evaluation.html` into a folder, both or none.

    The page needs no other file. It shows the images with the highest, the median and the lowest mean IoU,
    each as photograph, mask and prediction.

    Args:
        evaluation: result of `evaluate`.
        model: the model that was evaluated; it predicts the images of the page again.
        sets: the sets that were evaluated, in the same order.
        out: the folder, which is made if missing.

    Raises:
        InputError: the sets are not those of the evaluation, or an image cannot be read any more.
        OutputError: a file cannot be written.
    """
    folder = Path(out)
    check_can_write(folder, (JSON_NAME, PAGE_NAME))
    sets = (sets,) if isinstance(sets, ImageSet) else tuple(sets)
    names = tuple(item.name for item in evaluation.sets)
    if tuple(images.name for images in sets) != names:
        raise InputError("sets", f"must be the evaluated ones: {', '.join(names)}")
    page = _page_html(evaluation, model, sets)
    content = {JSON_NAME: canonical_json(evaluation.to_json()), PAGE_NAME: page.encode()}
    return EvaluationFiles(*write_files(folder, content))


def select_images(images: Sequence[EvaluatedImage]) -> list[tuple[str, EvaluatedImage]]:
    """The best, the median and the worst image by their mean IoU, with these words; fewer of fewer images."""
    ranked = [image for image in images if np.isfinite(image.mean_iou)]
    ranked.sort(key=lambda image: -image.mean_iou)
    places = {"best": 0, "median": len(ranked) // 2, "worst": len(ranked) - 1}
    # Of one or two images, some of the three are the same.
    chosen: dict[int, str] = {}
    for word, place in sorted(places.items(), key=lambda item: item[0] == "median"):
        chosen.setdefault(place, word)
    return [(chosen[place], ranked[place]) for place in sorted(chosen)]


def _page_html(evaluation: Evaluation, model: Segmenter, sets: Sequence[ImageSet]) -> Html:
    merging = evaluation.classes.merging(model.classes)
    pictures = [
        _image_html(word, image, evaluation.classes, model, merging, sets)
        for word, image in select_images(evaluation.images)
    ]
    title = f"Evaluation on {', '.join(item.name for item in evaluation.sets)}"
    return page_document(title, *map(table_section, evaluation.tables()), *_panels(pictures))


def _panels(pictures: Sequence[Html]) -> list[Html]:
    return [element("section", element("h2", "Images by their own mean IoU"), *pictures)] if pictures else []


def _image_html(
    word: str,
    image: EvaluatedImage,
    classes: ClassTable,
    model: Segmenter,
    merging: NDArray[np.float32],
    sets: Sequence[ImageSet],
) -> Html:
    """One image as photograph, mask and prediction, with a legend of the classes that occur."""
    images = sets[image.set_number]
    read = images.select("colour", "classes")[image.position]
    if read.classes is None:
        raise InputError(images.name, f"{image.name} has no mask any more")
    truth, prediction = label_image(model, classes, merging, read)
    assert read.colour is not None
    palette = class_palette_of(classes)
    panels = [
        ("photograph", jpeg_data_uri(read.colour)),
        ("mask", png_data_uri(palette[truth])),
        ("prediction", png_data_uri(palette[prediction])),
    ]
    heading = f"{word.capitalize()}: {image.name} of {images.name}, mean IoU {100.0 * image.mean_iou:.1f} %"
    row = picture_row(panels, image.name, (truth.shape[0], truth.shape[1]))
    return fragment(element("h3", heading), row, class_legend(classes, truth, prediction))
