"""What a data set's own tables say of its frames: pixels of classes, timings, errors."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.classes import OrganClass
from pepperscene.dataset.journal import JOURNAL
from pepperscene.dataset.manifest import MANIFEST
from pepperscene.dataset.store import Dataset
from pepperscene.errors import OutputError

TIMINGS: Final = ("render_s", "write_s")
NUMBERS: Final = (*TIMINGS, "error_codes", "noise_codes", "samples_per_pixel", "bytes")
"""Columns of the manifest that the page shows."""

_PIXELS: Final = tuple(f"pixels_{one.name.lower()}" for one in OrganClass)


@dataclass(frozen=True, eq=False)
class Records:
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


def records(dataset: Dataset) -> Records:
    """The numbers of all frames: out of the manifest, and of their JSON where it does not know them.

    Raises:
        InputError: a frame's JSON is damaged.
    """
    indices = dataset.indices()
    rows = _manifest(dataset)
    table = np.full((len(indices), len(NUMBERS) + len(_PIXELS)), np.nan)
    workers = set()
    for place, index in enumerate(indices):
        row = rows.get(index) or _told(dataset.facts(index))
        values = (row.get(name) for name in (*NUMBERS, *_PIXELS))
        table[place] = [np.nan if value is None else value for value in values]
        if row.get("worker"):
            workers.add(str(row["worker"]))
    numbers = {name: table[:, column] for column, name in enumerate(NUMBERS)}
    return Records(np.array(indices, np.int64), numbers, table[:, len(NUMBERS) :], frozenset(workers))


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
