"""Training a network on labelled images; without torch until a training starts."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, Final

import numpy as np
from jinja2 import Environment, PackageLoader, StrictUndefined

from pepperscene.atomic import check_can_create, sole_writer, visible_names, write_error, write_file
from pepperscene.classes import OrganClass
from pepperscene.dataset.readers.image_set import ImageSet
from pepperscene.document import validate
from pepperscene.errors import ArgumentError, InputError, OutputError
from pepperscene.learning.models.trained_model import (
    FORMAT,
    MODEL_FILE,
    ModelDescription,
    TrainedModel,
    load_model,
    read_weights,
    require_torch,
)
from pepperscene.learning.options import MEASURES, TrainingOptions, TrainingProgress, is_built_in
from pepperscene.version import __version__

CARD_FILE: Final = "model_card.md"

_SHOWN_OPTIONS: Final = (
    "model", "steps", "batch", "size", "width", "learning_rate", "schedule", "balance", "lovasz",
    "least_area", "augmentation", "seed", "precision",
)  # fmt: skip


def train(
    sets: ImageSet | Sequence[ImageSet],
    out: str | Path,
    options: TrainingOptions | None = None,
    *,
    validation: ImageSet | Sequence[ImageSet] = (),
    start: TrainedModel | str | Path | None = None,
    match: ImageSet | Sequence[ImageSet] = (),
    resume: bool = False,
    on_progress: Callable[[TrainingProgress], None] | None = None,
) -> TrainedModel:
    """Train a network, and write it into a folder.

    The folder holds `model.safetensors` (the network, after the best validation or else the last step),
    `state.safetensors` (all that a resumption needs), `training.jsonl` (loss and validations) and, at the
    end, `model_card.md` (what the network is for, and how it was made). A training that was killed and is
    resumed ends with the same bytes as one that was not, on the processor of the same machine with the same
    number of threads: crops and dropout depend on the seed and the number of the step alone. On a GPU the
    order of sums varies.

    Args:
        sets: labelled images, of one set or several. A set that occurs twice counts twice.
        out: new or empty folder, or that of the training to resume.
        options: see `TrainingOptions`.
        validation: images by which the best state of the network is chosen; none for the last one.
        start: a trained model to start from. Its model and its classes are kept, so that `options.classes`,
            in which the labels are read, must be the same or mergers of them; None for its classes. If its
            network is none of this package, `options.model` is its factory.
        match: photographs without labels, to whose colours those of the images are brought nearer, as
            `options.matching` says; none to keep them.
        resume: continue the training in the folder, if there is one.
        on_progress: is called after each step.

    Returns:
        The network that was written.

    Raises:
        InputError: sets hold no images, no masks, or no pixel of the classes; an option is not allowed; or
            the folder holds another training.
        OutputError: the folder is not empty, or cannot be written to.
        SetupError: torch is not installed.
    """
    require_torch()
    from pepperscene.learning.training.colour_matching import ColourMatching
    from pepperscene.learning.training.loop import TrainingLoop, class_frequencies, seeded

    chosen, folder = options or TrainingOptions(), Path(out)
    sets, validation, match = _as_tuple(sets), _as_tuple(validation), _as_tuple(match)
    factory = None if is_built_in(chosen.model) else chosen.model
    load = partial(load_model, factory=factory, allow_code=chosen.allow_code)
    origin = load(start) if isinstance(start, str | Path) else start
    if origin is not None:
        # The defaults are those of the model that is adapted.
        chosen = replace(chosen, model=origin.model, classes=chosen.classes or str(origin.classes))
        if chosen.task != origin.task:
            raise ArgumentError("start", f"was trained for the task {origin.task}, not {chosen.task}")
        if chosen.task == "detect" and chosen.table().members != origin.classes.members:
            raise ArgumentError("classes", f"must be those of the detector to start from, {origin.classes}")
    chosen = chosen.completed()
    labels = chosen.table()
    if not sets:
        raise ArgumentError("sets", "must hold at least one set")
    for images in (*sets, *validation):
        if not len(images):
            raise InputError(images.name, "holds no images")
    matching = ColourMatching(match, chosen.matching) if match else None
    record = {
        "options": chosen.as_record(),
        "sets": [describe_images(images) for images in sets],
        "validation": [describe_images(images) for images in validation],
        "start": None if origin is None else _digest_weights(origin),
        "versions": used_versions(),
        **({"match": [describe_images(images) for images in match]} if match else {}),
    }
    check_can_create(folder)
    if validation and chosen.task == "segment":
        # Raises an error if they have no pixel of the classes.
        class_frequencies(validation, labels)
    with sole_writer(folder), seeded(chosen.seed):
        _check_folder(folder, resume, record)
        training = TrainingLoop(chosen, sets, labels, origin, record, matching)
        try:
            training.run(folder, validation, on_progress)
        except OSError as error:
            raise write_error(error, folder) from None
        model = load(folder)
        write_file(folder / CARD_FILE, model_card(model).encode())
    return model


def describe_images(images: ImageSet) -> dict[str, Any]:
    """Name, number of images and digests of a set as JSON values."""
    names = hashlib.sha256("\n".join(images.names()).encode("utf-8", "surrogateescape")).hexdigest()
    info = getattr(getattr(images, "dataset", None), "info", None)
    recipe = info.get("recipe_sha256") if isinstance(info, Mapping) else None
    return {"name": images.name, "images": len(images), "names_sha256": names, "recipe_sha256": recipe}


def _as_tuple(sets: ImageSet | Sequence[ImageSet]) -> tuple[ImageSet, ...]:
    return (sets,) if isinstance(sets, ImageSet) else tuple(sets)


def _check_folder(folder: Path, resume: bool, record: Mapping[str, Any]) -> None:
    """Raise an error unless the folder is empty, or holds this training and is to be resumed."""
    from pepperscene.learning.training.checkpoint import STATE_FILE, check_record

    # A killed training can leave temporary files, which are removed later.
    names = set(visible_names(folder)) - {CARD_FILE}
    if not names:
        return
    if not names & {STATE_FILE, MODEL_FILE}:
        raise OutputError(f"{folder}: is not empty and holds no training; choose another folder")
    if not resume:
        raise OutputError(f"{folder}: holds a training; resume it with --resume, or choose another folder")
    if STATE_FILE not in names:
        # The training was killed at its first checkpoint, or its state was removed. It starts anew.
        file = folder / MODEL_FILE
        training = validate(ModelDescription, read_weights(file, FORMAT)[1], file).training
        results = ("step", *(f"validation_{measure}" for measure in MEASURES.values()))
        check_record(file, {key: training[key] for key in training if key not in results}, record)


def used_versions() -> dict[str, str]:
    """Versions of the packages that decide the result of a training."""
    import torch

    return {"pepperscene": __version__, "torch": str(torch.__version__), "numpy": np.__version__}


def _digest_weights(segmenter: TrainedModel) -> str:
    content = hashlib.sha256(str(segmenter.classes).encode())
    for name, tensor in sorted(segmenter.module.state_dict().items()):
        content.update(name.encode())
        content.update(tensor.cpu().contiguous().numpy().tobytes())
    return content.hexdigest()


def model_card(model: TrainedModel) -> str:
    """What a network is for, how it was made, and what it was measured on, in Markdown.

    Mitchell et al. 2019, "Model cards for model reporting", FAT*.
    """
    environment = Environment(
        loader=PackageLoader("pepperscene.learning"),
        autoescape=False,  # Markdown; names are in code spans
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
        undefined=StrictUndefined,
    )
    environment.filters["code"] = lambda text: f"`{' '.join(str(text).replace('`', '').split())}`"
    record, organs = model.training, [organ.name.lower() for organ in OrganClass]
    classes = [
        (name, ", ".join(organs[class_id] for class_id in sorted(members)))
        for name, members in zip(model.classes.names, model.classes.members, strict=True)
    ]
    options = record["options"]
    return environment.get_template(CARD_FILE).render(
        model=model,
        record=record,
        classes=classes,
        options={name: options[name] for name in _SHOWN_OPTIONS if name in options},
        quality=record.get(f"validation_{MEASURES[model.task]}"),
        is_rendered=all(item["recipe_sha256"] for item in record["sets"]),
        version=__version__,
    )
