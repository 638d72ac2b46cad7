"""The files of an evaluation: JSON, and a page with its tables and three images."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from pepperscene.atomic import canonical_json, check_can_write, write_files
from pepperscene.dataset.readers.image_set import ImageSet
from pepperscene.errors import InputError
from pepperscene.learning.class_table import ClassTable
from pepperscene.learning.evaluation.detection import DetectionEvaluation
from pepperscene.learning.evaluation.evaluate import Segmenter, label_image
from pepperscene.learning.evaluation.evaluation import EvaluatedImage, Evaluation
from pepperscene.learning.pages import (
    ImagePanels,
    class_legend,
    class_palette_of,
    ranked_examples,
    render_page,
)
from pepperscene.review.report.colours import jpeg_data_uri, png_data_uri

JSON_NAME: Final = "evaluation.json"
PAGE_NAME: Final = "evaluation.html"


@dataclass(frozen=True)
class EvaluationFiles:
    """The files of an evaluation, JSON and HTML."""

    data: Path
    page: Path


def write_evaluation(
    evaluation: Evaluation | DetectionEvaluation,
    model: Segmenter,
    sets: ImageSet | Sequence[ImageSet],
    out: str | Path,
) -> EvaluationFiles:
    """Write `evaluation.json` and `evaluation.html` into a folder, both or none.

    The page needs no other file. It shows the images with the highest, the median and the lowest mean IoU,
    each as photograph, mask and prediction; of a detector, which `predict` draws, the tables alone.

    Args:
        evaluation: result of `evaluate` or `evaluate_detector`.
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
    examples = []
    if isinstance(evaluation, Evaluation):
        mean_iou = np.array([image.mean_iou for image in evaluation.images])
        examples = [
            _image_panels(word, evaluation.images[at], evaluation.classes, model, sets)
            for word, at in ranked_examples(mean_iou)
        ]
    title = f"Evaluation on {', '.join(names)}"
    page = render_page("evaluation.html", title, tables=evaluation.tables(), images=examples)
    content = {JSON_NAME: canonical_json(evaluation.to_json()), PAGE_NAME: page.encode()}
    return EvaluationFiles(*write_files(folder, content))


def _image_panels(
    word: str, image: EvaluatedImage, classes: ClassTable, model: Segmenter, sets: Sequence[ImageSet]
) -> ImagePanels:
    """One image as photograph, mask and prediction, with a legend of the classes that occur."""
    images = sets[image.set_number]
    read = images.select("colour", "classes")[image.position]
    if read.classes is None:
        raise InputError(images.name, f"{image.name} has no mask any more")
    truth, prediction = label_image(model, classes, classes.merging(model.classes), read)
    assert read.colour is not None
    palette = class_palette_of(classes)
    panels = (
        ("photograph", jpeg_data_uri(read.colour)),
        ("mask", png_data_uri(palette[truth])),
        ("prediction", png_data_uri(palette[prediction])),
    )
    heading = f"{word.capitalize()}: {image.name} of {images.name}, mean IoU {100.0 * image.mean_iou:.1f} %"
    return ImagePanels(heading, image.name, truth.shape, panels, class_legend(classes, truth, prediction))
