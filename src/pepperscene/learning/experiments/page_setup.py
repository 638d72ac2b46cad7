"""The last section of the page: sets, options, versions and times."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from pepperscene.review.report.markup import Html, element


def used_section(content: Mapping[str, Any], times: Mapping[str, float]) -> Html:
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
