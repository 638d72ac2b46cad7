"""The tables of a data set: a row for each frame, and a row for each fruit of each frame."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import suppress
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from pepperscene.dataset.store.atomic import atomic_write
from pepperscene.dataset.store.dataset import Dataset, read_json
from pepperscene.dataset.store.journal import Journal
from pepperscene.dataset.store.rows import FRAME_COLUMNS, FRUIT_COLUMNS, Row, fruit_rows, row_of
from pepperscene.errors import InputError, OutputError

if TYPE_CHECKING:
    import pyarrow


MANIFEST: Final = "manifest.parquet"
FRUIT: Final = "fruit.parquet"
_ROWS: Final = 4096  # chosen: rows that are held at a time, some megabytes


def write_manifest(dataset: Dataset, journal: Journal | None = None) -> None:
    """Write `manifest.parquet`, and `fruit.parquet` where frames have the output `harvest`.

    A frame's row comes out of the journal, or else out of the frame's own files.

    Args:
        dataset: whose frames are told.
        journal: its journal, where it is open already.

    Raises:
        OSError: a table cannot be written.
    """
    known = Journal(dataset.folder) if journal is None else journal
    indices = dataset.indices()

    def frames() -> Iterator[Row]:
        for index, row in known.rows(iter(indices)):
            told = row if row is not None else row_of(dataset.intact(index))
            if told.get("index") is not None:
                yield told

    _write(dataset.folder / MANIFEST, FRAME_COLUMNS, frames())
    harvested = [index for index in indices if (dataset.path(index, "harvest")).is_file()]
    if harvested:
        _write(dataset.folder / FRUIT, FRUIT_COLUMNS, _fruit(dataset, harvested))


def read_manifest(dataset: Dataset) -> pyarrow.Table:
    """The table of all frames, ascending; written anew where it is lost or tells of other frames.

    Columns are those of `rows.FRAME_COLUMNS`.

    Raises:
        OutputError: it is lost and cannot be written anew.
    """
    return _read(dataset, MANIFEST)


def read_fruit(dataset: Dataset) -> pyarrow.Table:
    """The table of all fruit in all frames; columns are those of `rows.FRUIT_COLUMNS`.

    Raises:
        InputError: no frame has the output `harvest`.
        OutputError: the table is lost and cannot be written anew.
    """
    return _read(dataset, FRUIT)


def _read(dataset: Dataset, name: str) -> pyarrow.Table:
    from pyarrow import ArrowInvalid, parquet

    path = dataset.folder / name
    with suppress(OSError, ArrowInvalid):
        found = parquet.read_table(dataset.folder / MANIFEST, columns=["index"])
        if tuple(found["index"].to_pylist()) == dataset.indices():
            return parquet.read_table(path)
    try:
        write_manifest(dataset)
    except OSError as fault:
        raise OutputError(f"{path}: cannot be written ({fault.strerror or fault})") from None
    if not path.is_file():
        raise InputError(dataset.folder, "has no frame with the output harvest; build it first")
    return parquet.read_table(path)


def _fruit(dataset: Dataset, indices: Iterable[int]) -> Iterator[Row]:
    for index in indices:
        # A damaged file is the next build's to mend.
        with suppress(InputError):
            yield from fruit_rows(index, read_json(dataset.path(index, "harvest")))


def _write(path: Path, columns: Mapping[str, str], rows: Iterator[Row]) -> None:
    """Write a table, some thousands of rows at a time."""
    import pyarrow
    from pyarrow import parquet

    schema = pyarrow.schema([(name, _type(pyarrow, kind)) for name, kind in columns.items()])
    with atomic_write(path) as temporary, parquet.ParquetWriter(temporary, schema) as writer:
        while part := list(islice(rows, _ROWS)):
            told = {name: [row.get(name) for row in part] for name in columns}
            writer.write_table(pyarrow.table(told, schema=schema))


def _type(pyarrow: Any, kind: str) -> Any:
    named: Mapping[str, Callable[[], Any]] = {
        "int64": pyarrow.int64,
        "int32": pyarrow.int32,
        "double": pyarrow.float64,
        "doubles": lambda: pyarrow.list_(pyarrow.float64()),
        "string": pyarrow.string,
        "bool": pyarrow.bool_,
    }
    return named[kind]()
