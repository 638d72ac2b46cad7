"""The output folder of a build: can it take the data set; making it; leaving no trace on failure."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

from pepperscene.dataset.store.atomic import is_temporary, sweep, write_json
from pepperscene.dataset.store.dataset import FRAMES, MARK, Dataset, read_json
from pepperscene.dataset.store.journal import JOURNAL
from pepperscene.dataset.store.manifest import FRUIT, MANIFEST
from pepperscene.errors import InputError, OutputError
from pepperscene.frame import OUTPUTS

REPORT_FILES: Final = ("index.html", "contact_sheet.png")
OWN: Final = frozenset({MARK, FRAMES, MANIFEST, FRUIT, JOURNAL, *OUTPUTS, *REPORT_FILES})
"""What a data set's folder holds."""

LITTER: Final = frozenset({".DS_Store", "Thumbs.db"})
"""Written by file managers into every folder that they show."""

_COMPARED: Final = ("format", "quality", "version", "recipe", "files")
_MOST_DIFFERENCES: Final = 4  # chosen: that a message tells


class OutputFolder:
    """The folder of a build, not touched until the first frame is ready.

    Args:
        folder: wanted by the user; `examine` tells whether it will do.
        about: what `dataset.json` is to say.
    """

    def __init__(self, folder: Path, about: Mapping[str, Any]) -> None:
        self.dataset = Dataset(folder, about)
        self._missing = [path for path in self._ours() if not path.exists()]

    def prepare(self, outputs: tuple[str, ...]) -> None:
        """Make the folders and `dataset.json` where they are missing; others may do so at the same time.

        Raises:
            OSError: something cannot be made.
        """
        self.dataset.folder.mkdir(parents=True, exist_ok=True)
        mark = self.dataset.folder / MARK
        if not mark.is_file():
            write_json(mark, self.dataset.info)
        for folder in (self.dataset.folder / name for name in (*outputs, FRAMES)):
            folder.mkdir(exist_ok=True)
        self.sweep()

    def sweep(self) -> None:
        """Remove what workers that were lost have left."""
        for name in ("", FRAMES, *OUTPUTS):
            folder = self.dataset.folder / name
            if folder.is_dir():
                sweep(folder)

    def undo(self) -> None:
        """Remove what was made since, by whomever, as far as no frame has come to depend on it."""
        if not self.dataset.indices():
            remove(self._missing)

    def _ours(self) -> list[Path]:
        """All that a build may make but for frames, outer folders first."""
        folder = self.dataset.folder
        inside = (MARK, MANIFEST, FRUIT, JOURNAL, FRAMES, *OUTPUTS)
        return [*reversed(folder.parents), folder, *(folder / name for name in inside)]


def check_output_folder(folder: Path, about: Mapping[str, Any]) -> None:
    """Raise the `OutputError` that tells why the folder cannot take this data set, if there is a reason.

    Args:
        folder: of the data set; it need not be there.
        about: what its `dataset.json` is to say.
    """
    check_can_create(folder)
    try:
        if folder.exists():
            _examine_content(folder, about)
    except OSError as fault:
        raise OutputError(f"{folder}: cannot be used ({fault.strerror})") from None


def check_can_create(folder: Path) -> None:
    """Raise the `OutputError` that tells why there cannot be a folder, or nothing written into it."""
    if "\0" in str(folder):
        raise OutputError(f"{str(folder)!r}: is not a possible name of a folder")
    try:
        if folder.exists() and not folder.is_dir():
            raise OutputError(f"{folder}: is not a folder")
        standing = next(path for path in (folder, *folder.absolute().parents) if path.exists())
        if not standing.is_dir():
            raise OutputError(f"{folder}: cannot be made, because {standing} is not a folder")
        if not os.access(standing, os.W_OK | os.X_OK):
            raise OutputError(f"{folder}: is not writable")
    except (OSError, ValueError) as fault:
        reason = fault.strerror if isinstance(fault, OSError) else str(fault)
        raise OutputError(f"{folder}: cannot be used ({reason})") from None


def make_folder(folder: Path, made: list[Path]) -> None:
    """Make a folder and those above it where they are missing, and note those that were made.

    Raises:
        OSError: one cannot be made.
    """
    missing = [path for path in (folder, *folder.parents) if not path.exists()]
    for path in reversed(missing):
        path.mkdir(exist_ok=True)
        made.append(path)


def remove(made: list[Path]) -> None:
    """Remove files and empty folders in the reverse of the order in which they were made."""
    for path in reversed(made):
        try:
            path.rmdir() if path.is_dir() else path.unlink(missing_ok=True)
        except OSError:
            # Somebody else put a file there meanwhile.
            continue


def _examine_content(folder: Path, about: Mapping[str, Any]) -> None:
    held = sorted(path for path in folder.iterdir() if not is_temporary(path) and path.name not in LITTER)
    foreign = next((path.name for path in held if path.name not in OWN), None)
    if foreign is not None or (held and not (folder / MARK).is_file()):
        what = foreign or held[0].name
        raise OutputError(
            f"{folder}: holds {what!r}, so it is not a data set; choose an empty or a new folder"
        )
    if not held:
        return
    try:
        there = read_json(folder / MARK)
    except InputError as fault:
        raise OutputError(f"{fault}; choose another folder") from None
    differences = [
        difference for name in _COMPARED for difference in _differences(name, there.get(name), about[name])
    ]
    if differences:
        more = len(differences) - _MOST_DIFFERENCES
        told = ", ".join(differences[:_MOST_DIFFERENCES]) + (f", and {more} more" if more > 0 else "")
        raise OutputError(f"{folder}: holds another data set: {told}; choose another folder")


def _differences(key: str, there: Any, wanted: Any) -> list[str]:
    """The dotted keys that differ, with both values."""
    if isinstance(there, dict) and isinstance(wanted, dict):
        return [
            found
            for name in sorted(there.keys() | wanted.keys())
            for found in _differences(f"{key}.{name}", there.get(name), wanted.get(name))
        ]
    return [] if there == wanted else [f"{key} is {there!r} there and {wanted!r} here"]
