"""Evaluation of a model on labelled images."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Final, Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt, label

from pepperscene.classes import IGNORE_CLASS, OrganClass
from pepperscene.colour.comparison.bootstrap import bootstrap_weights
from pepperscene.dataset.readers.image_set import ImageSet, LabelledImage
from pepperscene.errors import ArgumentError, InputError
from pepperscene.learning.class_table import ClassTable
from pepperscene.learning.evaluation.evaluation import EvaluatedImage, EvaluatedSet, Evaluation
from pepperscene.learning.evaluation.measures import (
    confusion_matrix,
    count_objects,
    measure_classes,
    measure_objects,
)
from pepperscene.learning.models.decision import estimate_shares
from pepperscene.learning.models.trained_model import TrainedModel
from pepperscene.review.report.data import evenly_spaced

OnProgress = Callable[[int, int], None]
"""Called after each image with the number of images done and of all."""

_SAMPLED: Final = 4  # chosen: pixels between samples, whose classes are mostly the same


class Segmenter(Protocol):
    """A model that gives each pixel of an image the probabilities of its classes."""

    @property
    def classes(self) -> ClassTable:
        """Its classes, in the order of the probabilities."""

    def probabilities(self, colour: NDArray[np.uint8]) -> NDArray[np.float32]:
        """Probabilities `(k, h, w)` of the classes, from an sRGB image `(h, w, 3)`."""


def predict_classes(
    model: Segmenter, colour: NDArray[np.uint8], merging: NDArray[np.float32] | None = None
) -> NDArray[np.uint8]:
    """The most probable class of each pixel after the factors of the decision; of equal ones, the first.

    A trained network is applied to an image above 12.5 million pixels in tiles of 2048 x 2048, each with 640
    pixels around it, which is farther than the networks of this package see.

    Args:
        model: the model.
        colour: sRGB `(h, w, 3)`.
        merging: matrix `(n, k)` that adds probabilities of the model's k classes (`ClassTable.merging`); a
            class of the model without a row is left out. None for the model's own classes.

    Returns:
        `(h, w)` indices of the merged classes.

    Raises:
        InputError: the model's probabilities have another shape, or are not finite.
    """
    classes = np.empty(colour.shape[:2], np.uint8)
    decision = model.decision if isinstance(model, TrainedModel) else None
    least_area, grown_px = (0, 0) if decision is None else (decision.least_area, decision.grown_px)
    is_object = _object_classes(model.classes, merging)
    others = np.zeros_like(classes)
    for (rows, columns), probabilities in _probability_parts(model, colour):
        expected = (len(model.classes), *classes[rows, columns].shape)
        if probabilities.shape != expected:
            problem = f"gives probabilities of the shape {probabilities.shape}, not {expected}"
            raise InputError("model", problem)
        if not np.isfinite(probabilities).all():
            raise InputError("model", "gives probabilities that are not finite numbers")
        if decision is not None:
            probabilities = probabilities * np.array(decision.factors, np.float32)[:, None, None]
        if merging is not None:
            probabilities = np.tensordot(merging, probabilities, axes=1)
        classes[rows, columns] = probabilities.argmax(axis=0)
        if least_area:
            others[rows, columns] = np.where(is_object[:, None, None], 0, probabilities).argmax(axis=0)
    if least_area:
        regions, _ = label(is_object[classes])
        small = np.bincount(regions.ravel()) < least_area
        # Region 0 is what belongs to no object.
        small[0] = False
        np.copyto(classes, others, where=small[regions])
    if grown_px:
        _grow(classes, is_object, grown_px)
    return classes


def _grow(classes: NDArray[np.uint8], is_object: NDArray[np.bool_], pixels: int) -> None:
    """Give pixels within a distance of a region of fruit or peduncles the class of its nearest pixel."""
    outside = ~is_object[classes]
    # Without a region, there is no nearest pixel.
    if not outside.all():
        distance, nearest = distance_transform_edt(outside, return_indices=True)
        np.copyto(classes, classes[tuple(nearest)], where=distance <= pixels)


def _object_classes(table: ClassTable, merging: NDArray[np.float32] | None) -> NDArray[np.bool_]:
    """Whether each merged class consists of fruit or peduncles only; no class if there is no other one."""
    objects = {int(OrganClass.PEPPER), int(OrganClass.PEDUNCLE)}
    found = np.array([ids <= objects for ids in table.members])
    if merging is not None:
        found = (merging @ ~found) == 0
    return np.asarray(found & ~found.all())


def _probability_parts(
    model: Segmenter, colour: NDArray[np.uint8]
) -> Iterator[tuple[tuple[slice, slice], NDArray[np.float32]]]:
    """Rows and columns of the parts of an image, and the probabilities there; most images are one part."""
    if isinstance(model, TrainedModel):
        from pepperscene.learning.models.large_images import is_large, probability_parts

        if is_large(colour, model.width):
            model.module.eval()
            yield from probability_parts(model, colour)
            return
    yield (slice(0, colour.shape[0]), slice(0, colour.shape[1])), model.probabilities(colour)


def sampled_probabilities(
    model: Segmenter, colour: NDArray[np.uint8]
) -> Iterator[tuple[tuple[slice, slice], NDArray[np.float32]]]:
    """Rows and columns of every fourth pixel of the parts of an image, and the probabilities there."""
    for (rows, columns), probabilities in _probability_parts(model, colour):
        part = slice(rows.start, rows.stop, _SAMPLED), slice(columns.start, columns.stop, _SAMPLED)
        yield part, probabilities[:, ::_SAMPLED, ::_SAMPLED]


def with_shares(
    model: TrainedModel, shares: Mapping[str, float] | Sequence[ImageSet], classes: ClassTable | None = None
) -> TrainedModel:
    """The model for images in which the classes have other shares than in those of its training.

    Args:
        model: a trained model.
        shares: of classes in the pixels, by name; the classes that are not named share the rest in their
            proportions. Or sets of unlabelled images, from which the shares are estimated by expectation and
            maximisation (Saerens et al. 2002).
        classes: of the shares, to which the model's are merged; None for the model's.

    Raises:
        ArgumentError: a name is unknown, a share is not between 0 and 1, or their sum is above 1.
        InputError: an image has no colours, or the model does not know the frequencies of its classes.
    """
    table = model.classes if classes is None else classes
    merging = table.merging(model.classes)
    if model.decision is None:
        raise InputError("model", "does not know the shares of its classes in the training; train it again")
    # Shares of an earlier call do not count: the estimate starts from those of the training.
    model = replace(model, decision=replace(model.decision, shares=None))
    assert model.decision is not None
    frequencies = merging @ np.array(model.decision.frequencies)
    if isinstance(shares, Mapping):
        wanted = _named_shares(shares, table, frequencies)
    else:
        sampled = [
            np.tensordot(merging, probabilities, axes=1).reshape(len(table), -1)
            for images in shares
            for image in images.select("colour")
            for _, probabilities in sampled_probabilities(model, colour_of(image))
        ]
        wanted = estimate_shares(np.concatenate(sampled, axis=1).T, frequencies)
    return replace(model, decision=model.decision.for_shares(wanted, merging))


def _named_shares(
    shares: Mapping[str, float], table: ClassTable, frequencies: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Shares of all classes `(k,)` from those that are named."""
    unknown = [name for name in shares if name not in table.names]
    if unknown:
        raise ArgumentError("prior", f"{unknown[0]} is none of the classes {', '.join(table.names)}")
    named = np.array([shares.get(name, np.nan) for name in table.names])
    is_named = np.isfinite(named)
    total = float(named[is_named].sum())
    if not (named[is_named] > 0).all() or total > 1 or (is_named.all() and not np.isclose(total, 1)):
        raise ArgumentError(
            "prior", "shares must be above 0, and sum to 1, or to less if classes are left out"
        )
    rest = frequencies[~is_named]
    named[~is_named] = (1 - total) * rest / max(rest.sum(), np.finfo(float).tiny)
    return named


def evaluate(
    model: Segmenter,
    sets: ImageSet | Sequence[ImageSet],
    *,
    classes: ClassTable | None = None,
    limit: int | None = None,
    on_progress: OnProgress | None = None,
) -> Evaluation:
    """Compare a model's predictions with the masks of images.

    All pixels of all sets are counted in one confusion matrix, of which the IoU is computed. Images without a
    mask are left out and counted. Intervals are those of the Bayesian bootstrap over images.

    Args:
        model: a trained model.
        sets: one or more sets of images.
        classes: to evaluate, to which the model's are merged; None for the model's. A class of the model
            that belongs to none of them is never predicted, and its pixels in the masks are ignored.
        limit: most images of each set, evenly spaced; None for all.
        on_progress: called after each image.

    Raises:
        InputError: a set is empty, has no masks, an image without colours, or no pixel of any of the classes;
            or the model's classes cannot be merged to `classes`.
    """
    sets = (sets,) if isinstance(sets, ImageSet) else tuple(sets)
    table = model.classes if classes is None else classes
    merging = None if classes is None else classes.merging(model.classes)
    fruit = fruit_class(table)
    images: list[EvaluatedImage] = []
    weights = []

    def compare(number: int, position: int, image: LabelledImage) -> None:
        truth, prediction = label_image(model, table, merging, image)
        matrix, objects = confusion_matrix(truth, prediction, len(table)), None
        if fruit is not None:
            void = truth == IGNORE_CLASS
            objects = count_objects(truth == fruit, prediction == fruit, void, image.instances)
        images.append(EvaluatedImage(number, position, image.name, matrix, objects))
        weights.append(image_weights(image))

    def check_labels(number: int) -> None:
        if not any(image.matrix.any() for image in images if image.set_number == number):
            names = ", ".join(table.names)
            raise InputError(sets[number].name, f"has no labelled pixel of any of the classes {names}")

    summaries = for_each_image(sets, limit, on_progress, compare, check_labels)
    measures = measure_classes([image.matrix for image in images], weights)
    objects = [image.objects for image in images if image.objects is not None]
    fruits = measure_objects(objects, weights) if objects else None
    return Evaluation(table, summaries, tuple(images), measures, fruit, fruits)


def fruit_class(classes: ClassTable) -> int | None:
    """Index of the class whose regions are fruit: the one that holds `pepper` and nothing else.

    In a class that holds other organs too, the regions are not fruit.
    """
    fruit = frozenset({int(OrganClass.PEPPER)})
    return classes.members.index(fruit) if fruit in classes.members else None


def for_each_image(
    sets: Sequence[ImageSet],
    limit: int | None,
    on_progress: OnProgress | None,
    evaluate_image: Callable[[int, int, LabelledImage], None],
    end_set: Callable[[int], None] = lambda _number: None,
) -> tuple[EvaluatedSet, ...]:
    """Call a function with each image that has a mask, the number of its set and its position there.

    Args:
        sets: whose images are read, only with what evaluation needs.
        limit: most images of each set, evenly spaced; None for all.
        on_progress: called after each image.
        evaluate_image: the function.
        end_set: called with the number of each set after its images.

    Raises:
        ArgumentError: there is no set, or the limit is below 1.
        InputError: a set is empty, or has no masks.
    """
    if not sets:
        raise ArgumentError("sets", "must hold at least one set of images")
    if limit is not None and limit < 1:
        raise ArgumentError("limit", f"must be at least 1, not {limit}")
    for images in sets:
        if not len(images):
            raise InputError(images.name, "holds no images")
    positions = [evenly_spaced(len(item), len(item) if limit is None else limit) for item in sets]
    total, done, summaries = sum(map(len, positions)), 0, []
    for number, (images, chosen) in enumerate(zip(sets, positions, strict=True)):
        selected, evaluated = images.select("colour", "classes", "instances"), 0
        for position in chosen:
            image = selected[position]
            if image.classes is not None:
                evaluate_image(number, position, image)
                evaluated += 1
            done += 1
            if on_progress is not None:
                on_progress(done, total)
        if not evaluated:
            raise InputError(images.name, "holds no image with a mask")
        end_set(number)
        summaries.append(EvaluatedSet(images.name, len(images), evaluated, len(chosen) - evaluated))
    return tuple(summaries)


def image_weights(image: LabelledImage) -> NDArray[np.float64]:
    """Weights of an image in the bootstrap."""
    return bootstrap_weights(np.ascontiguousarray(colour_of(image)).tobytes())


def label_image(
    model: Segmenter, table: ClassTable, merging: NDArray[np.float32] | None, image: LabelledImage
) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    """Truth and prediction of an image that has a mask, `(h, w)` indices of `table`.

    Raises:
        InputError: the image has no colours.
    """
    assert image.classes is not None
    return table.indices(image.classes), predict_classes(model, colour_of(image), merging)


def colour_of(image: LabelledImage) -> NDArray[np.uint8]:
    """Colours of an image; raises `InputError` if it has none."""
    if image.colour is None:
        raise InputError(image.name, "has no colours, from which a model predicts")
    return image.colour
