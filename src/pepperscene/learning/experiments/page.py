"""The page of the experiments: tables, charts, pictures and what was used; it needs no other file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np

from pepperscene.learning.class_table import ClassTable
from pepperscene.learning.experiments.charts import (
    COLOURS,
    Bar,
    TrainingCurve,
    bar_chart,
    curve_chart,
)
from pepperscene.learning.experiments.pictures import PictureRow
from pepperscene.learning.experiments.schedule import MERGED
from pepperscene.learning.page_parts import class_legend, data_table, legend, page_document, picture_row
from pepperscene.review.report.colours import jpeg_data_uri, png_data_uri
from pepperscene.review.report.markup import Html, element, fragment

_TITLE: Final = "Training on synthetic images, tested on photographs"


def experiments_page(
    content: Mapping[str, Any], pictures: Sequence[PictureRow], times: Mapping[str, float]
) -> Html:
    """The page of a result of `run_experiments`.

    Args:
        content: of `experiments.json`.
        pictures: photographs with predictions.
        times: seconds of each training and test.
    """
    return page_document(
        _TITLE,
        _introduction(content),
        _result_section(content),
        _difference_section(content),
        _organ_section(content),
        _picture_section(content, pictures),
        _curve_section(content),
        _used_section(content, times),
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


def _introduction(content: Mapping[str, Any]) -> Html:
    options, real = content["options"], content["real"]
    seeds = options["seeds"]
    networks = "one network" if seeds == 1 else f"{seeds} networks with different seeds"
    folds = len(real["folds"])
    trained = f"{networks} ({options['training']['model']}) of each kind"
    photographs = f"{real['images']:,} photographs ({real['name']}) in {folds} fold{'s' * (folds > 1)}"
    text = (
        f"The experiments of Barth et al. 2018 (section 2.8) with {trained}. {photographs}; "
        "no network was tested on a photograph that trained it, and none was chosen by test images."
    )
    return element("p", text)


def _main_results(content: Mapping[str, Any]) -> list[tuple[str, Mapping[str, Any]]]:
    """Letter and result of A to E in common classes."""
    by_key = {item["key"]: item for item in content["experiments"]}
    return [(key, by_key[MERGED] if key == "A" and MERGED in by_key else by_key[key]) for key in "ABCDE"]


def _result_section(content: Mapping[str, Any]) -> Html:
    results = _main_results(content)
    ran = [(key, item) for key, item in results if item["ran"]]
    names = [measure["name"] for measure in ran[0][1]["measures"]]
    rows = [_result_row(key, item, len(names)) for key, item in results]
    groups = [
        (
            name,
            [
                Bar(key, *(item["measures"][at][part] for part in ("value", "low", "high")))
                for key, item in ran
            ],
        )
        for at, name in enumerate(names)
    ]
    note = (
        "IoU in %, [95 % interval over images] ± standard deviation over seeds. Confusion matrices of all "
        "images, seeds and folds are added. A class that is neither in the masks nor predicted has no IoU "
        "(-) and is not in the mean."
    )
    missing = [f"{key} was not run: {item['why']}." for key, item in results if not item["ran"]]
    return element(
        "section",
        element("h2", "IoU by experiment and class"),
        element("p", f"Classes: {content['classes'].replace(',', ', ')}."),
        data_table("IoU by experiment", ("experiment", "images", *names), rows),
        element("p", note),
        *(element("p", text) for text in missing),
        bar_chart("IoU by class and experiment, in percent", groups),
        legend([(COLOURS[key], f"{key}: {_short(item['title'])}") for key, item in ran]),
    )


def _short(title: str) -> str:
    return title.removesuffix(", in the classes of photographs")


def _result_row(key: str, item: Mapping[str, Any], columns: int) -> list[str]:
    name = f"{key}: {_short(item['title'])}"
    if not item["ran"]:
        return [name, "not run", *[""] * columns]
    return [name, f"{item['images']:,}", *map(format_measure, item["measures"])]


def _difference_section(content: Mapping[str, Any]) -> Html:
    lines = []
    for item in content["differences"]:
        mean = item["measures"][-1]
        parts = ", ".join(
            f"{measure['name']} {format_measure(measure, signed=True)}" for measure in item["measures"][:-1]
        )
        heading = f"{item['first']} above {item['second']} by {format_measure(mean, signed=True)}"
        lines.append(element("li", element("strong", heading), f" of mean IoU; {parts}"))
    note = "Percentage points with 95 % intervals of paired differences over the same images."
    return element("section", element("h2", "Differences"), element("ul", *lines), element("p", note))


def _organ_section(content: Mapping[str, Any]) -> Html:
    """Experiment A in its own classes, where the others have fewer."""
    results = {item["key"]: item for item in content["experiments"]}
    if MERGED not in results:
        return fragment()
    rows = [
        [measure["name"], *format_measure(measure).partition(" ± ")[::2]]
        for measure in results["A"]["measures"]
    ]
    heads = ("class", "IoU, % [95 %]", "sd over seeds")
    title = "Experiment A in all eight classes"
    return element("section", element("h2", title), data_table(title, heads, rows))


def _picture_section(content: Mapping[str, Any], pictures: Sequence[PictureRow]) -> Html:
    classes = ClassTable.parse(content["classes"])
    parts = [class_legend(classes, np.arange(len(classes), dtype=np.uint8))]
    for row in pictures:
        panels = [
            ("photograph", jpeg_data_uri(row.photo)),
            *((name, png_data_uri(image)) for name, image in row.panels),
        ]
        heading = f"{row.word.capitalize()} of B: {row.name}, mean IoU {100 * row.mean_iou:.1f} %"
        parts.append(element("h3", heading))
        parts.append(picture_row(panels, row.name, (row.photo.shape[0], row.photo.shape[1])))
    title = "Photographs and predictions of the networks of seed 1"
    return element("section", element("h2", title), *parts)


def _curve_section(content: Mapping[str, Any]) -> Html:
    parts: list[Html] = []
    keys = dict.fromkeys(training["experiment"] for training in content["trainings"])
    for key in sorted(keys):
        trainings = [item for item in content["trainings"] if item["experiment"] == key]
        charts = []
        for field, label in (("loss", "loss"), ("mean_iou", "mean IoU of the validation")):
            curves = [_curve(item, field) for item in trainings]
            present = [curve for curve in curves if curve.x]
            if present:
                title = f"{label} of experiment {key} over steps"
                charts.append(curve_chart(title, present, label, COLOURS[key[0]]))
        parts += [element("h3", f"Experiment {key}"), element("div", *charts, class_="pair")]
    note = (
        "s: seed, f: fold. The network of A is the state with the highest mean IoU on its synthetic "
        "validation images. Trainings without validation images use their last state."
    )
    return element("section", element("h2", "Trainings"), element("p", note), *parts)


def _curve(training: Mapping[str, Any], field: str) -> TrainingCurve:
    fold = "" if training["fold"] is None else f" f{training['fold']}"
    points = [(entry["step"], entry[field]) for entry in training["log"] if entry[field] is not None]
    name = f"s{training['seed']}{fold}"
    return TrainingCurve(name, tuple(x for x, _ in points), tuple(y for _, y in points))


def _used_section(content: Mapping[str, Any], times: Mapping[str, float]) -> Html:
    """What the experiments used, and how long they took."""
    return element(
        "section",
        element("h2", "What was used"),
        element("h3", "Images"),
        _list(_image_lines(content)),
        element("h3", "Training"),
        _list(_training_lines(content)),
        element("h3", "Versions and times"),
        _list(_version_lines(content, times)),
    )


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


def _list(lines: Sequence[str]) -> Html:
    return element("ul", *(element("li", line) for line in lines))
