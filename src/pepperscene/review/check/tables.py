"""Checks of the tables of a data set against its frames."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Iterator, Mapping
from itertools import groupby
from typing import Any, Final

from pepperscene.dataset.store.dataset import Dataset
from pepperscene.dataset.store.journal import TIMINGS
from pepperscene.dataset.store.manifest import (
    FRUIT,
    FRUIT_COLUMNS,
    MANIFEST,
    Row,
    open_table_file,
    stored_row,
    table_columns,
    table_schema,
)
from pepperscene.errors import InputError
from pepperscene.review.check.findings import Finding

_BATCH_ROWS: Final = 4096  # chosen: rows in memory at a time


def short_digest(content: bytes | memoryview) -> int:
    """A digest of 64 bits; in a million, two different contents have the same one with a chance of 3e-8."""
    return int.from_bytes(hashlib.blake2b(content, digest_size=8).digest())


def frame_row_digest(row: Row, columns: Mapping[str, str]) -> int:
    """Digest of a row in a manifest of these columns, without timings, which no frame's JSON holds."""
    return _rows_digest([{**stored_row(row, columns), **dict.fromkeys(TIMINGS)}], columns)


def fruit_rows_digest(rows: Iterable[Row]) -> int:
    """Digest of the rows of one frame in the table of fruit."""
    return _rows_digest(rows, FRUIT_COLUMNS)


def _rows_digest(rows: Iterable[Row], columns: Mapping[str, str]) -> int:
    known = [
        {name: _as_stored(columns.get(name), value) for name, value in row.items() if value is not None}
        for row in rows
    ]
    return short_digest(json.dumps(known, sort_keys=True, default=str).encode())


def _as_stored(kind: str | None, value: Any) -> Any:
    """A value as it is read from a column: JSON may hold 1 where the column holds 1.0."""
    if kind == "doubles":
        return [_as_stored("double", number) for number in value]
    return float(value) if kind == "double" and type(value) is int else value


def check_tables(
    dataset: Dataset,
    frame_digests: Mapping[int, int],
    fruit_digests: Mapping[int, int],
    harvest: bool,
) -> Iterator[Finding]:
    """Yield the problems of the tables of a data set.

    Args:
        dataset: that the tables belong to.
        frame_digests: digest of the expected row of the manifest for each frame.
        fruit_digests: digest of the expected rows of the table of fruit for each frame; 0 if unknown.
        harvest: whether there must be a table of fruit.
    """
    if (dataset.folder / MANIFEST).exists():
        yield from _check_readable(MANIFEST, _check_manifest(dataset, frame_digests))
    else:
        problem = "does not exist; the same build command writes it again"
        yield Finding("missing", None, MANIFEST, problem)
    if (dataset.folder / FRUIT).exists():
        yield from _check_readable(FRUIT, _check_fruit(dataset, fruit_digests))
    elif harvest:
        yield Finding("missing", None, FRUIT, "does not exist, although frames have the output harvest")


def _check_readable(name: str, findings: Iterator[Finding]) -> Iterator[Finding]:
    """The findings of a table, the last one of which is that it cannot be read to its end."""
    from pyarrow import ArrowException

    try:
        yield from findings
    except InputError as error:
        yield Finding("damaged", None, name, error.problem)
    except (OSError, ArrowException, LookupError, ValueError, TypeError, MemoryError) as error:
        reason = " ".join(str(error).split()) or type(error).__name__
        yield Finding("damaged", None, name, f"cannot be read ({reason[:80]})")


def _check_manifest(dataset: Dataset, frame_digests: Mapping[int, int]) -> Iterator[Finding]:
    expected, columns = dict(frame_digests), table_columns(MANIFEST, dataset.info)
    for row in _read_rows(dataset, MANIFEST):
        index = int(row["index"])
        if index not in expected:
            problem = "has a row for this frame, whose JSON does not exist"
            yield Finding("incomplete", index, MANIFEST, problem)
        elif expected.pop(index) != frame_row_digest(row, columns):
            yield Finding("contradiction", index, MANIFEST, "disagrees with the JSON of this frame")
    for index in sorted(expected):
        yield Finding("contradiction", index, MANIFEST, "has no row for this frame")


def _check_fruit(dataset: Dataset, fruit_digests: Mapping[int, int]) -> Iterator[Finding]:
    rows = _read_rows(dataset, FRUIT)
    found = {index: fruit_rows_digest(group) for index, group in groupby(rows, lambda row: int(row["index"]))}
    nothing = fruit_rows_digest(())
    for index in sorted(found.keys() | fruit_digests.keys()):
        expected = fruit_digests.get(index, nothing)
        if expected and found.get(index, nothing) != expected:
            yield Finding("contradiction", index, FRUIT, "disagrees with the harvest of this frame")


def _read_rows(dataset: Dataset, name: str) -> Iterator[Row]:
    """The rows of a table, of which some thousand are in memory at a time."""
    from pyarrow import parquet

    with (
        open_table_file(dataset.folder / name, dataset.folder) as content,
        parquet.ParquetFile(content, page_checksum_verification=True) as file,
    ):
        if not file.schema_arrow.equals(table_schema(table_columns(name, dataset.info))):
            raise ValueError("it has other columns than this version writes")
        for batch in file.iter_batches(_BATCH_ROWS):
            yield from batch.to_pylist()
