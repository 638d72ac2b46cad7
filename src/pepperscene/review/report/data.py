"""Data of a report: which images are shown, statistics of a sample of them, and the records of all frames."""

from __future__ import annotations

import json
import os
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, Final, Self, final

import numpy as np
from numpy.typing import NDArray

from pepperscene.classes import OrganClass
from pepperscene.dataset.readers import RenderedSet
from pepperscene.dataset.readers.image_set import ImageSet, LabelledImage
from pepperscene.dataset.store.dataset import Dataset
from pepperscene.dataset.store.fields import read_frame
from pepperscene.dataset.store.journal import JOURNAL
from pepperscene.dataset.store.manifest import (
    DRAWN,
    MANIFEST,
    frame_row,
    stored_row,
    table_columns,
    table_schema,
)
from pepperscene.errors import OutputError
from pepperscene.recipe.camera_tables import FIRST_CAMERA
from pepperscene.recipe.plan import Plan, moments
from pepperscene.recipe.variation.recorded import as_number, read_variation, recorded_twins
from pepperscene.recipe.variation.varied import Varied, VariedNumber
from pepperscene.review.report.image_view import Card
from pepperscene.truth import ImageStatistics

_READERS: Final = min(4, os.cpu_count() or 1)
"""Chosen: more threads would only wait for the one that measures."""

OnProgress = Callable[[int, int], None]
"""Called with the number of measured images and that of all images to measure."""


def evenly_spaced(count: int, limit: int) -> list[int]:
    """At most `limit` of `count` positions, evenly spaced from the first to the last."""
    if count <= limit:
        return list(range(count))
    return [int(position) for position in np.linspace(0, count - 1, max(limit, 1)).round()]


def image_statistics(images: ImageSet, sample: int, on_progress: OnProgress | None = None) -> ImageStatistics:
    """Statistics of photographs and classes, of at most `sample` evenly spaced images of a set."""
    positions = evenly_spaced(len(images), sample)
    statistics = ImageStatistics()
    for image in read_ahead(images.select("colour", "classes"), positions):
        statistics.add(image.colour, image.classes)
        if on_progress is not None:
            on_progress(statistics.image_count, len(positions))
    return statistics


def distance_range(images: ImageSet, positions: Sequence[int]) -> tuple[float, float] | None:
    """The 1st and 99th percentile of all distances of some images, metres; None without distances."""
    samples = []
    for image in read_ahead(images.select("distance_m"), positions):
        if image.distance_m is not None:
            distance = image.distance_m[::8, ::8]
            samples.append(distance[np.isfinite(distance)])
    distances = np.concatenate(samples) if samples else np.empty(0)
    if distances.size == 0:
        return None
    near, far = np.percentile(distances, (1, 99))
    return float(near), float(max(far, near + 0.01))


def read_ahead(images: ImageSet, positions: Sequence[int]) -> Iterator[LabelledImage]:
    """The images at these positions, in order, read by threads; few are in memory at a time."""
    with ThreadPoolExecutor(_READERS) as pool:
        pending: deque[Future[LabelledImage]] = deque()
        try:
            for position in positions:
                pending.append(pool.submit(images.__getitem__, position))
                if len(pending) > 2 * _READERS:
                    yield pending.popleft().result()
            while pending:
                yield pending.popleft().result()
        finally:
            for future in pending:
                future.cancel()


NUMBERS: Final = ("render_s", "write_s", "error_codes", "noise_codes", "samples_per_pixel", "bytes")
"""Columns of the manifest that the page shows."""

_PIXELS: Final = tuple(f"pixels_{organ.name.lower()}" for organ in OrganClass)


@dataclass(frozen=True, eq=False)
class DrawnRecords:
    """Drawn values of all n frames of a data set."""

    plan: Plan
    indices: NDArray[np.int64]  # (n,), ascending
    variation: tuple[Varied, ...]  # without those that twins replace
    numbers: Mapping[str, NDArray[np.float64]]  # (n,) for each of `variation`; see `as_number`
    twins: Mapping[str, Sequence[Any]]  # values by dotted key


@dataclass(frozen=True, eq=False)
class FrameRecords:
    """Numbers of all n frames of a data set."""

    indices: NDArray[np.int64]  # (n,), ascending
    numbers: Mapping[str, NDArray[np.float64]]  # (n,) for each of `NUMBERS`; nan if unknown
    pixels: NDArray[np.float64]  # (n, 8), of each class; nan for frames without labels
    workers: frozenset[str]  # that rendered the frames, as far as they are known
    drawn: DrawnRecords | None = None  # None if nothing is drawn

    def known(self, name: str) -> NDArray[np.bool_]:
        """`(n,)`, where a number is known."""
        return np.isfinite(self.numbers[name])

    def labelled(self) -> NDArray[np.float64]:
        """`pixels` of the frames that have labels."""
        return self.pixels[np.isfinite(self.pixels).all(axis=1)]


def frame_records(dataset: Dataset) -> FrameRecords:
    """The numbers of all frames, from the manifest, or from the frame's JSON if the manifest lacks it."""
    indices = dataset.indices()
    plan, variation, twins = _recorded_variation(dataset)
    columns = [f"{DRAWN}{varied.name}" for varied in variation]
    rows = _manifest_rows(dataset, columns)
    table = np.full((len(indices), len(NUMBERS) + len(_PIXELS)), np.nan)
    drawn = np.full((len(indices), len(variation)), np.nan)
    stored_columns, workers = table_columns(MANIFEST, dataset.info), set()
    for position, index in enumerate(indices):
        if (row := rows.get(index)) is None:
            metadata = read_frame(dataset, index)
            row = stored_row(frame_row(metadata), stored_columns)
        values = (row.get(name) for name in (*NUMBERS, *_PIXELS))
        table[position] = [np.nan if value is None else value for value in values]
        pairs = zip(variation, columns, strict=True)
        drawn[position] = [_drawn_number(varied, row.get(name)) for varied, name in pairs]
        if row.get("worker"):
            workers.add(str(row["worker"]))
    numbers = {name: table[:, column] for column, name in enumerate(NUMBERS)}
    frames, records = np.array(indices, np.int64), None
    if plan is not None and (variation or twins):
        inside = frames < plan.count
        draws = {varied.name: drawn[inside, column] for column, varied in enumerate(variation)}
        records = DrawnRecords(plan, frames[inside], variation, draws, twins)
    return FrameRecords(frames, numbers, table[:, len(NUMBERS) :], frozenset(workers), records)


def _recorded_variation(
    dataset: Dataset,
) -> tuple[Plan | None, tuple[Varied, ...], Mapping[str, Sequence[Any]]]:
    """The plan of a data set, its varied values except those that its twins replace, and its twins."""
    with suppress(LookupError, TypeError, ValueError):
        recipe = dataset.info["recipe"]
        twins = recorded_twins(recipe)
        variation = tuple(varied for varied in read_variation(recipe) if varied.name not in twins)
        return Plan.model_validate(recipe["plan"]), variation, twins
    return None, (), {}


def _drawn_number(varied: Varied, value: Any) -> float:
    """A value of the manifest as a number; see `as_number`."""
    number = as_number(varied, value)
    # A column for values of several types holds the numbers and Booleans among them as JSON.
    if np.isnan(number) and isinstance(value, str) and not isinstance(varied, VariedNumber):
        with suppress(ValueError):
            return as_number(varied, json.loads(value))
    return number


def _manifest_rows(dataset: Dataset, drawn: Sequence[str]) -> dict[int, dict[str, Any]]:
    """Rows by index, with the columns `drawn`.

    Empty if the data set has no tables, which are not made for it, or none can be made.
    """
    if not any((dataset.folder / name).is_file() for name in (MANIFEST, JOURNAL)):
        return {}
    with suppress(OutputError):
        table = dataset.manifest()
        columns = [
            name for name in ("index", "worker", *NUMBERS, *_PIXELS, *drawn) if name in table.column_names
        ]
        types = table_schema(table_columns(MANIFEST, dataset.info))
        # A table that this package did not write.
        if any(table.schema.field(name).type != types.field(name).type for name in columns):
            return {}
        return {row["index"]: row for row in table.select(columns).to_pylist()}
    return {}


@dataclass(frozen=True, eq=False)
class SetSummary:
    """One of the sets that a page shows."""

    key: str  # "a" for the data set, "b" for the second set; selects its colour
    name: str
    frames: int
    statistics: ImageStatistics  # of its measured images
    records: FrameRecords | None  # of all frames; None if it is not a data set of this package
    cards: tuple[Card, ...]  # its displayed images

    def class_fractions(self) -> tuple[NDArray[np.float64], int]:
        """Pixel fraction of each class `(8,)`, and the number of images that they are from.

        They are from all frames with labels if the records contain any, otherwise from the measured images.
        """
        labelled = np.empty((0, 8)) if self.records is None else self.records.labelled()
        if len(labelled) == 0:
            return self.statistics.class_fractions(), self.statistics.labelled_count
        return labelled.sum(axis=0) / max(1.0, float(labelled.sum())), len(labelled)

    def unlabelled_fraction(self) -> float:
        """Fraction of the pixels of the label images that have no label."""
        void = self.statistics.unlabelled_pixels
        return void / max(1, void + int(self.statistics.class_pixels.sum()))


@final
class Moments:
    """The moments of the frames of a set.

    Args:
        plan: of the data set.
        cameras: names of the cameras of its rig, the main one first.
        indices: of all frames, ascending.
    """

    def __init__(self, plan: Plan, cameras: Sequence[str], indices: Sequence[int]) -> None:
        self._plan, self._cameras = plan, cameras
        self._positions: dict[int, list[int]] = {}  # by moment, in the order of the frames
        self._indices = indices
        for position, moment in enumerate(moments(plan, indices).tolist()):
            self._positions.setdefault(moment, []).append(position)

    @classmethod
    def of_images(cls, images: ImageSet) -> Self | None:
        """The moments of a set; None for one in which no two images can show the same moment."""
        if not isinstance(images, RenderedSet):
            return None
        with suppress(KeyError, TypeError, ValueError):
            recipe: Mapping[str, Any] = images.dataset.info["recipe"]
            plan = Plan.model_validate(recipe["plan"])
            cameras = [FIRST_CAMERA, *(str(camera["name"]) for camera in recipe.get("rig", ()))]
            is_inside = max(images.items) < plan.count and plan.cameras <= len(cameras)
            if plan.twins * plan.cameras > 1 and is_inside:
                return cls(plan, cameras, images.items)
        return None

    def evenly_spaced(self, limit: int) -> list[int]:
        """At most `limit` positions: all frames of evenly spaced moments, or the first frames of one."""
        groups = list(self._positions.values())
        largest = max(map(len, groups))
        chosen = [groups[number] for number in evenly_spaced(len(groups), max(1, limit // largest))]
        return sorted(position for group in chosen for position in group[: max(limit, 1)])

    def relatives(self, position: int) -> list[tuple[int, str]]:
        """Index and description of the other frames of a frame's moment, the nearest first."""
        plan = self._plan
        shown = plan.frame(self._indices[position])
        found = []
        for other in self._positions[shown.moment]:
            spec = plan.frame(self._indices[other])
            parts = [f"twin {spec.twin}"] if spec.twin != shown.twin else []
            parts += [self._cameras[spec.camera]] if spec.camera != shown.camera else []
            if parts:
                found.append((len(parts), spec.index, ", ".join(parts)))
        return [(number, text) for _, number, text in sorted(found)]


def displayed_positions(images: ImageSet, limit: int) -> list[int]:
    """At most `limit` positions of a set, evenly spaced; frames of one moment are shown together."""
    of_set = Moments.of_images(images)
    if of_set is None or len(images) <= limit:
        return evenly_spaced(len(images), limit)
    return of_set.evenly_spaced(limit)
