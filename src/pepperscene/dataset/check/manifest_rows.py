"""The data set's manifest against its frames."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Final

from pepperscene.dataset.check.traits import manifest_digest
from pepperscene.dataset.check.verdict import Finding
from pepperscene.dataset.manifest import FRUIT, MANIFEST
from pepperscene.dataset.store import Dataset

_ROWS: Final = 4096  # chosen: rows that are held at a time


def manifest_faults(dataset: Dataset, rows: Mapping[int, int], harvested: bool) -> Iterator[Finding]:
    """What is wrong with the tables of a data set.

    Args:
        dataset: that they belong to.
        rows: digest of what the manifest must say of each frame.
        harvested: whether there must be a table of fruit.
    """
    from pyarrow import ArrowException, parquet

    left = dict(rows)
    try:
        with parquet.ParquetFile(dataset.folder / MANIFEST) as file:
            for batch in file.iter_batches(_ROWS):
                for row in batch.to_pylist():
                    yield from _row_faults(row, left)
    except FileNotFoundError:
        yield Finding("missing", None, MANIFEST, "is not there; the same build writes it again")
        return
    except (OSError, ArrowException, KeyError, ValueError) as fault:
        yield Finding("damaged", None, MANIFEST, f"cannot be read ({' '.join(str(fault).split())[:80]})")
        return
    for index in sorted(left):
        yield Finding("contradiction", index, MANIFEST, "has no row for this frame")
    if harvested and not (dataset.folder / FRUIT).is_file():
        yield Finding("missing", None, FRUIT, "is not there, though frames have the output harvest")


def _row_faults(row: Mapping[str, object], left: dict[int, int]) -> Iterator[Finding]:
    index = int(str(row["index"]))
    if index not in left:
        yield Finding("incomplete", index, MANIFEST, "has a row for this frame, whose JSON is not there")
    elif left.pop(index) != manifest_digest(row):
        yield Finding("contradiction", index, MANIFEST, "says otherwise of this frame than its JSON")
