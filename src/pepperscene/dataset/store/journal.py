"""The journal of a data set: a line for each frame, added when the frame is whole, and one for the frames
that a build was asked for.

It holds what no other file does (which frames are wanted, how long a frame took, and who made it) and spares
reading thousands of frames again for the manifest. It is not needed: what it says besides can be read out of
the frames. A line that a power cut has torn is skipped.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from types import TracebackType
from typing import IO, Final, Self

from pepperscene.dataset.store.rows import Row

JOURNAL: Final = "journal.jsonl"


class Journal:
    """The journal of the data set in a folder; of a frame's lines the last one counts.

    It keeps a place and a checksum for each frame in memory, not the rows.

    Args:
        folder: of the data set; nothing is made there before the first line.
    """

    def __init__(self, folder: Path) -> None:
        self._path = folder / JOURNAL
        self._places: dict[int, tuple[int, str]] = {}
        self._wanted: set[int] = set()
        self._file: IO[bytes] | None = None
        if self._path.is_file():
            with self._path.open("rb") as file:
                place = 0
                for line in file:
                    self._note(place, line)
                    place += len(line)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, fault: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._file is not None:
            self._file.close()

    @property
    def wanted(self) -> frozenset[int]:
        """The frames that builds were asked for."""
        return frozenset(self._wanted)

    def want(self, indices: Iterable[int]) -> None:
        """Note which frames a build is asked for, unless all of them are known to be wanted.

        Raises:
            OSError: it cannot be written.
        """
        asked = sorted(indices)
        if not self._wanted.issuperset(asked):
            self._write({"wanted": _runs(asked)})

    def checksum(self, index: int) -> str:
        """Of the frame's JSON as the journal knows it; empty for none."""
        return self._places.get(index, (0, ""))[1]

    def add(self, row: Row) -> None:
        """Add a frame's row, unless the journal knows of this very frame already.

        Raises:
            OSError: it cannot be written.
        """
        if self.checksum(row["index"]) == row["checksum"]:
            return
        self._write(row)

    def _write(self, row: Row) -> None:
        if self._file is None:
            self._file = self._path.open("ab")
            if self._torn():
                self._file.write(b"\n")
        line = json.dumps(row, sort_keys=True, allow_nan=False).encode() + b"\n"
        place = self._file.tell()
        self._file.write(line)
        self._file.flush()
        self._note(place, line)

    def rows(self, indices: Iterator[int]) -> Iterator[tuple[int, Row | None]]:
        """The frames' rows, None for those that the journal does not know."""
        if not self._path.is_file():
            yield from ((index, None) for index in indices)
            return
        with self._path.open("rb") as file:
            for index in indices:
                if index not in self._places:
                    yield index, None
                    continue
                file.seek(self._places[index][0])
                yield index, json.loads(file.readline())

    def _note(self, place: int, line: bytes) -> None:
        try:
            row = json.loads(line)
            if "wanted" in row:
                for first, beyond in row["wanted"]:
                    self._wanted.update(range(int(first), int(beyond)))
                return
            self._places[int(row["index"])] = (place, str(row["checksum"]))
        except (ValueError, KeyError, TypeError):
            return

    def _torn(self) -> bool:
        """Whether the last line was not finished."""
        with self._path.open("rb") as file:
            size = file.seek(0, 2)
            file.seek(max(0, size - 1))
            return size > 0 and file.read() != b"\n"


def _runs(indices: Sequence[int]) -> list[tuple[int, int]]:
    """Ascending numbers as ranges, the first of each and the one after its last."""
    ends = [k for k in range(1, len(indices)) if indices[k] != indices[k - 1] + 1]
    starts = [0, *ends] if indices else []
    return [
        (indices[first], indices[beyond - 1] + 1)
        for first, beyond in zip(starts, [*ends, len(indices)], strict=False)
    ]
