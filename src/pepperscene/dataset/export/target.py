"""The folder that an export makes: whole, or not there at all."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from pepperscene.dataset.folder import LITTER, examine_place, make_folder, remove
from pepperscene.errors import OutputError


@contextmanager
def new_folder(out: Path, source: Path) -> Iterator[Path]:
    """A temporary folder that becomes `out` when the block ends well, and is removed when it does not.

    It lies beside `out`. Where `out` is there already (and empty) it lies inside, and its content moves up: a
    mounted folder can be filled but not replaced. All is on the disk before the name is.

    Args:
        out: a new folder, or an empty one.
        source: of the data set, which takes no foreign folder inside.

    Raises:
        OutputError: `out` holds something, lies inside the data set, or cannot be written to; or there is no
            room left.
    """
    examine_place(out)
    made: list[Path] = []
    try:
        _examine(out, source)
        name = f".{out.resolve().name}.{os.getpid()}.tmp"
        temporary = out / name if out.is_dir() else out.absolute().with_name(name)
        try:
            make_folder(temporary.parent, made)
            shutil.rmtree(temporary, ignore_errors=True)
            temporary.mkdir()
            yield temporary
            _flush()
            _put(temporary, out)
        except BaseException:
            shutil.rmtree(temporary, ignore_errors=True)
            remove(made)
            raise
    except OSError as fault:
        raise OutputError(f"{out}: cannot be written ({fault.strerror or fault})") from None


def _examine(out: Path, source: Path) -> None:
    if out.resolve().is_relative_to(source.resolve()):
        raise OutputError(f"{out}: lies inside the data set {source}; choose a folder elsewhere")
    held = sorted(path.name for path in out.iterdir() if path.name not in LITTER) if out.is_dir() else []
    if held:
        raise OutputError(f"{out}: holds {held[0]!r}; choose an empty or a new folder")


def _put(temporary: Path, out: Path) -> None:
    """Give what is finished its name."""
    if not out.is_dir():
        os.rename(temporary, out)
        return
    for path in sorted(temporary.iterdir()):
        os.rename(path, out / path.name)
    temporary.rmdir()


def _flush() -> None:
    """Have the disk hold what has been written, by one call: one for each of 100,000 files takes minutes."""
    if hasattr(os, "sync"):
        os.sync()
