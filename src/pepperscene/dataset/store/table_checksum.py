"""A checksum of all values of a table, independent of how its file divides them into parts."""

from __future__ import annotations

import hashlib
from collections import defaultdict
from typing import TYPE_CHECKING, Any, Final, final

import numpy as np

if TYPE_CHECKING:
    import pyarrow

CHECKSUM_KEY: Final = "pepperscene.sha256"
"""Key of the checksum in the metadata of a Parquet file."""


@final
class TableChecksum:
    """SHA-256 of the values of a table, which is added in parts.

    Each column is hashed by itself: where values are missing, the values, and of texts and lists the lengths.
    """

    def __init__(self) -> None:
        self._hashes: dict[str, Any] = defaultdict(hashlib.sha256)

    def add(self, part: pyarrow.Table | pyarrow.RecordBatch) -> None:
        """Add the next rows."""
        for field in part.schema:
            column = part.column(field.name)
            if hasattr(column, "combine_chunks"):
                column = column.combine_chunks()
            for chunk in getattr(column, "chunks", [column]):
                self._add_column(f"{field.name}:{field.type}", chunk)

    def hexdigest(self) -> str:
        """The checksum, hexadecimal."""
        digests = [f"{name}={self._hashes[name].hexdigest()}" for name in sorted(self._hashes)]
        return hashlib.sha256("\n".join(digests).encode()).hexdigest()

    def _add_column(self, name: str, column: pyarrow.Array) -> None:
        import pyarrow
        from pyarrow import compute

        missing = compute.is_null(column)
        self._hashes[f"{name} missing"].update(missing.to_numpy(zero_copy_only=False).tobytes())
        known = column.drop_null()
        if pyarrow.types.is_string(column.type):
            texts = [text.encode() for text in known.to_pylist()]
            self._add_lengths(name, np.array([len(text) for text in texts], np.int64))
            self._hashes[name].update(b"".join(texts))
            return
        if pyarrow.types.is_list(column.type):
            self._add_lengths(name, compute.list_value_length(known).to_numpy().astype(np.int64))
            known = known.flatten()
        self._hashes[name].update(known.to_numpy(zero_copy_only=False).tobytes())

    def _add_lengths(self, name: str, lengths: np.ndarray[Any, np.dtype[np.int64]]) -> None:
        self._hashes[f"{name} lengths"].update(lengths.tobytes())
