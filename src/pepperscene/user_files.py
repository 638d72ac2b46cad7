"""The one reader of the files of users: regular files of a limited length, wherever they are.

A name in a recipe or a data set may be that of a device or a pipe, which never end or wait for ever, of a
file without limit, or of a link that leads out of a data set. So every module that reads a file opens it
here.

A link is followed where a user names the file. In a data set, which may come from anybody, it is followed
only to a file inside the folder of the set; `within` is that folder.
"""

from __future__ import annotations

import errno
import os
import stat
from collections.abc import Mapping
from io import BufferedReader
from pathlib import Path
from typing import Final, Literal

from pepperscene.errors import InputError
from pepperscene.interrupts import raise_if_interrupted

FileKind = Literal[
    "text", "spectra", "calibration", "poses", "json", "annotations", "journal", "table", "log", "image",
    "values", "mesh", "weights", "cache",
]  # fmt: skip

MOST_BYTES: Final[Mapping[FileKind, int]] = {
    "text": 4_000_000,  # TOML, CSV and Python; 200,000 numbers with all digits, the most in one list
    "spectra": 10_000_000,  # 500 spectra of 2,151 bands, those of a field spectrometer, with eight digits
    "calibration": 300_000,  # they have a few thousand, and 100,000 with the corners of all views
    "poses": 50_000_000,  # 100,000 poses, the most that are read, as indented JSON with all digits
    "json": 16_000_000,  # of a frame; the labels of 65,535 instances, the most of a frame, have 10 million
    "annotations": 500_000_000,  # COCO's own largest file of instances has 448 million
    "journal": 4_000_000_000,  # a million frames, the most of a set, with two thousand each, twice
    "table": 4_000_000_000,  # a million frames with two thousand each, and as much again
    "log": 100_000_000,  # a million lines, one for each step
    "image": 1_000_000_000,  # 20,000 x 15,000 pixels of three bytes without compression
    "values": 8_000_000_000,  # an image of 32-bit values with as many pixels and six channels
    "mesh": 200_000_000,  # a million triangles with colours and textures
    "weights": 4_000_000_000,  # a billion weights of four bytes; the shipped networks have up to 65 million
    "cache": 8_000_000_000,  # of the user's own earlier calls; sums of images of 64-bit values
}
"""Most bytes of a file of each kind. All are chosen: above what this program and others write, as stated."""

_FLAGS: Final = (
    os.O_RDONLY | getattr(os, "O_BINARY", 0) | getattr(os, "O_NOCTTY", 0) | getattr(os, "O_NONBLOCK", 0)
)
"""Without waiting for the other end of a pipe."""

_NO_LINK: Final = getattr(os, "O_NOFOLLOW", 0)
_KINDS: Final = (
    (stat.S_ISCHR, "a device"),
    (stat.S_ISBLK, "a device"),
    (stat.S_ISFIFO, "a pipe"),
    (stat.S_ISSOCK, "a socket"),
)


class MissingFileError(InputError):
    """A file does not exist."""


def open_file(path: Path, kind: FileKind, *, within: Path | None = None) -> BufferedReader:
    """Open a regular file for reading.

    Args:
        path: of the file.
        kind: of its content; the file has at most `MOST_BYTES[kind]` bytes.
        within: folder of the data set that the file belongs to, which no link may leave; None if a user named
            the file.

    Raises:
        MissingFileError: there is no such file.
        InputError: it cannot be read, is a device, pipe, socket or folder, is too long, or outside `within`.
    """
    # All commands that read many files can be interrupted here.
    raise_if_interrupted()
    try:
        return _open(path, kind, within)
    except (FileNotFoundError, NotADirectoryError) as error:
        raise MissingFileError(path, f"cannot be read ({error.strerror})") from None
    except OSError as error:
        raise InputError(path, f"cannot be read ({error.strerror or error})") from None
    except ValueError as error:
        # A path that no file system accepts.
        raise InputError(repr(str(path)), f"cannot be read ({error})") from None


def read_file(path: Path, kind: FileKind, *, within: Path | None = None) -> bytes:
    """The content of a regular file; arguments and errors are those of `open_file`."""
    with open_file(path, kind, within=within) as file:
        try:
            # Another program may be appending to it.
            content = file.read(MOST_BYTES[kind] + 1)
        except OSError as error:
            raise InputError(path, f"cannot be read ({error.strerror or error})") from None
        except MemoryError:
            raise InputError(path, "does not fit into the memory") from None
    if len(content) > MOST_BYTES[kind]:
        raise _too_long(path, kind)
    return content


def check_file(path: Path, kind: FileKind, *, within: Path | None = None) -> Path:
    """The same file, without links, for a library that opens files by their names only.

    Arguments and errors are those of `open_file`.
    """
    open_file(path, kind, within=within).close()
    return Path(os.path.realpath(path))


def check_inside(path: Path, within: Path) -> None:
    """Raise `InputError` if a link in a path of a data set leads out of the set's folder `within`."""
    target, folder = os.path.realpath(path), os.path.realpath(within)
    if os.path.commonpath((target, folder)) != folder:
        problem = f"leads out of the data set, to {target}; links in it must lead to files inside its folder"
        raise InputError(path, problem)


def _open(path: Path, kind: FileKind, within: Path | None) -> BufferedReader:
    flags = _FLAGS
    target: str | Path = path
    if within is not None:
        check_inside(path, within)
        target, flags = os.path.realpath(path), flags | _NO_LINK
    # Opening a device can act on it, so its kind is checked before, and again on what was opened.
    _check_kind(os.stat(target), path)
    file = open(path, "rb", opener=lambda *_: os.open(target, flags))  # noqa: SIM115
    try:
        status = os.fstat(file.fileno())
        _check_kind(status, path)
        if status.st_size > MOST_BYTES[kind]:
            raise _too_long(path, kind)
        # Files that the system makes up while they are read, as in /proc, have no length.
        if status.st_size == 0 and os.read(file.fileno(), 1):
            raise InputError(path, "must be a regular file, not one of the system's own")
    except BaseException:
        file.close()
        raise
    return file


def _check_kind(status: os.stat_result, path: Path) -> None:
    if stat.S_ISDIR(status.st_mode):
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR))
    name = next((name for is_kind, name in _KINDS if is_kind(status.st_mode)), "of another kind")
    if not stat.S_ISREG(status.st_mode):
        raise InputError(path, f"must be a regular file, but is {name}")


def _too_long(path: Path, kind: FileKind) -> InputError:
    return InputError(
        path, f"is longer than {MOST_BYTES[kind]:,} bytes, the most that is read of such a file"
    )
