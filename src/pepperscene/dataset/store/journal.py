"""The journal of a data set: one line for each finished frame, and one for the frames that a build requested.

It holds what no other file does (which frames were requested, how long a frame took, which worker made it),
and saves reading thousands of frames again for the manifest. It may be lost: everything else can be read from
the frames. A line torn by a power cut is skipped.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import IO, Final, Self

from pepperscene.dataset.store.manifest import Row

JOURNAL: Final = "journal.jsonl"


class Journal:
    """The journal of the data set in a folder; the last line of a frame counts.

    Only an offset and a checksum per frame are kept in memory, not the rows.

    Args:
        folder: of the data set; nothing is created there before the first line is added.
    """

    def __init__(self, folder: Path) -> None:
        self._path = folder / JOURNAL
        self._frames: dict[int, tuple[int, str]] = {}  # offset and checksum
        self._wanted: set[int] = set()
        self._file: IO[bytes] | None = None
        if self._path.is_file():
            with self._path.open("rb") as file:
                offset = 0
                for line in file:
                    self._index_line(offset, line)
                    offset += len(line)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        if self._file is not None:
            self._file.close()

    @property
    def wanted(self) -> frozenset[int]:
        """The frames that builds requested."""
        return frozenset(self._wanted)

    def want(self, indices: Iterable[int]) -> None:
        """Note the frames that a build requests, unless all of them are noted already."""
        requested = sorted(indices)
        if not self._wanted.issuperset(requested):
            self._write_line({"wanted": _to_ranges(requested)})

    def checksum(self, index: int) -> str:
        """Checksum of the frame's JSON according to the journal; empty if the frame is unknown."""
        return self._frames.get(index, (0, ""))[1]

    def add(self, row: Row) -> None:
        """Add a frame's row, unless the journal holds this frame with this checksum already."""
        if self.checksum(row["index"]) != row["checksum"]:
            self._write_line(row)

    def rows(self, indices: Iterable[int]) -> Iterator[tuple[int, Row | None]]:
        """Yield each index with the frame's row, or with None if the journal does not hold the frame."""
        if not self._path.is_file():
            yield from ((index, None) for index in indices)
            return
        with self._path.open("rb") as file:
            for index in indices:
                if index not in self._frames:
                    yield index, None
                    continue
                file.seek(self._frames[index][0])
                yield index, json.loads(file.readline())

    def _write_line(self, row: Row) -> None:
        if self._file is None:
            self._file = self._path.open("ab")
            if self._is_torn():
                self._file.write(b"\n")
        line = json.dumps(row, sort_keys=True, allow_nan=False).encode() + b"\n"
        offset = self._file.tell()
        self._file.write(line)
        self._file.flush()
        self._index_line(offset, line)

    def _index_line(self, offset: int, line: bytes) -> None:
        try:
            row = json.loads(line)
            if "wanted" in row:
                for first, end in row["wanted"]:
                    self._wanted.update(range(int(first), int(end)))
                return
            self._frames[int(row["index"])] = (offset, str(row["checksum"]))
        except (ValueError, KeyError, TypeError):
            return

    def _is_torn(self) -> bool:
        """Whether the last line has no end."""
        with self._path.open("rb") as file:
            size = file.seek(0, 2)
            file.seek(max(0, size - 1))
            return size > 0 and file.read() != b"\n"


def _to_ranges(indices: list[int]) -> list[tuple[int, int]]:
    """Ascending numbers as half-open ranges."""
    ranges: list[tuple[int, int]] = []
    for index in indices:
        if ranges and ranges[-1][1] == index:
            ranges[-1] = (ranges[-1][0], index + 1)
        else:
            ranges.append((index, index + 1))
    return ranges
