"""The journal of a data set: a log of how long each frame took, and which worker made it.

A line is a JSON object, appended by one system call, so that several builds can write at the same time.
Nothing depends on the journal: a line that cannot be read is skipped, and its times are unknown.
"""

from __future__ import annotations

import errno
import json
import os
from collections.abc import Collection, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, Final

from pepperscene.document import parse_json
from pepperscene.errors import InputError
from pepperscene.user_files import open_file

JOURNAL: Final = "journal.jsonl"

TIMINGS: Final = ("render_s", "write_s", "worker")
"""Columns of the manifest that no frame's JSON holds."""

_MAX_LINE: Final = 4096  # chosen: bytes; a line has two hundred


def append_timings(folder: Path, row: Mapping[str, Any]) -> None:
    """Append the timings of a frame, by its row in the manifest; raises `OSError` if that fails."""
    path = folder / JOURNAL
    entry = {name: row.get(name) for name in ("index", "checksum", *TIMINGS)}
    line = json.dumps(entry, allow_nan=False).encode() + b"\n"
    with path.open("ab", buffering=0) as file:
        if file.write(line) != len(line):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(path))


def read_timings(folder: Path, checksums: Collection[str]) -> dict[str, dict[str, Any]]:
    """The `TIMINGS` of the frames whose JSON has one of these checksums, as far as they can be read."""
    timings: dict[str, dict[str, Any]] = {}
    with suppress(InputError, OSError), open_file(folder / JOURNAL, "journal", within=folder) as file:
        while line := file.readline(_MAX_LINE):
            with suppress(ValueError, LookupError, TypeError):
                entry = parse_json(line)
                # If two builds make the same frame, the first one counts.
                if entry["checksum"] in checksums and entry["checksum"] not in timings:
                    timings[entry["checksum"]] = {name: entry[name] for name in TIMINGS}
    return timings
