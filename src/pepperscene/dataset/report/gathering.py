"""Going through a set of pictures: an even sample of it, read ahead by threads, measured in order."""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Final

import numpy as np

from pepperscene.dataset.labelled import ImageSet, Labelled
from pepperscene.truth import Statistics

_WORKERS: Final = min(4, os.cpu_count() or 1)
"""Chosen: one thread measures, so that more readers than these only wait for it."""

Told = Callable[[int, int], None]
"""Called with how many pictures are measured, and out of how many."""


def spread(count: int, most: int) -> list[int]:
    """At most `most` of `count` places, evenly over the whole."""
    if count <= most:
        return list(range(count))
    return [int(place) for place in np.linspace(0, count - 1, max(most, 1)).round()]


def gathered(images: ImageSet, sample: int, told: Told | None = None) -> Statistics:
    """The measures of a set's photographs and classes, of at most `sample` pictures evenly over the set.

    Raises:
        InputError: a file is damaged.
    """
    places = spread(len(images), sample)
    statistics = Statistics()
    for picture in ahead(images.select("colour", "classes"), places):
        statistics.add(picture.colour, picture.classes)
        if told is not None:
            told(statistics.pictures, len(places))
    return statistics


def distance_range(images: ImageSet, places: Sequence[int]) -> tuple[float, float] | None:
    """Distances between which 98 of 100 of what is seen lies, metres; None when a set tells of none.

    One range for all pictures, so that they can be compared.
    """
    samples = []
    for picture in ahead(images.select("distance_m"), places):
        if picture.distance_m is not None:
            distance = picture.distance_m[::8, ::8]
            samples.append(distance[np.isfinite(distance)])
    found = np.concatenate(samples) if samples else np.empty(0)
    if found.size == 0:
        return None
    near, far = np.percentile(found, (1, 99))
    return float(near), float(max(far, near + 0.01))


def ahead(images: ImageSet, places: Sequence[int]) -> Iterator[Labelled]:
    """The pictures at these places, in order; few are in memory at a time."""
    with ThreadPoolExecutor(_WORKERS) as pool:
        waiting: deque[Future[Labelled]] = deque()
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
