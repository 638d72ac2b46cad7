"""Traits of organs from spectral bands: ripeness of fruit, and chlorophyll of leaves."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.classes import OrganClass
from pepperscene.errors import ArgumentError, InputError
from pepperscene.learning.tasks.predictions import PredictionFolder
from pepperscene.learning.tasks.result import Measure, Score, TaskResult
from pepperscene.learning.tasks.trait_regression import REGRESSIONS, Regression, has_bands
from pepperscene.learning.tasks.trait_samples import OrganSamples, organ_means

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class Trait:
    """A trait that is estimated.

    Attributes:
        name: of the output with its map.
        organ: class of the organs that have it.
        organs: what they are called, in the plural.
        unit: of its values; "" for a number from 0 to 1.
        digits: decimals of its errors in a table.
    """

    name: str
    organ: OrganClass
    organs: str
    unit: str
    digits: int


TRAITS: Final[Mapping[str, Trait]] = {
    trait.name: trait
    for trait in (
        Trait("ripeness", OrganClass.PEPPER, "fruit", "", 3),
        Trait("chlorophyll", OrganClass.LEAF, "leaves", "ug/cm2", 2),
    )
}
"""Traits by name."""

PNG_UNIT: Final = 1.0  # predictions as PNG hold whole units


def trait_measures(trait: Trait) -> tuple[Measure, ...]:
    """The measures of a trait's table."""
    unit = f", {trait.unit}" if trait.unit else ""
    return (
        Measure("organs", trait.organs, 0),
        Measure("rmse", f"RMSE{unit}", trait.digits),
        Measure("bias", f"bias{unit}", trait.digits),
        Measure("r2", "R2", 3),
    )


def regression_errors(prediction: FloatArray, truth: FloatArray) -> dict[str, float]:
    """Number of organs, RMSE, bias (mean of prediction minus truth) and R2 by name.

    R2 is 1 minus the squared error over that of the truth's own mean; nan if the truth does not vary.

    Args:
        prediction: `(n,)`, n at least 1.
        truth: `(n,)`.
    """
    error = prediction - truth
    spread = float(((truth - truth.mean()) ** 2).sum())
    squared = float((error**2).sum())
    return {
        "organs": float(len(truth)),
        "rmse": float(np.sqrt(squared / len(truth))),
        "bias": float(error.mean()),
        "r2": 1.0 - squared / spread if spread > 0 else float("nan"),
    }


def score_regressions(
    train: OrganSamples,
    test: OrganSamples,
    bands_nm: FloatArray,
    methods: Mapping[str, Regression] | None = None,
) -> list[Score]:
    """Train methods on the organs of one split, and score them on those of another.

    Args:
        train: organs to learn from.
        test: organs that are scored.
        bands_nm: `(c,)` wavelength of each band.
        methods: by name; None for all `REGRESSIONS` that these bands allow.

    Raises:
        InputError: a split has no organ, or a method needs other bands.
    """
    for split, samples in (("train", train), ("test", test)):
        if not len(samples):
            raise InputError(split, "has no organ that is large enough in its frames")
    used = methods
    if used is None:
        used = {name: method for name, method in REGRESSIONS.items() if has_bands(name, bands_nm)}
    scores = []
    for name, method in used.items():
        predictor = method(train.reflectance, train.trait, bands_nm)
        scores.append(Score(name, "", regression_errors(predictor(test.reflectance), test.trait)))
    return scores


def score_maps(
    folder: PredictionFolder, test: OrganSamples, instances_of: Mapping[int, NDArray[np.uint16]]
) -> Score:
    """Score predicted maps: the mean over each organ's pixels against its trait.

    Args:
        folder: with a map `(h, w)` for each frame of the test, in the trait's unit.
        test: organs that are scored.
        instances_of: by frame, the number of the organ at each pixel `(h, w)`.

    Raises:
        InputError: a map is missing or not as it must be.
    """
    predicted = np.empty(len(test))
    for frame in np.unique(test.frame).tolist():
        rows = np.flatnonzero(test.frame == frame)
        instances = instances_of[frame]
        used = np.isin(instances, test.instance[rows])
        numbers, means = organ_means(folder.read_map(frame, used, png_unit=PNG_UNIT), instances, used)
        predicted[rows] = means[np.searchsorted(numbers, test.instance[rows])]
    return Score(folder.name, "", regression_errors(predicted, test.trait))


def trait_of(name: str) -> Trait:
    """A trait by its name; raises `ArgumentError` if there is none."""
    if name not in TRAITS:
        raise ArgumentError("trait", f"must be {' or '.join(TRAITS)}, not {name!r}")
    return TRAITS[name]


def trait_result(
    trait: Trait, title: str, scores: Sequence[Score], notes: tuple[str, ...] = ()
) -> TaskResult:
    """The table of a trait."""
    return TaskResult(trait.name, title, trait_measures(trait), tuple(scores), notes=notes)


def open_prediction_folders(paths: Sequence[str | Path]) -> list[PredictionFolder]:
    """Folders of predictions, whose names differ."""
    folders = [PredictionFolder(Path(path)) for path in paths]
    names = [folder.name for folder in folders]
    if len(set(names)) < len(names):
        raise ArgumentError("predictions", f"must have names of their own, not {', '.join(names)}")
    return folders
