"""The files of an evaluation: JSON, and a page with its tables and three images."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.classes import IGNORE_COLOUR
from pepperscene.colour.comparison.tables import TextTable
from pepperscene.dataset.readers.image_set import ImageSet
from pepperscene.dataset.report.colours import jpeg_data_uri, png_data_uri
from pepperscene.dataset.report.markup import Html, csp_hash, element, fragment, joined
from pepperscene.dataset.store.atomic import canonical_json, check_can_write, write_files
from pepperscene.errors import InputError
from pepperscene.learning.class_table import ClassTable
from pepperscene.learning.evaluation.evaluate import label_image
from pepperscene.learning.evaluation.evaluation import EvaluatedImage, Evaluation
from pepperscene.learning.evaluation.segmenter import Segmenter

JSON_NAME: Final = "evaluation.json"
PAGE_NAME: Final = "evaluation.html"

_STYLE: Final = """
:root { color-scheme: light dark; }
body { font: 16px/1.5 system-ui, sans-serif; max-width: 75rem; margin: 0 auto; padding: 1rem; }
table { border-collapse: collapse; font-variant-numeric: tabular-nums; }
th, td { padding: .2rem .9rem .2rem 0; text-align: right; border-bottom: 1px solid #8886; }
th:first-child { text-align: left; font-weight: 500; }
.scroll { overflow-x: auto; }
.row { display: grid; grid-template-columns: repeat(3, minmax(0, 1fr)); gap: .5rem; }
figure { margin: 0; }
img { display: block; width: 100%; height: auto; }
.legend { display: flex; flex-wrap: wrap; gap: .3rem 1.1rem; }
.legend svg { width: .9em; height: .9em; margin-right: .4em; outline: 1px solid #8886; }
"""

_IGNORED: Final = "no label"


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
    policy = fragment("default-src 'none'; img-src data:; style-src ", csp_hash(_STYLE))
    head = element(
        "head",
        Html('<meta charset="utf-8">'),
        Html('<meta name="viewport" content="width=device-width, initial-scale=1">'),
        Html(f'<meta http-equiv="Content-Security-Policy" content="{policy}">'),
        element("title", title),
        element("style", Html(_STYLE)),
    )
    body = element(
        "body",
        element("main", element("h1", title), *map(_table_html, evaluation.tables()), *_panels(pictures)),
    )
    return fragment(Html("<!DOCTYPE html>\n"), element("html", head, body, lang="en"))


def _table_html(table: TextTable) -> Html:
    """A text table as a section of the page."""
    header = element("tr", *(element("th", head, scope="col") for head in table.heads))
    rows = [
        element("tr", element("th", name, scope="row"), *(element("td", cell) for cell in cells))
        for name, *cells in table.rows
    ]
    content = element("table", element("thead", header), element("tbody", *rows))
    region = element("div", content, class_="scroll", tabindex=0, role="region", aria_label=table.title)
    return element(
        "section", element("h2", table.title), region, *(element("p", note) for note in table.notes)
    )


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
    size = {"height": truth.shape[0], "width": truth.shape[1]}
    panels = [
        ("photograph", jpeg_data_uri(read.colour)),
        ("mask", png_data_uri(palette[truth])),
        ("prediction", png_data_uri(palette[prediction])),
    ]
    figures = [
        element(
            "figure",
            element("img", src=uri, alt=f"{title} of {image.name}", **size),
            element("figcaption", title),
        )
        for title, uri in panels
    ]
    present = sorted({*np.unique(truth).tolist(), *np.unique(prediction).tolist()})
    names = {**dict(enumerate(classes.names)), 255: _IGNORED}
    legend = [element("span", _swatch(palette[index]), names[index]) for index in present]
    heading = f"{word.capitalize()}: {image.name} of {images.name}, mean IoU {100.0 * image.mean_iou:.1f} %"
    return fragment(
        element("h3", heading),
        element("div", *figures, class_="row"),
        element("p", joined(legend, " "), class_="legend"),
    )


def class_palette_of(classes: ClassTable) -> NDArray[np.uint8]:
    """8-bit RGB `(256, 3)` of the indices of a table; grey for pixels without a label."""
    palette = np.full((256, 3), IGNORE_COLOUR, np.uint8)
    palette[: len(classes)] = classes.colours
    return palette


def _swatch(colour: NDArray[np.uint8]) -> Html:
    """A patch of a class's colour."""
    code = "#" + bytes(colour.tolist()).hex()
    patch = element("rect", width=10, height=10, fill=code)
    return element("svg", patch, viewBox="0 0 10 10", aria_hidden="true")
