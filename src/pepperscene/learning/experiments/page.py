"""The page of the experiments: tables, charts, pictures and what was used; it needs no other file."""

from __future__ import annotations

import base64
import io
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from pepperscene.dataset.readers.image_set import ImageSet
from pepperscene.learning.class_table import ClassTable
from pepperscene.learning.evaluation.evaluate import label_image
from pepperscene.learning.experiments.jobs import MERGED, JobRunner, NetworkJob
from pepperscene.learning.experiments.results import ExperimentResult
from pepperscene.learning.pages import (
    ImagePanels,
    class_legend,
    class_palette_of,
    ranked_examples,
    render_page,
)
from pepperscene.review.report.colours import jpeg_data_uri, png_data_uri

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_TITLE: Final = "Training on synthetic images, tested on photographs"
_SHOWN: Final = ("B", "C", "D", "E")

_COLOURS: Final = MappingProxyType(
    {"A": "#8c8c8c", "B": "#e69f00", "C": "#56b4e9", "D": "#cc79a7", "E": "#009e73"}
)
"""Of experiments; apart from grey, those of Okabe and Ito, which colour-blind people can distinguish."""

_DASHES: Final = ("solid", (0, (3, 1.5)), (0, (1, 1.5)), (0, (4, 1.5, 1, 1.5)))


def experiments_page(
    content: Mapping[str, Any], pictures: Sequence[ImagePanels], times: Mapping[str, float]
) -> str:
    """The page of the content of `experiments.json`, with the seconds of each training and test."""
    by_key = {item["key"]: item for item in content["experiments"]}
    # A to E in common classes.
    results = {key: by_key[MERGED] if key == "A" and MERGED in by_key else by_key[key] for key in "ABCDE"}
    ran = {key: item for key, item in results.items() if item["ran"]}
    names = [measure["name"] for measure in next(iter(ran.values()))["measures"]]
    groups = [{key: item["measures"][at] for key, item in ran.items()} for at in range(len(names))]
    classes = ClassTable.parse(content["classes"])
    return render_page(
        "experiments.html",
        _TITLE,
        content=content,
        format_measure=format_measure,
        measured=names,
        result_rows=[_result_row(key, item, len(names)) for key, item in results.items()],
        missing=[(key, item["why"]) for key, item in results.items() if not item["ran"]],
        bars=_bar_chart("IoU by class and experiment, in percent", names, groups),
        experiment_colours=[(_COLOURS[key], f"{key}: {_short(item['title'])}") for key, item in ran.items()],
        # Experiment A in its own classes, where the others have fewer.
        organ_rows=[
            (measure["name"], *format_measure(measure).partition(" ± ")[::2])
            for measure in (by_key["A"]["measures"] if MERGED in by_key else ())
        ],
        classes=class_legend(classes, np.arange(len(classes), dtype=np.uint8)),
        images=pictures,
        curves=_curves(content["trainings"]),
        image_lines=_image_lines(content),
        training_lines=_training_lines(content),
        version_lines=_version_lines(content, times),
    )


def format_measure(measure: Mapping[str, Any], *, signed: bool = False) -> str:
    """A value in percent with its interval, and the standard deviation over seeds if there is one."""
    if measure["value"] is None:
        return "-"
    sign = "+" if signed else ""
    text = f"{100 * measure['value']:{sign}.1f}"
    if measure["low"] is not None:
        text += f" [{100 * measure['low']:{sign}.1f}, {100 * measure['high']:{sign}.1f}]"
    deviation = measure.get("sd_over_seeds")
    return text if deviation is None else f"{text} ± {100 * deviation:.1f}"


def picture_rows(
    results: Mapping[str, ExperimentResult],
    jobs: Sequence[NetworkJob],
    runner: JobRunner,
    real: ImageSet,
    classes: ClassTable,
) -> tuple[ImagePanels, ...]:
    """The best, the median and the worst image of experiment B, with predictions of the first seed."""
    mean_iou = results["B"].image_mean_iou()
    palette = class_palette_of(classes)
    rows = []
    for word, at in ranked_examples(mean_iou):
        name = results["B"].images[at][1]
        image = real.select("colour", "classes")[real.names().index(name)]
        assert image.colour is not None
        assert image.classes is not None
        panels = [
            ("photograph", jpeg_data_uri(image.colour)),
            ("truth", png_data_uri(palette[classes.indices(image.classes)])),
        ]
        for experiment in _SHOWN:
            job = _job_that_tests(jobs, experiment, name)
            if job is not None:
                model = runner.load(job)
                _, prediction = label_image(model, classes, classes.merging(model.classes), image)
                panels.append((experiment, png_data_uri(palette[prediction])))
        heading = f"{word.capitalize()} of B: {name}, mean IoU {100 * mean_iou[at]:.1f} %"
        rows.append(ImagePanels(heading, name, image.colour.shape[:2], panels))
    return tuple(rows)


def _job_that_tests(jobs: Sequence[NetworkJob], experiment: str, name: str) -> NetworkJob | None:
    """The first job, that is of the first seed, that is tested on an image in an experiment."""
    for job in jobs:
        for test in job.tests:
            if test.experiment == experiment and any(name in images.names() for images in test.images):
                return job
    return None


def _short(title: str) -> str:
    return title.removesuffix(", in the classes of photographs")


def _result_row(key: str, item: Mapping[str, Any], columns: int) -> list[str]:
    name = f"{key}: {_short(item['title'])}"
    if not item["ran"]:
        return [name, "not run", *[""] * columns]
    return [name, f"{item['images']:,}", *map(format_measure, item["measures"])]


@dataclass(frozen=True)
class Chart:
    """An image of a chart, and its title for those who cannot see it."""

    title: str
    uri: str


def _bar_chart(title: str, names: Sequence[str], groups: Sequence[Mapping[str, Mapping[str, Any]]]) -> Chart:
    """IoU in percent: for each name, bars by experiment with intervals as lines and the value above."""

    def draw(axes: Axes) -> None:
        for number, measures in enumerate(groups):
            width = 0.8 / len(measures)
            for place, (key, measure) in enumerate(measures.items()):
                middle = number + (place + 0.5) * width - 0.4
                value, low, high = (measure[part] for part in ("value", "low", "high"))
                label, top = "-", 0.0
                if value is not None:
                    top = 100 * value
                    axes.bar(middle, top, 0.95 * width, color=_COLOURS[key])
                    label = f"{top:.0f}"
                    if low is not None and high is not None:
                        axes.plot([middle, middle], [100 * low, 100 * high], color="#1a1a1a", linewidth=1)
                        top = 100 * high
                axes.annotate(
                    label, (middle, top), (0, 2), textcoords="offset points", ha="center", fontsize=7
                )
        axes.set(xticks=range(len(groups)), xticklabels=names, ylim=(0, 105))
        axes.set_yticks(range(0, 101, 20), [f"{tick}%" for tick in range(0, 101, 20)])
        axes.grid(axis="y", color="#d9d9d9")

    return _draw_chart(title, (11.2, 3.4), draw)


def _curve_chart(
    title: str, curves: Mapping[str, Sequence[tuple[float, float]]], y_label: str, colour: str
) -> Chart:
    """Lines through points over steps, from 0 upwards, whose names are in a legend."""

    def draw(axes: Axes) -> None:
        for number, (name, points) in enumerate(curves.items()):
            x, y = zip(*points, strict=True)
            dashes = _DASHES[number % len(_DASHES)]
            axes.plot(x, y, color=colour, linestyle=dashes, label=name, marker=".", markevery=[0])
        axes.set(xlabel="step", ylabel=y_label)
        axes.set_xlim(left=0)
        axes.set_ylim(bottom=0)
        axes.grid(axis="y", color="#d9d9d9")
        axes.legend(frameon=False, fontsize=7, loc="upper left", bbox_to_anchor=(1, 1))

    return _draw_chart(title, (5.4, 2.6), draw)


def _draw_chart(title: str, size_in: tuple[float, float], draw: Callable[[Axes], None]) -> Chart:
    """An image of axes whose content is drawn by `draw`; the same bytes in every run."""
    from matplotlib import rc_context
    from matplotlib.figure import Figure

    buffer = io.BytesIO()
    style = {"svg.hashsalt": title, "font.size": 9.0, "axes.spines.top": False, "axes.spines.right": False}
    with rc_context(style | {"axes.axisbelow": True}):
        figure = Figure(figsize=size_in, layout="constrained")
        draw(figure.add_subplot())
        figure.savefig(buffer, format="svg", metadata=dict.fromkeys(("Creator", "Date", "Format", "Type")))
    content = base64.b64encode(buffer.getvalue()).decode()
    return Chart(title, f"data:image/svg+xml;base64,{content}")


def _curves(trainings: Sequence[Mapping[str, Any]]) -> list[tuple[str, list[Chart]]]:
    """Loss and validation of the trainings of each experiment."""
    groups = []
    for key in sorted({training["experiment"] for training in trainings}):
        charts = []
        for field, label in (("loss", "loss"), ("mean_iou", "mean IoU of the validation")):
            curves = {}
            for item in trainings:
                points = [(entry["step"], entry[field]) for entry in item["log"] if entry[field] is not None]
                if points and item["experiment"] == key:
                    fold = "" if item["fold"] is None else f" f{item['fold']}"
                    curves[f"s{item['seed']}{fold}"] = points
            if curves:
                title = f"{label} of experiment {key} over steps"
                charts.append(_curve_chart(title, curves, label, _COLOURS[key[0]]))
        groups.append((key, charts))
    return groups


def _image_lines(content: Mapping[str, Any]) -> list[str]:
    lines = []
    for item in content["synthetic"]:
        digest = f"recipe {item['recipe_sha256'][:16]}" if item["recipe_sha256"] else _names(item)
        lines.append(f"synthetic {item['name']}: {item['images']:,} images ({digest}). {_parts(item)}")
    real = content["real"]
    without = f"; {real['unlabelled']:,} without a mask were left out" if real["unlabelled"] else ""
    lines.append(
        f"photographs {real['name']}: {real['images']:,} images ({_names(real)}){without}. {_parts(real)}"
    )
    for number, fold in enumerate(real["folds"], start=1):
        validation = f", {fold['validation']} validate" if fold["validation"] else ""
        lines.append(f"fold {number}: {fold['train']} photographs train{validation}, {fold['test']} test.")
    other = content["other"]
    if other is None:
        lines.append("no unrelated set or model: experiment D was not run.")
    elif other["kind"] == "model":
        lines.append(
            f"unrelated model {other['name']} (sha256 {other['sha256'][:16]}), which keeps its own network."
        )
    else:
        lines.append(f"unrelated set {other['name']}: {other['images']:,} images ({_names(other)}).")
    return lines


def _names(item: Mapping[str, Any]) -> str:
    return f"names {item['names_sha256'][:16]}"


def _parts(item: Mapping[str, Any]) -> str:
    return f"{item['split'][0].upper()}{item['split'][1:]}."


def _training_lines(content: Mapping[str, Any]) -> list[str]:
    options = content["options"]
    training = options["training"]
    same = " (as many as A)" if options["real_steps"] == training["steps"] else ""
    rate = f"learning rate {training['learning_rate']:g}"
    kept = ", ".join(
        f"{name} {training[name]}"
        for name in ("batch", "size", "width", "schedule", "balance", "augmentation", "precision")
    )
    return [
        f"A and B: {training['steps']:,} steps from random weights, {rate}, in all eight classes.",
        f"C: {options['real_steps']:,} steps{same} from random weights, {rate}, in the classes of the table.",
        f"D and E: {options['fine_steps']:,} further steps, learning rate {options['fine_rate']:g}; "
        "the network keeps its classes, and the loss merges them to those of the table.",
        f"All: {training['model']}, {kept}.",
        f"Intervals: {100 * content['interval']['level']:.0f} %, Bayesian bootstrap over images, "
        f"{content['interval']['replicates']} replicates.",
    ]


def _version_lines(content: Mapping[str, Any], times: Mapping[str, float]) -> list[str]:
    versions = ", ".join(f"{name} {version}" for name, version in content["versions"].items())
    trained = sum(seconds for name, seconds in times.items() if "_tests_" not in name)
    tested = sum(seconds for name, seconds in times.items() if "_tests_" in name)
    return [f"{versions}.", f"trainings {trained:,.0f} s, tests {tested:,.0f} s in all."]
