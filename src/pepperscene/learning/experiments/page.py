"""The page of the experiments: table, chart, curves, differences and pictures."""

from __future__ import annotations

import base64
import io
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.colour.comparison.bootstrap import Estimate
from pepperscene.colour.comparison.tables import TextTable
from pepperscene.dataset.readers.image_set import LabelledImage
from pepperscene.dataset.report.colours import jpeg_data_uri, png_data_uri
from pepperscene.dataset.report.markup import Html, element, fragment
from pepperscene.dataset.store.atomic import canonical_json, write_files
from pepperscene.learning.evaluation.confusion import mean_intersection_over_union
from pepperscene.learning.evaluation.segmenter import predict_classes
from pepperscene.learning.experiments.results import Results
from pepperscene.learning.experiments.run import ExperimentRun
from pepperscene.learning.page_parts import (
    class_legend,
    class_palette_of,
    page_document,
    picture_row,
    table_section,
)
from pepperscene.version import __version__

if TYPE_CHECKING:
    from matplotlib.figure import Figure

JSON_NAME: Final = "experiments.json"
PAGE_NAME: Final = "experiments.html"

MEANINGS: Final[Mapping[str, str]] = {
    "A": "trained and tested on synthetic images",
    "B": "trained on synthetic, tested on real images",
    "C": "trained on real images alone",
    "D": "started from an unrelated set, adapted to real images",
    "E": "trained on synthetic images, adapted to real ones",
}
DIFFERENCES: Final = (("B", "C"), ("E", "C"), ("E", "B"), ("E", "D"), ("D", "C"))
"""Pairs of experiments on the same images, of which the page gives the difference."""

_COLOURS: Final = {"A": "#7a7a7a", "B": "#2c6fbb", "C": "#d98c21", "D": "#8e5ba6", "E": "#3c7a32"}


def write_page(run: ExperimentRun) -> tuple[Path, ...]:
    """Write `experiments.json` and `experiments.html` into the folder of the experiments, both or none.

    Raises:
        OutputError: a file cannot be written.
    """
    content = {
        JSON_NAME: canonical_json(results_json(run)),
        PAGE_NAME: _page_html(run).encode(),
    }
    return write_files(run.out, content)


def results_json(run: ExperimentRun) -> dict[str, Any]:
    """All numbers of the experiments as JSON values."""
    results = run.results
    return {
        "format": "pepperscene experiments 1",
        "version": __version__,
        "options": run.options.as_record(),
        "experiments": {letter: found.to_json() for letter, found in results.items()},
        "differences": {
            f"{first}-{second}": _estimate_json(results[first].above(results[second]))
            for first, second in DIFFERENCES
            if first in results and second in results
        },
        "notes": list(run.notes),
        "logs": {name: list(entries) for name, entries in run.logs.items()},
    }


def result_tables(run: ExperimentRun) -> list[TextTable]:
    """The results as text tables: real images, synthetic images, differences."""
    real = [found for letter, found in run.results.items() if letter != "A"]
    tables = [
        _iou_table("Real images: IoU, %", real),
        _iou_table("Synthetic images: IoU, %", [run.results["A"]]),
    ]
    rows = [
        (f"{first} - {second}", f"{MEANINGS[first]}; {MEANINGS[second]}", _percent(above))
        for first, second in DIFFERENCES
        if first in run.results and second in run.results
        for above in [run.results[first].above(run.results[second])]
    ]
    heads = ("difference", "experiments", "mean IoU, % [95 %]")
    return [*tables, TextTable("Differences on the same images", heads, tuple(rows), ())]


def _iou_table(title: str, results: Sequence[Results]) -> TextTable:
    """One row for each experiment."""
    heads = ("", *results[0].classes.names, "mean [95 %]", "sd of seeds", "images", "")
    rows = []
    for found in results:
        deviation = found.seed_deviation()
        rows.append(
            (
                found.letter,
                *(_percent(estimate) for estimate in found.iou()),
                _percent(found.mean_iou()),
                "-" if deviation is None else f"{100 * deviation:.1f}",
                str(len(found.images)),
                MEANINGS[found.letter],
            )
        )
    notes = (f"{len(results[0].seeds)} seeds; intervals are those of the Bayesian bootstrap over images.",)
    return TextTable(title, heads, tuple(rows), notes)


def _percent(estimate: Estimate) -> str:
    if estimate.value is None:
        return "-"
    text = f"{100 * estimate.value:.1f}"
    if estimate.low is None or estimate.high is None:
        return text
    return f"{text} [{100 * estimate.low:.1f}, {100 * estimate.high:.1f}]"


def _estimate_json(estimate: Estimate) -> dict[str, float | None]:
    return {"value": estimate.value, "low": estimate.low, "high": estimate.high}


# --- page ---------------------------------------------------------------------------------------------------


def _page_html(run: ExperimentRun) -> Html:
    real = [found for letter, found in run.results.items() if letter != "A"]
    options = run.options.as_record()
    settings = TextTable("Options", ("option", "value"), tuple((k, str(v)) for k, v in options.items()), ())
    return page_document(
        "Experiments A to E",
        element("section", *(element("p", note) for note in run.notes)),
        element(
            "section", element("h2", "IoU on real images"), _figure(_bar_chart(real), "IoU of each class")
        ),
        *(table_section(table) for table in result_tables(run)),
        element("section", element("h2", "Trainings"), _figure(_curves(run), "Loss and validation by step")),
        _pictures(run),
        table_section(settings),
    )


def _figure(figure: Figure, text: str) -> Html:
    """A chart as an SVG image."""
    file = io.BytesIO()
    figure.savefig(file, format="svg", metadata={"Date": None})
    uri = f"data:image/svg+xml;base64,{base64.b64encode(file.getvalue()).decode()}"
    return element("img", src=uri, alt=text)


def _bar_chart(results: Sequence[Results]) -> Figure:
    """IoU of each class and the mean, a group of bars for each, as Fig. 14 of the paper."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9, 3.4), layout="constrained")
    axes = figure.subplots()
    groups = (*results[0].classes.names, "mean")
    width = 0.8 / len(results)
    for number, found in enumerate(results):
        estimates = (*found.iou(), found.mean_iou())
        values = np.array([estimate.value or 0.0 for estimate in estimates])
        low = [value if e.low is None else e.low for value, e in zip(values, estimates, strict=True)]
        high = [value if e.high is None else e.high for value, e in zip(values, estimates, strict=True)]
        places = np.arange(len(groups)) + (number - (len(results) - 1) / 2) * width
        errors = np.clip([values - low, np.array(high) - values], 0, None)
        label = f"{found.letter}: {MEANINGS[found.letter]}"
        axes.bar(
            places, values, 0.9 * width, yerr=errors, color=_COLOURS[found.letter], label=label, capsize=2
        )
    axes.set(xticks=np.arange(len(groups)), xticklabels=groups, ylabel="IoU", ylim=(0, 1))
    axes.legend(frameon=False, fontsize=8)
    axes.spines[["top", "right"]].set_visible(False)
    return figure


def _curves(run: ExperimentRun) -> Figure:
    """Loss of all trainings, and mean IoU of those with a validation."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9, 3.2), layout="constrained")
    for axes, key, title in zip(
        figure.subplots(1, 2), ("loss", "mean_iou"), ("loss", "mean IoU of the validation"), strict=True
    ):
        for name, entries in run.logs.items():
            points = [(entry["step"], entry[key]) for entry in entries if entry[key] is not None]
            if points:
                axes.plot(*zip(*points, strict=True), color=_COLOURS[name[0]], lw=1, marker=".", ms=3)
        axes.set(xlabel="step", title=title)
        axes.spines[["top", "right"]].set_visible(False)
    return figure


def _pictures(run: ExperimentRun) -> Html:
    """The best, the median and the worst real image of B, as seen by each experiment's first network."""
    images = run.results["B"].images
    quality = {name: float(mean_intersection_over_union(matrix)) for name, matrix in images.items()}
    ranked = sorted(quality, key=lambda name: -quality[name])
    chosen = {"Best": ranked[0], "Median": ranked[len(ranked) // 2], "Worst": ranked[-1]}
    sections = []
    for word, name in chosen.items():
        fold, image = _find_image(run, name)
        heading = f"{word} of B: {name}, mean IoU {100 * quality[name]:.1f} %"
        sections.append(fragment(element("h3", heading), _image_row(run, fold, image)))
    return element("section", element("h2", "Real images"), *sections)


def _find_image(run: ExperimentRun, name: str) -> tuple[int, LabelledImage]:
    """Number of the fold that tests an image, from 1, and the image."""
    for number, fold in enumerate(run.folds, start=1):
        names = [f"{fold.test.name}/{own}" for own in fold.test.names()]
        if name in names:
            return number, fold.test.select("colour", "classes")[names.index(name)]
    raise AssertionError(name)


def _image_row(run: ExperimentRun, fold: int, image: LabelledImage) -> Html:
    """Photograph, mask, and the prediction of each experiment."""
    classes = run.results["B"].classes
    palette = class_palette_of(classes)
    assert image.colour is not None
    assert image.classes is not None
    shown: dict[str, NDArray[np.uint8]] = {"mask": classes.indices(image.classes)}
    for letter in (letter for letter in run.results if letter != "A"):
        model = run.model("A-seed0" if letter == "B" else f"{letter}-fold{fold}-seed0")
        shown[f"prediction of {letter}"] = predict_classes(
            model, image.colour, classes.merging(model.classes)
        )
    panels = [("photograph", jpeg_data_uri(image.colour))]
    panels += [(title, png_data_uri(palette[indices])) for title, indices in shown.items()]
    row = picture_row(panels, image.name, image.size)
    return fragment(row, class_legend(classes, *shown.values()))
