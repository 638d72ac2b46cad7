"""Files that are either whole or not there."""

from __future__ import annotations

import hashlib
import itertools
import json
import os
import platform
import re
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path
from typing import Any, Final

_STALE_S: Final = 3600.0
"""Chosen: no write takes an hour, so that an older temporary file is a killed build's."""

_MADE_BY: Final = re.compile(r"\.(?P<host>[A-Za-z0-9-]+)\.(?P<process>\d+)\.\d+\.tmp$")
_number: Final = itertools.count()

_LEVELS: Final = 2
"""Chosen: of a JSON file in lines, so that a difference shows which organ or image it is about."""


@contextmanager
def atomic_write(path: Path) -> Iterator[Path]:
    """A temporary name in the same folder, which takes the place of `path` when the block ends well.

    The content is on the disk before the name is: after a power cut there is the old file or the new one.
    When the block raises, the temporary file is removed and `path` stays as it was.
    """
    temporary = path.with_name(f".{path.name}.{_host()}.{os.getpid()}.{next(_number)}.tmp")
    try:
        yield temporary
        with temporary.open("rb+") as file:
            os.fsync(file.fileno())
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)


def write_json(path: Path, content: Any) -> None:
    """Write JSON with sorted keys, the same bytes for the same content.

    Raises:
        OSError: the file cannot be written.
        ValueError: the content holds a number that JSON does not know (nan, inf).
    """
    with atomic_write(path) as temporary:
        temporary.write_bytes(canonical_json(content))


def canonical_json(content: Any) -> bytes:
    """Canonical JSON text: sorted keys, what lies two levels down on a line of its own.

    Raises:
        ValueError: the content holds a number that JSON does not know (nan, inf).
    """
    return (_lines(content, _LEVELS) + "\n").encode()


def _lines(value: Any, levels: int) -> str:
    """Some levels in lines, the rest by Python's encoder, which is fast only without line breaks."""
    if levels and isinstance(value, dict) and value:
        told = [f"{_dumps(str(key))}: {_lines(value[key], levels - 1)}" for key in sorted(value)]
        return "{\n" + ",\n".join(told) + "\n}"
    if levels and isinstance(value, list) and value and isinstance(value[0], dict):
        return "[\n" + ",\n".join(_lines(one, 0) for one in value) + "\n]"
    return _dumps(value)


def digest(path: Path) -> str:
    """SHA-256 of a file, hexadecimal."""
    return hashlib.sha256(path.read_bytes()).hexdigest()


def is_temporary(path: Path) -> bool:
    """Whether a file is one of `atomic_write`'s, left by a build that was killed or still runs."""
    return path.name.startswith(".") and path.name.endswith(".tmp")


def sweep(folder: Path) -> None:
    """Remove the temporary files that killed builds left in a folder."""
    for path in folder.iterdir():
        with suppress(FileNotFoundError):
            if is_temporary(path) and (_orphaned(path) or time.time() - path.stat().st_mtime > _STALE_S):
                path.unlink(missing_ok=True)


def _orphaned(path: Path) -> bool:
    """Whether a temporary file's process ran on this machine, and does no more."""
    found = _MADE_BY.search(path.name)
    # Elsewhere, asking after a process would end it.
    if os.name != "posix" or found is None or found["host"] != _host():
        return False
    try:
        os.kill(int(found["process"]), 0)
    except ProcessLookupError:
        return True
    except OSError:
        return False
    return False


@cache
def _host() -> str:
    """This machine's name, without what has no place in a file's."""
    return re.sub(r"[^A-Za-z0-9-]", "-", platform.node()) or "unnamed"


def _plain(value: Any) -> Any:
    """NumPy's scalars and arrays as Python's."""
    if hasattr(value, "tolist"):
        return value.tolist()
    raise TypeError(f"{type(value).__name__} has no place in JSON")


_dumps: Final = json.JSONEncoder(sort_keys=True, allow_nan=False, default=_plain).encode
