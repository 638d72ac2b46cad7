"""A data set to look at: a contact sheet and a web page that needs no network."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from pepperscene.dataset.atomic import replacing
from pepperscene.dataset.display import View, distance_colours, instance_colours
from pepperscene.dataset.page import page
from pepperscene.dataset.sheet import contact_sheet
from pepperscene.dataset.store import Dataset, open_dataset
from pepperscene.errors import InputError, OutputError
from pepperscene.truth import class_colour

SHOWN: Final = ("colour", "class", "instance", "distance")
PAGE, SHEET = "index.html", "contact_sheet.png"


@dataclass(frozen=True)
class Report:
    """Where a report lies, and of how many frames it shows how many."""

    page: Path
    sheet: Path
    shown: int
    frames: int


def report(folder: str | Path, limit: int = 12) -> Report:
    """Write `contact_sheet.png` and `index.html` into a data set's folder, from the frames that are there.

    The page holds its pictures itself: it can be moved, mailed and opened without a network.

    Args:
        folder: of the data set.
        limit: most frames shown; they are spread over those that are there.

    Raises:
        InputError: there is no data set, or no frame in it, or a file is damaged.
        OutputError: the files cannot be written.
    """
    dataset = open_dataset(folder)
    indices = dataset.indices()
    if not indices:
        raise InputError(folder, "", None, "holds no frames yet; build some first")
    every = {index: dataset.facts(index) for index in indices}
    chosen = _spread(indices, limit)
    near, far = _distance_range(dataset, chosen, every)
    views = [_view(dataset, index, every[index], near, far) for index in chosen]
    target = Report(dataset.folder / PAGE, dataset.folder / SHEET, len(chosen), len(indices))
    try:
        with replacing(target.sheet) as temporary:
            contact_sheet(views, near, far).save(temporary, format="PNG", optimize=True)
        with replacing(target.page) as temporary:
            temporary.write_text(
                page(dataset.about, list(every.values()), views, near, far), encoding="utf-8"
            )
    except OSError as fault:
        raise OutputError(f"{folder}: the report cannot be written ({fault.strerror or fault})") from None
    return target


def _spread(indices: Sequence[int], limit: int) -> list[int]:
    """At most `limit` of the indices, evenly over the whole list."""
    if len(indices) <= limit:
        return list(indices)
    places = np.linspace(0, len(indices) - 1, max(limit, 1)).round().astype(int)
    return [indices[place] for place in places]


def _distance_range(
    dataset: Dataset, indices: Sequence[int], facts: dict[int, dict[str, Any]]
) -> tuple[float, float]:
    """One range for all pictures, so that they can be compared: 1st to 99th percentile of what is hit."""
    samples = []
    for index in indices:
        if "distance" in facts[index]["outputs"]:
            distance = dataset.image(index, "distance")[::8, ::8]
            samples.append(distance[np.isfinite(distance)])
    found = np.concatenate(samples) if samples else np.empty(0)
    if found.size == 0:
        return 0.0, 1.0
    near, far = np.percentile(found, (1, 99))
    return float(near), float(max(far, near + 0.01))


def _view(dataset: Dataset, index: int, facts: dict[str, Any], near: float, far: float) -> View:
    makers = {
        "colour": lambda image: image,
        "class": class_colour,
        "instance": instance_colours,
        "distance": lambda image: distance_colours(image, near, far),
    }
    there = [name for name in SHOWN if name in facts["outputs"]]
    return View(index, facts, {name: makers[name](dataset.image(index, name)) for name in there})
