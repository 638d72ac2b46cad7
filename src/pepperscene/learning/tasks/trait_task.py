"""Traits of organs from spectral bands: ripeness of fruit, and chlorophyll of leaves."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.classes import OrganClass
from pepperscene.dataset.store.fields import read_frame
from pepperscene.errors import ArgumentError, InputError
from pepperscene.learning.tasks.frames import TEST, TRAIN, PredictionFolder, TaskFrames, open_task_frames
from pepperscene.learning.tasks.result import Score, TaskMeasure, TaskResult
from pepperscene.learning.tasks.trait_regression import REGRESSIONS, Regression, has_bands

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

BAND_INPUTS: Final = ("reflectance", "instance", "class")
"""Outputs that the frames of a data set must have, besides the trait's."""

SMALLEST_PX: Final = 50
"""Least pixels of an organ. Chosen: at fewer, its rim, where pixels show what is behind it, is half of it."""


@dataclass(frozen=True, eq=False)
class OrganSamples:
    """Visible organs of frames.

    Attributes:
        reflectance: `(n, c)` mean of its pixels in each band, 0 to 1.
        trait: `(n,)` mean of its pixels, in the trait's unit.
        frame: `(n,)` index of the frame.
        instance: `(n,)` number of the organ in the frame.
    """

    reflectance: FloatArray
    trait: FloatArray
    frame: NDArray[np.int64]
    instance: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.trait)


def organ_samples(
    frame: int,
    reflectance: NDArray[Any],
    trait: NDArray[Any],
    instances: NDArray[np.integer[Any]],
    counted: NDArray[np.bool_],
    smallest_px: int = SMALLEST_PX,
) -> OrganSamples:
    """The organs of one frame.

    Args:
        frame: its index.
        reflectance: `(h, w, c)`; pixels where a band is not finite do not count.
        trait: `(h, w)`; pixels where it is not finite do not count.
        instances: `(h, w)` number of the organ at each pixel, 0 for none.
        counted: `(h, w)` pixels of the class of organs that has the trait.
        smallest_px: least pixels of an organ.
    """
    used = counted & (instances > 0) & np.isfinite(trait) & np.isfinite(reflectance).all(axis=-1)
    numbers, place, pixels = np.unique(instances[used], return_inverse=True, return_counts=True)
    bands = reflectance[used].astype(np.float64)
    sums = [
        np.bincount(place, weights=bands[:, band], minlength=len(numbers)) for band in range(bands.shape[1])
    ]
    kept = pixels >= smallest_px
    return OrganSamples(
        (np.stack(sums, axis=-1) / np.maximum(pixels, 1)[:, None])[kept],
        organ_means(trait, instances, used)[1][kept],
        np.full(int(kept.sum()), frame, np.int64),
        numbers[kept].astype(np.int64),
    )


def organ_means(
    values: NDArray[Any], instances: NDArray[np.integer[Any]], used: NDArray[np.bool_]
) -> tuple[NDArray[np.int64], FloatArray]:
    """Numbers `(n,)` of the organs of some pixels, ascending, and the mean `(n,)` of a map over each."""
    numbers, place, pixels = np.unique(instances[used], return_inverse=True, return_counts=True)
    sums = np.bincount(place, weights=values[used].astype(np.float64), minlength=len(numbers))
    return numbers.astype(np.int64), sums / np.maximum(pixels, 1)


def join_samples(parts: Sequence[OrganSamples]) -> OrganSamples:
    """The organs of several frames; at least one."""
    names = ("reflectance", "trait", "frame", "instance")
    return OrganSamples(*(np.concatenate([getattr(part, name) for part in parts]) for name in names))


def trait_measures(trait: Trait) -> tuple[TaskMeasure, ...]:
    """The measures of a trait's table."""
    unit = f", {trait.unit}" if trait.unit else ""
    return (
        TaskMeasure("organs", trait.organs, 0),
        TaskMeasure("rmse", f"RMSE{unit}", trait.digits),
        TaskMeasure("bias", f"bias{unit}", trait.digits),
        TaskMeasure("r2", "R2", 3),
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
        numbers, means = organ_means(folder.read_map(frame, used), instances, used)
        predicted[rows] = means[np.searchsorted(numbers, test.instance[rows])]
    return Score(folder.name, "", regression_errors(predicted, test.trait))


def evaluate_trait(
    trait: str,
    folder: str | Path,
    methods: Mapping[str, Regression] | None = None,
    predictions: Sequence[str | Path] = (),
    *,
    split: str | None = None,
    smallest_px: int = SMALLEST_PX,
    on_progress: Callable[[int, int], None] | None = None,
) -> TaskResult:
    """Score regressions of a trait on bands, and folders of predicted maps, on the organs of the test.

    Args:
        trait: "ripeness" of fruit or "chlorophyll" of leaves.
        folder: a data set of a sensor with bands, with the outputs `reflectance`, `instance`, `class` and the
            trait's.
        methods: by name; None for all `REGRESSIONS` that the bands allow, unless there are predictions.
        predictions: folders with a map of the trait for each frame of the test, as `.npy` or `.exr`.
        split: as for an export, see `open_task_frames`.
        smallest_px: least pixels of an organ.
        on_progress: called after each frame with the number done and of all.

    Raises:
        InputError: the data set or a prediction is not as it must be.
    """
    if trait not in TRAITS:
        raise ArgumentError("trait", f"must be {' or '.join(TRAITS)}, not {trait!r}")
    kind = TRAITS[trait]
    folders = [PredictionFolder(Path(path)) for path in predictions]
    names = [one.name for one in folders]
    if len(set(names)) < len(names):
        raise ArgumentError("predictions", f"must have names of their own, not {', '.join(names)}")
    frames = open_task_frames(folder, (*BAND_INPUTS, kind.name), split)
    used = {} if methods is None and folders else methods
    bands_nm = _bands(frames.test)
    parts = [frames.train, frames.test] if used is None or used else [frames.test]
    total, done = sum(map(len, parts)), 0
    samples = {}
    for part in parts:
        found = []
        for index in part.indices:
            found.append(_frame_samples(part, index, kind, bands_nm, smallest_px))
            done += 1
            if on_progress is not None:
                on_progress(done, total)
        if not sum(map(len, found)):
            raise InputError(part.dataset.folder, f"has no {kind.organs} in its {part.split} frames")
        samples[part.split] = join_samples(found)
    test = samples[TEST]
    scores = score_regressions(samples[TRAIN], test, bands_nm, used) if len(parts) > 1 else []
    if folders:
        instances = {int(index): frames.test.read(int(index), "instance") for index in np.unique(test.frame)}
        scores += [score_maps(one, test, instances) for one in folders]
    learned = f", learned from {len(samples[TRAIN]):,}" if len(parts) > 1 else ""
    title = f"{trait.capitalize()} of {kind.organs} from {len(bands_nm)} bands: {frames.title}{learned}"
    note = f"{kind.organs} of {smallest_px} pixels or more"
    return TaskResult(kind.name, title, trait_measures(kind), tuple(scores), notes=(note, *frames.notes))


def _bands(frames: TaskFrames) -> FloatArray:
    """Centres of the sensor's bands `(c,)` in nm, from the JSON of the first frame."""
    index = frames.indices[0]
    bands = read_frame(frames.dataset, index)["camera"].get("bands")
    if not bands:
        raise InputError(
            frames.dataset.frame_path(index), "must be of a sensor with bands", key="camera.bands"
        )
    return np.array([band["centre_nm"] for band in bands], float)


def _frame_samples(
    frames: TaskFrames, index: int, trait: Trait, bands_nm: FloatArray, smallest_px: int
) -> OrganSamples:
    """The organs of one frame."""
    reflectance, instances, classes, values = (
        frames.read(index, name) for name in (*BAND_INPUTS, trait.name)
    )
    path = frames.dataset.path(index, "reflectance")
    if reflectance.shape[2] != len(bands_nm):
        raise InputError(
            path, f"must have {len(bands_nm)} bands, as the first frame, not {reflectance.shape[2]}"
        )
    if not reflectance.shape[:2] == instances.shape == classes.shape == values.shape:
        raise InputError(path, "differs in size from the labels of its frame")
    if np.isnan(reflectance).any():
        raise InputError(path, "must have a reflectance in every band; it is nan where light is too weak")
    return organ_samples(index, reflectance, values, instances, classes == trait.organ, smallest_px)
