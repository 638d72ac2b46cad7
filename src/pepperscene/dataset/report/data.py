"""Going through a set of pictures: an even sample of it, read ahead by threads, measured in order."""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.classes import OrganClass
from pepperscene.dataset.readers.image_set import ImageSet, LabelledImage
from pepperscene.dataset.store.dataset import Dataset
from pepperscene.dataset.store.journal import JOURNAL
from pepperscene.dataset.store.manifest import MANIFEST
from pepperscene.errors import OutputError
from pepperscene.truth import ImageStatistics

_WORKERS: Final = min(4, os.cpu_count() or 1)
"""Chosen: one thread measures, so that more readers than these only wait for it."""

Told = Callable[[int, int], None]
"""Called with how many pictures are measured, and out of how many."""


def evenly_spaced(count: int, most: int) -> list[int]:
    """At most `most` of `count` places, evenly over the whole."""
    if count <= most:
        return list(range(count))
    return [int(place) for place in np.linspace(0, count - 1, max(most, 1)).round()]


def image_statistics(images: ImageSet, sample: int, told: Told | None = None) -> ImageStatistics:
    """The measures of a set's photographs and classes, of at most `sample` pictures evenly over the set.

    Raises:
        InputError: a file is damaged.
    """
    places = evenly_spaced(len(images), sample)
    statistics = ImageStatistics()
    for picture in read_ahead(images.select("colour", "classes"), places):
        statistics.add(picture.colour, picture.classes)
        if told is not None:
            told(statistics.pictures, len(places))
    return statistics


def distance_range(images: ImageSet, places: Sequence[int]) -> tuple[float, float] | None:
    """Distances between which 98 of 100 of what is seen lies, metres; None when a set tells of none.

    One range for all pictures, so that they can be compared.
    """
    samples = []
    for picture in read_ahead(images.select("distance_m"), places):
        if picture.distance_m is not None:
            distance = picture.distance_m[::8, ::8]
            samples.append(distance[np.isfinite(distance)])
    found = np.concatenate(samples) if samples else np.empty(0)
    if found.size == 0:
        return None
    near, far = np.percentile(found, (1, 99))
    return float(near), float(max(far, near + 0.01))


def read_ahead(images: ImageSet, places: Sequence[int]) -> Iterator[LabelledImage]:
    """The pictures at these places, in order; few are in memory at a time."""
    with ThreadPoolExecutor(_WORKERS) as pool:
        waiting: deque[Future[LabelledImage]] = deque()
        try:
            for place in places:
                waiting.append(pool.submit(images.__getitem__, place))
                if len(waiting) > 2 * _WORKERS:
                    yield waiting.popleft().result()
            while waiting:
                yield waiting.popleft().result()
        finally:
            for future in waiting:
                future.cancel()


TIMINGS: Final = ("render_s", "write_s")
NUMBERS: Final = (*TIMINGS, "error_codes", "noise_codes", "samples_per_pixel", "bytes")
"""Columns of the manifest that the page shows."""

_PIXELS: Final = tuple(f"pixels_{one.name.lower()}" for one in OrganClass)


@dataclass(frozen=True, eq=False)
class FrameRecords:
    """Numbers of all frames of a data set.

    Attributes:
        indices: `(n,)`, ascending.
        numbers: `(n,)` for each of `NUMBERS`; nan where nothing is known.
        pixels: `(n, 8)`, labelled pixels of each class; nan in frames without labels.
        workers: who made them, as far as it is told.
    """

    indices: NDArray[np.int64]
    numbers: Mapping[str, NDArray[np.float64]]
    pixels: NDArray[np.float64]
    workers: frozenset[str]

    def known(self, name: str) -> NDArray[np.bool_]:
        """`(n,)`, whether a number is known."""
        return np.isfinite(self.numbers[name])

    def shares(self) -> NDArray[np.float64] | None:
        """Share of each class in all pixels `(8,)`, of those frames that have labels; None when none has."""
        labelled = self.pixels[np.isfinite(self.pixels).all(axis=1)]
        return labelled.sum(axis=0) / max(1.0, float(labelled.sum())) if len(labelled) else None


def frame_records(dataset: Dataset) -> FrameRecords:
    """The numbers of all frames: out of the manifest, and of their JSON where it does not know them.

    Raises:
        InputError: a frame's JSON is damaged.
    """
    indices = dataset.indices()
    rows = _manifest(dataset)
    table = np.full((len(indices), len(NUMBERS) + len(_PIXELS)), np.nan)
    workers = set()
    for place, index in enumerate(indices):
        row = rows.get(index) or _told(dataset.metadata(index))
        values = (row.get(name) for name in (*NUMBERS, *_PIXELS))
        table[place] = [np.nan if value is None else value for value in values]
        if row.get("worker"):
            workers.add(str(row["worker"]))
    numbers = {name: table[:, column] for column, name in enumerate(NUMBERS)}
    return FrameRecords(np.array(indices, np.int64), numbers, table[:, len(NUMBERS) :], frozenset(workers))


def _manifest(dataset: Dataset) -> dict[int, dict[str, Any]]:
    """Rows by index. A set that was never told by a build has none, and none is made for it."""
    if not any((dataset.folder / name).is_file() for name in (MANIFEST, JOURNAL)):
        return {}
    with suppress(OutputError):
        table = dataset.manifest()
        wanted = [name for name in ("index", "worker", *NUMBERS, *_PIXELS) if name in table.column_names]
        return {int(row["index"]): row for row in table.select(wanted).to_pylist()}
    return {}


def _told(facts: Mapping[str, Any]) -> dict[str, Any]:
    """The same numbers out of a frame's JSON, which does not tell how long anything took."""
    row: dict[str, Any] = {f"pixels_{name}": count for name, count in facts.get("class_pixels", {}).items()}
    sampling = facts.get("sampling", {})
    row |= {name: sampling.get(name) for name in ("error_codes", "noise_codes", "samples_per_pixel")}
    row["bytes"] = sum(entry.get("bytes", 0) for entry in facts.get("outputs", {}).values())
    return row


@dataclass(frozen=True, eq=False)
class Side:
    """One of the sets that a page shows.

    Attributes:
        key: "a" for the data set, "b" for the one beside it; tells its colour.
        name: of the set.
        frames: how many it has.
        statistics: measures of those that were looked at.
        records: what its own tables say of all frames; None where it has none.
        cards: the pictures shown, as HTML.
        lines: the same pictures as rows of a table, as HTML.
    """

    key: str
    name: str
    frames: int
    statistics: ImageStatistics
    records: FrameRecords | None
    cards: tuple[str, ...]
    lines: tuple[str, ...]

    def shares(self) -> NDArray[np.float64]:
        """Share of each class `(8,)`: of all frames where its tables tell, else of those measured."""
        known = None if self.records is None else self.records.shares()
        return self.statistics.shares() if known is None else known

    def unlabelled(self) -> float:
        """Share of pixels of the label images that have no label."""
        void = self.statistics.unlabelled
        return void / max(1, void + int(self.statistics.pixels.sum()))

    def counted(self) -> int:
        """Of how many frames the shares are."""
        if self.records is None or self.records.shares() is None:
            return self.statistics.labelled
        return int(np.isfinite(self.records.pixels).all(axis=1).sum())
