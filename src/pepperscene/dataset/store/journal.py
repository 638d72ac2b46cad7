"""The journal of a data set: one line for each finished frame, and one for the frames that a build requested.

It holds what no other file does (which frames were requested, how long a frame took, which worker made it),
and saves reading thousands of frames again for the manifest. It may be lost: everything else can be read from
the frames.

A line is a JSON object whose last key is a checksum of the text before it. It is appended by one system call,
so several builds can write at the same time. A line that is not what was written (torn by a power cut, or
changed on the disk) is skipped. The next build says so and adds a line with its position, after which it is
no fault any more: lines are never changed or removed, because another build may be appending.
"""

from __future__ import annotations

import errno
import hashlib
import json
import os
from collections.abc import Iterable, Iterator
from contextlib import ExitStack, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, Any, Final, Self, final

from pepperscene.atomic import write_error
from pepperscene.dataset.store.manifest import TIMINGS, Row, fits_columns
from pepperscene.document import parse_json
from pepperscene.errors import InputError
from pepperscene.user_files import MissingFileError, open_file

JOURNAL: Final = "journal.jsonl"
_MAX_FRAMES: Final = 1_000_000  # file names have six digits
_CHECKSUM_DIGITS: Final = 16  # chosen: 64 bits; a changed line passes by chance once in 2e19
_SUFFIX: Final = b', "line_sha256": "%b"}'
_SUFFIX_LENGTH: Final = len(_SUFFIX % (b"0" * _CHECKSUM_DIGITS))
_MAX_LINE: Final = 1 << 20  # chosen: bytes; a frame's line has two thousand
_RANGES_PER_LINE: Final = 10_000  # chosen: so that such a line has at most 200,000 bytes

Span = tuple[int, int]
"""First byte of a line, and the byte behind it."""


@dataclass
class _Lines:
    """What the lines of a file hold, as far as it was read."""

    identity: tuple[int, int] | None = None  # of the file
    end: int = 0  # of the last complete line
    rows: dict[tuple[int, str], Span] = field(default_factory=dict)  # by index and checksum
    untimed: set[tuple[int, str]] = field(default_factory=set)  # those of `rows` without timings
    wanted: list[Span] = field(default_factory=list)  # ranges of indices
    damaged: list[Span] = field(default_factory=list)
    skipped: list[Span] = field(default_factory=list)
    torn: Span | None = None  # the last line, if it has no end


@final
class Journal:
    """The journal of the data set in a folder.

    Only the position of each frame's line is kept in memory, not the rows.

    Args:
        folder: of the data set; nothing is created there before the first line is added.
    """

    def __init__(self, folder: Path) -> None:
        self._folder, self._path = folder, folder / JOURNAL
        self._file: IO[bytes] | None = None
        self._lines = _Lines()
        self._added: set[tuple[int, str]] = set()  # index and checksum
        self.refresh()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: object, *_: object) -> None:
        if self._file is None:
            return
        try:
            self._file.close()
        except OSError as error:
            # Network file systems report a full disk here; an error before it matters more.
            if kind is None:
                raise write_error(error, self._path) from None

    @property
    def wanted(self) -> frozenset[int]:
        """The frames that builds requested."""
        return frozenset(index for first, end in self._lines.wanted for index in range(first, end))

    @property
    def damaged(self) -> tuple[Span, ...]:
        """Positions of lines that are not what was written, except those that a build has reported."""
        lines = self._lines
        spans = [*lines.damaged, lines.torn] if lines.torn is not None else lines.damaged
        return tuple(
            span
            for span in spans
            if not any(first <= span[0] and span[1] <= end for first, end in lines.skipped)
        )

    def refresh(self) -> None:
        """Read the lines that were added since the last call, by any process.

        Raises `InputError` if the file exists and cannot be read.
        """
        try:
            with open_file(self._path, "journal", within=self._folder) as file:
                status = os.fstat(file.fileno())
                identity = (status.st_dev, status.st_ino)
                if identity != self._lines.identity or status.st_size < self._lines.end:
                    self._lines = _Lines(identity)
                file.seek(self._lines.end)
                self._read_lines(file)
        except MissingFileError:
            self._lines = _Lines()
        except OSError as error:
            raise InputError(self._path, f"cannot be read ({error.strerror or error})") from None

    def want(self, indices: Iterable[int]) -> None:
        """Note the frames that a build requests, unless all of them are noted already."""
        requested = sorted(indices)
        if self.wanted.issuperset(requested):
            return
        ranges = _to_ranges(requested)
        for start in range(0, len(ranges), _RANGES_PER_LINE):
            self._write_line({"wanted": ranges[start : start + _RANGES_PER_LINE]})
        self._lines.wanted = _merge([*self._lines.wanted, *ranges])

    def skip_damaged(self) -> int:
        """Note the positions of damaged lines, so that they are no fault any more; returns their number."""
        spans = self.damaged
        for start in range(0, len(spans), _RANGES_PER_LINE):
            self._write_line({"skipped": spans[start : start + _RANGES_PER_LINE]})
        self._lines.skipped += spans
        return len(spans)

    def add(self, row: Row) -> None:
        """Add a frame's row, unless the journal holds this frame with this checksum already."""
        key = (int(row["index"]), str(row["checksum"]))
        if key not in self._lines.rows and key not in self._added:
            self._write_line(row)
            self._added.add(key)

    def rows(self, frames: Iterable[tuple[int, str]]) -> Iterator[tuple[int, Row | None]]:
        """Yield each index with the frame's row.

        Args:
            frames: index, and the checksum in the frame's JSON.

        Yields:
            The index, and None if the journal does not hold the frame with this checksum.
        """
        with ExitStack() as stack:
            file: IO[bytes] | None = None
            for index, checksum in frames:
                span, row = self._lines.rows.get((index, checksum)), None
                if span is not None:
                    if file is None:
                        file = stack.enter_context(open_file(self._path, "journal", within=self._folder))
                    file.seek(span[0])
                    row = _decode(file.read(span[1] - span[0]))
                yield index, row if row is not None and fits_columns(row) else None

    def _read_lines(self, file: IO[bytes]) -> None:
        lines = self._lines
        lines.torn = None
        while line := file.readline(_MAX_LINE):
            span = (lines.end, lines.end + len(line))
            if not line.endswith(b"\n") and len(line) < _MAX_LINE:
                # The end of the file; another process may be writing it.
                lines.torn = span
                break
            lines.end = span[1]
            if line != b"\n" and not _note_line(lines, span, line):
                lines.damaged.append(span)

    def _write_line(self, content: Row) -> None:
        file = self._open()
        line = _encode(content)
        # A torn line must not take this one with it.
        size = file.seek(0, os.SEEK_END)
        if size:
            file.seek(size - 1)
            line = line if file.read(1) == b"\n" else b"\n" + line
        if file.write(line) != len(line):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(self._path))

    def _open(self) -> IO[bytes]:
        """The file, opened for appending; again if it was removed."""
        if self._file is not None:
            with suppress(FileNotFoundError):
                if os.path.samestat(os.fstat(self._file.fileno()), self._path.stat()):
                    return self._file
            self._file.close()
        self._file = self._path.open("ab+", buffering=0)
        return self._file


def _note_line(lines: _Lines, span: Span, line: bytes) -> bool:
    """Note what a line holds; returns whether it is what was written."""
    content = _decode(line)
    if content is None:
        return False
    try:
        if "wanted" in content:
            ranges = [(int(first), int(end)) for first, end in content["wanted"]]
            if not all(0 <= first < end <= _MAX_FRAMES for first, end in ranges):
                return False
            lines.wanted = _merge([*lines.wanted, *ranges])
        elif "skipped" in content:
            lines.skipped += [(int(first), int(end)) for first, end in content["skipped"]]
        else:
            _note_row(lines, span, content)
    except (KeyError, TypeError, ValueError, OverflowError):
        return False
    return True


def _note_row(lines: _Lines, span: Span, row: Row) -> None:
    # The first line with timings counts: a table stays true if another build makes the same frame.
    key, is_timed = (int(row["index"]), str(row["checksum"])), TIMINGS[0] in row
    if key not in lines.rows or (key in lines.untimed and is_timed):
        lines.rows[key] = span
        (lines.untimed.discard if is_timed else lines.untimed.add)(key)


def _encode(content: Row) -> bytes:
    """A line: the content, with its checksum as the last key."""
    body = json.dumps(content, sort_keys=True, allow_nan=False).encode()[:-1]
    return body + _SUFFIX % _checksum(body) + b"\n"


def _decode(line: bytes) -> dict[str, Any] | None:
    """The content of a line, or None if it is not what was written."""
    line = line.rstrip(b"\n")
    body, suffix = line[:-_SUFFIX_LENGTH], line[-_SUFFIX_LENGTH:]
    if suffix != _SUFFIX % _checksum(body):
        return None
    try:
        content = parse_json(body + b"}")
    except ValueError:
        return None
    return content if isinstance(content, dict) else None


def _checksum(body: bytes) -> bytes:
    return hashlib.sha256(body).hexdigest()[:_CHECKSUM_DIGITS].encode()


def _to_ranges(indices: Iterable[int]) -> list[Span]:
    """Numbers as half-open ranges."""
    return _merge([(index, index + 1) for index in indices])


def _merge(ranges: Iterable[Span]) -> list[Span]:
    """Half-open ranges, ascending and apart from each other."""
    merged: list[Span] = []
    for first, end in sorted(ranges):
        if merged and first <= merged[-1][1]:
            merged[-1] = (merged[-1][0], max(end, merged[-1][1]))
        else:
            merged.append((first, end))
    return merged
