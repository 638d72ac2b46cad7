"""Files that are either complete or absent, checks of output paths, and canonical JSON."""

from __future__ import annotations

import hashlib
import json
import math
import os
import platform
import re
import secrets
import shutil
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path
from typing import Any, Final

from pepperscene.errors import OutputError
from pepperscene.user_files import FileKind, open_file

_STALE_S: Final = 3600.0  # chosen: no write takes an hour, so an older temporary file is a killed build's
_TEMPORARY_NAME: Final = re.compile(r"\.(?P<host>[A-Za-z0-9-]+)\.(?P<process>\d+)\.[0-9a-f]+\.tmp$")
_RANDOM_BYTES: Final = 8  # chosen: too many to guess the name before the file exists
_LOCK_S: Final = 60.0  # chosen: longer than the tables of a million frames take, and no wait for ever
_LOCK_INTERVAL_S: Final = 0.02  # chosen
SYSTEM_FILES: Final = frozenset({".DS_Store", "Thumbs.db"})
"""Files that file managers write into every folder that they show."""

_DATA_SET_FILES: Final = ("dataset.json", "frames")  # by which the folder of a data set is known
_LINE_LEVELS: Final = 2  # chosen: JSON levels with one entry per line, so that a diff shows which one changed


@contextmanager
def atomic_write(path: Path) -> Iterator[Path]:
    """Yield a temporary path in the same folder, and rename it to `path` when the block succeeds.

    The content is flushed to the disk before the rename: after a power cut there is the old file or the new
    one. If the block raises, the temporary file is removed and `path` stays unchanged.
    """
    temporary = temporary_path(path)
    try:
        # The name is random and must not exist: another user's link there is not followed.
        temporary.open("xb").close()
        yield temporary
        with temporary.open("rb+") as file:
            os.fsync(file.fileno())
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)


def write_file(path: Path, content: bytes, is_valid: Callable[[], bool] | None = None) -> bool:
    """Write one file atomically; returns whether it was written.

    Args:
        path: of the file.
        content: of the file.
        is_valid: condition at the moment of the rename. Of several processes that write files of one folder
            with a condition, one at a time checks and renames, as far as the file system has locks.
    """
    temporary = temporary_path(path)
    try:
        _write_new(temporary, content)
        if is_valid is None:
            os.replace(temporary, path)
            return True
        with exclusive_access(path.parent):
            if is_valid():
                os.replace(temporary, path)
                return True
            return False
    finally:
        temporary.unlink(missing_ok=True)


def write_files(folder: Path, files: Mapping[str, bytes], obsolete: Iterable[Path] = ()) -> tuple[Path, ...]:
    """Write several files into a folder, which is made if missing: all or none.

    All files are complete and flushed under temporary names before the first one is renamed; then the
    `obsolete` ones are removed. Renames follow the order of `files`, so the last file only ever appears
    beside complete ones. If a file cannot be written, everything that this call made is removed, folders
    included.

    Returns:
        The paths, in the order of `files`.

    Raises:
        OutputError: a file cannot be written.
    """
    temporary: dict[Path, Path] = {}
    created: list[Path] = []
    try:
        make_folder(folder, created)
        for name, content in files.items():
            temporary[folder / name] = temporary_path(folder / name)
            _write_new(temporary[folder / name], content)
        for path in obsolete:
            path.unlink(missing_ok=True)
        for path in temporary:
            os.replace(temporary[path], path)
            created.append(path)
    except BaseException as error:
        remove([*created, *temporary.values()])
        if isinstance(error, OSError):
            raise write_error(error, folder) from None
        raise
    return tuple(temporary)


def write_error(error: OSError, path: Path) -> OutputError:
    """The error to raise when the system refuses to write; `path` is named where the system names none."""
    return OutputError(f"{error.filename or path}: cannot be written ({error.strerror or error})")


@contextmanager
def write_errors(path: Path) -> Iterator[None]:
    """Raise `OutputError`, as of `write_error`, where the system refuses to write."""
    try:
        yield
    except OSError as error:
        raise write_error(error, path) from None


def make_folder(folder: Path, created: list[Path]) -> None:
    """Make a folder and its missing parents, and append those to `created`."""
    missing = [path for path in (folder, *folder.parents) if not path.exists()]
    for path in reversed(missing):
        path.mkdir(exist_ok=True)
        created.append(path)


def remove(created: Iterable[Path]) -> None:
    """Remove files and empty folders in the reverse of the given order, as far as they exist."""
    for path in reversed(list(created)):
        # Another process may have written into the folder.
        with suppress(OSError):
            path.rmdir() if path.is_dir() else path.unlink()


@contextmanager
def sole_writer(folder: Path) -> Iterator[None]:
    """Make a folder, and hold it until the block ends; a folder that stays empty is removed.

    Only where system and file system have locks for folders. A lock ends with its process.

    Raises:
        OutputError: another process is in this block for the same folder, or it cannot be made.
    """
    created: list[Path] = []
    try:
        make_folder(folder, created)
        with _lock(folder, 0.0) as is_free:
            if not is_free:
                raise OutputError(f"{folder}: another process is writing to it; choose another folder")
            yield
    except OSError as error:
        raise write_error(error, folder) from None
    finally:
        # Those with files stay.
        remove(created)


@contextmanager
def exclusive_access(folder: Path) -> Iterator[None]:
    """Wait until no other process is in this block for the same folder, at most a minute.

    Only where system and file system have locks for folders. A lock ends with its process.
    """
    with _lock(folder, _LOCK_S):
        yield


@contextmanager
def _lock(folder: Path, wait_s: float) -> Iterator[bool]:
    """Hold the lock of a folder; yields False if another process still holds it after `wait_s`."""
    try:
        import fcntl
    except ImportError:
        # Windows has no such locks.
        yield True
        return
    descriptor, end = os.open(folder, os.O_RDONLY), time.monotonic() + wait_s
    try:
        is_free = False
        while not is_free:
            try:
                fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
                is_free = True
            except BlockingIOError:
                if time.monotonic() >= end:
                    break
                time.sleep(_LOCK_INTERVAL_S)
            except OSError:
                # The file system has no locks.
                is_free = True
        yield is_free
    finally:
        os.close(descriptor)


def check_can_create(folder: Path, *, is_data_set: bool = False) -> None:
    """Raise `OutputError` if a folder cannot be made, or nothing can be written into it.

    Args:
        folder: which may be missing.
        is_data_set: whether it is the folder of a data set that is built; other results are not written into
            a data set.
    """
    if "\0" in str(folder):
        raise OutputError(f"{str(folder)!r}: is not a valid folder name")
    try:
        if not is_data_set:
            _check_outside_data_sets(folder)
        if folder.exists() and not folder.is_dir():
            raise OutputError(f"{folder}: is not a folder")
        parent = next(path for path in (folder, *folder.absolute().parents) if path.exists())
        if not parent.is_dir():
            raise OutputError(f"{folder}: cannot be made, because {parent} is not a folder")
        if not os.access(parent, os.W_OK | os.X_OK):
            raise OutputError(f"{folder}: is not writable")
    except OSError as error:
        raise OutputError(f"{folder}: cannot be used ({error.strerror})") from None


def _check_outside_data_sets(folder: Path) -> None:
    """Raise `OutputError` if a folder is that of a data set, or inside one."""
    resolved = folder.resolve()
    for path in (resolved, *resolved.parents):
        if all((path / name).exists() for name in _DATA_SET_FILES):
            raise OutputError(f"{folder}: is inside the data set {path}; choose another folder")


def check_can_write(folder: Path, names: Iterable[str]) -> None:
    """Raise `OutputError` if files of these names cannot be written into a folder, which may be missing."""
    check_can_create(folder)
    for path in (folder / name for name in names):
        try:
            is_folder = path.is_dir()
        except OSError as error:
            raise write_error(error, path) from None
        if "\0" in path.name:
            raise OutputError(f"{str(path)!r}: is not a valid file name")
        if is_folder:
            raise OutputError(f"{path}: is a folder, but a file is to be written there")


def write_json(path: Path, content: Any) -> None:
    """Write canonical JSON atomically."""
    write_file(path, canonical_json(content))


def canonical_json(content: Any) -> bytes:
    """JSON text that is the same for the same content: sorted keys, one line per entry on the top two levels.

    Raises `ValueError` if the content holds a number that JSON cannot represent (nan, inf).
    """
    return (_json_lines(content, _LINE_LEVELS) + "\n").encode()


def _json_lines(value: Any, levels: int) -> str:
    """Format some levels in lines, the rest by Python's encoder, which is fast without line breaks."""
    if levels and isinstance(value, dict) and value:
        entries = [f"{_dumps(str(key))}: {_json_lines(value[key], levels - 1)}" for key in sorted(value)]
        return "{\n" + ",\n".join(entries) + "\n}"
    if levels and isinstance(value, list) and value and isinstance(value[0], dict):
        return "[\n" + ",\n".join(_dumps(entry) for entry in value) + "\n]"
    return _dumps(value)


def plain_values(value: Any) -> Any:
    """Nested data with Python's own types, and None for numbers that JSON cannot represent."""
    if hasattr(value, "tolist"):  # an array of NumPy, or one of its numbers
        return plain_values(value.tolist())
    if isinstance(value, Mapping):
        return {str(key): plain_values(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain_values(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def digest(path: Path, kind: FileKind = "values", *, within: Path | None = None) -> str:
    """SHA-256 of a file, hexadecimal; arguments and errors are those of `open_file`."""
    with open_file(path, kind, within=within) as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def temporary_path(path: Path) -> Path:
    """A new random name beside a path, with the machine and the process that write it."""
    token = secrets.token_hex(_RANDOM_BYTES)
    return path.with_name(f".{path.name}.{_host_name()}.{os.getpid()}.{token}.tmp")


def is_temporary(path: Path) -> bool:
    """Whether a file is one of `atomic_write`'s, of a running build or left by a killed one."""
    return path.name.startswith(".") and path.name.endswith(".tmp")


def visible_names(folder: Path) -> list[str]:
    """The sorted names in a folder, without temporary files and those that file managers write."""
    return sorted(
        path.name for path in folder.iterdir() if not is_temporary(path) and path.name not in SYSTEM_FILES
    )


def remove_temporary_files(folder: Path, name: str = "") -> None:
    """Remove the temporary files and folders that killed processes left in a folder.

    With a `name`, only those that were to become the file or folder of this name.
    """
    for path in folder.iterdir():
        if is_temporary(path) and path.name.startswith(f".{name}"):
            with suppress(FileNotFoundError):
                if path.is_dir() and not path.is_symlink():
                    # A process that runs may not touch its folder for hours.
                    if _is_orphan(path):
                        shutil.rmtree(path)
                elif _is_orphan(path) or time.time() - path.stat().st_mtime > _STALE_S:
                    path.unlink()


def _is_orphan(path: Path) -> bool:
    """Whether a temporary file was made by a process of this machine that has ended."""
    match = _TEMPORARY_NAME.search(path.name)
    # On other systems signal 0 would end the process.
    if os.name != "posix" or match is None or match["host"] != _host_name():
        return False
    try:
        os.kill(int(match["process"]), 0)
    except ProcessLookupError:
        return True
    except OSError:
        pass
    return False


def _write_new(path: Path, content: bytes) -> None:
    """Write a file that must not exist, and flush it to the disk.

    So a link that another user has put there is not followed.
    """
    with path.open("xb", buffering=0) as file:
        view = memoryview(content)
        while view:
            view = view[file.write(view) :]
        os.fsync(file.fileno())


@cache
def _host_name() -> str:
    """This machine's name, reduced to characters that file names may have."""
    return re.sub(r"[^A-Za-z0-9-]", "-", platform.node()) or "unnamed"


def _as_python(value: Any) -> Any:
    """NumPy scalars and arrays as Python values."""
    if hasattr(value, "tolist"):
        return value.tolist()
    raise TypeError(f"{type(value).__name__} cannot be written as JSON")


_dumps: Final = json.JSONEncoder(sort_keys=True, allow_nan=False, default=_as_python).encode
