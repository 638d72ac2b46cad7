"""Pages of evaluations and experiments: templates, which escape all texts, and pictures with a legend."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from markupsafe import Markup
from numpy.typing import NDArray

from pepperscene.classes import IGNORE_CLASS, IGNORE_COLOUR
from pepperscene.learning.class_table import ClassTable
from pepperscene.review.report.page import html_environment


@dataclass(frozen=True)
class ImagePanels:
    """Pictures of one image beside each other.

    Attributes:
        heading: above them.
        name: of the image.
        size: height and width in pixels.
        panels: title and data URI of each picture.
        legend: colours ("#rrggbb") and what they stand for.
    """

    heading: str
    name: str
    size: tuple[int, ...]
    panels: Sequence[tuple[str, str]]
    legend: Sequence[tuple[str, str]] = ()


def render_page(template: str, title: str, **context: Any) -> str:
    """A complete page of a template with a title."""
    environment = html_environment("pepperscene.learning")
    style = Markup(environment.get_template("page.css").render())
    return environment.get_template(template).render(title=title, style=style, **context)


def ranked_examples(mean_iou: NDArray[np.float64]) -> list[tuple[str, int]]:
    """Word and position of the best, the median and the worst image by mean IoU `(n,)`.

    Fewer of fewer images; those whose mean IoU is unknown are left out.
    """
    order = [int(at) for at in np.argsort(-mean_iou, kind="stable") if np.isfinite(mean_iou[at])]
    if not order:
        return []
    # Of one or two images, later words replace earlier ones.
    words = {len(order) // 2: "median", len(order) - 1: "worst", 0: "best"}
    return [(words[place], order[place]) for place in sorted(words)]


def class_legend(classes: ClassTable, *indices: NDArray[np.uint8]) -> list[tuple[str, str]]:
    """Colours and names of the classes that occur in index images."""
    palette = class_palette_of(classes)
    names = {**dict(enumerate(classes.names)), IGNORE_CLASS: "no label"}
    present = sorted({int(index) for image in indices for index in np.unique(image)})
    return [("#" + bytes(palette[index].tolist()).hex(), names[index]) for index in present]


def class_palette_of(classes: ClassTable) -> NDArray[np.uint8]:
    """8-bit RGB `(256, 3)` of the indices of a table; grey for pixels without a label."""
    palette = np.full((256, 3), IGNORE_COLOUR, np.uint8)
    palette[: len(classes)] = classes.colours
    return palette
