"""The output folder of a build: checks, creation, and cleanup after a failure."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, Final

from pepperscene.atomic import check_can_create, remove, remove_temporary_files, visible_names, write_json
from pepperscene.dataset.store.dataset import FRAMES, MARK, Dataset
from pepperscene.dataset.store.frame_json import CHECKSUM, checksum_of, is_as_written, read_json
from pepperscene.dataset.store.journal import JOURNAL
from pepperscene.dataset.store.manifest import FRUIT, MANIFEST
from pepperscene.errors import InputError, OutputError, short_repr
from pepperscene.outputs import OUTPUTS
from pepperscene.user_files import check_inside

SET_FILES: Final = (MARK, MANIFEST, FRUIT, JOURNAL, FRAMES, *OUTPUTS)
REPORT_FILES: Final = ("index.html", "contact_sheet.png")

_COMPARED: Final = ("format", "quality", "version", "recipe", "files")
_MAX_DIFFERENCES: Final = 4  # chosen: listed in a message


class OutputFolder:
    """The folder of a build, untouched until the first frame is ready.

    Args:
        folder: of the data set; `check_output_folder` accepts it.
        info: content of its `dataset.json`, without the checksum.
    """

    def __init__(self, folder: Path, info: Mapping[str, Any]) -> None:
        self.dataset = Dataset(folder, {**info, CHECKSUM: checksum_of(info)})
        paths = [*reversed(folder.parents), folder, *(folder / name for name in SET_FILES)]
        self._missing = [path for path in paths if not path.exists()]

    def prepare(self, outputs: tuple[str, ...]) -> None:
        """Make missing folders and `dataset.json`; other processes may do so at the same time."""
        self.dataset.folder.mkdir(parents=True, exist_ok=True)
        if not (self.dataset.folder / MARK).exists():
            write_json(self.dataset.folder / MARK, self.dataset.info)
        for name in (*outputs, FRAMES):
            (self.dataset.folder / name).mkdir(exist_ok=True)
        self.remove_temporary_files()

    def remove_temporary_files(self) -> None:
        """Remove the temporary files that lost workers left."""
        for folder in (self.dataset.folder / name for name in ("", FRAMES, *OUTPUTS)):
            if folder.is_dir():
                remove_temporary_files(folder)

    def lost_frames(self, indices: Iterable[int], outputs: tuple[str, ...]) -> list[int]:
        """Those of some complete frames of which a file does not exist any more."""
        existing = set(self.dataset.indices())
        return [
            index
            for index in indices
            if index not in existing or not all(self.dataset.path(index, name).is_file() for name in outputs)
        ]

    def undo(self) -> None:
        """Remove what was made since this object was created, by any process, unless there is a frame."""
        if not self.dataset.indices():
            remove(self._missing)


def check_output_folder(folder: Path, info: Mapping[str, Any]) -> None:
    """Raise `OutputError` if a folder, which may be missing, cannot take the data set of a `dataset.json`."""
    check_can_create(folder, is_data_set=True)
    try:
        if folder.exists():
            _check_content(folder, info)
    except OSError as error:
        raise OutputError(f"{folder}: cannot be used ({error.strerror})") from None


def _check_content(folder: Path, info: Mapping[str, Any]) -> None:
    names = visible_names(folder)
    unexpected = next((name for name in names if name not in (*SET_FILES, *REPORT_FILES)), None)
    if unexpected is not None or (names and not (folder / MARK).is_file()):
        raise OutputError(
            f"{folder}: holds {unexpected or names[0]!r}, so it is not a data set; "
            "choose an empty or a new folder"
        )
    if not names:
        return
    try:
        for name in names:
            check_inside(folder / name, folder)
    except InputError as error:
        raise OutputError(str(error)) from None
    try:
        existing = read_json(folder / MARK, within=folder)
    except InputError as error:
        raise OutputError(f"{error}; restore that file from a copy, or choose another folder") from None
    # Sets of other formats may have no checksum, and are refused below.
    is_checked = CHECKSUM in existing or existing.get("format") == info["format"]
    if is_checked and not is_as_written(existing):
        problem = "is damaged; restore that file from a copy, or choose another folder"
        raise OutputError(f"{folder / MARK}: {problem}")
    differences = [text for name in _COMPARED for text in _differences(name, existing.get(name), info[name])]
    if differences:
        more = len(differences) - _MAX_DIFFERENCES
        listing = ", ".join(differences[:_MAX_DIFFERENCES]) + (f", and {more} more" if more > 0 else "")
        raise OutputError(f"{folder}: holds another data set: {listing}; choose another folder")


def _differences(key: str, existing: Any, expected: Any) -> list[str]:
    """The dotted keys that differ, with both values."""
    if isinstance(existing, dict) and isinstance(expected, dict):
        return [
            text
            for name in sorted(existing.keys() | expected.keys())
            for text in _differences(f"{key}.{name}", existing.get(name), expected.get(name))
        ]
    if existing == expected:
        return []
    return [f"{key} is {short_repr(existing)} there and {short_repr(expected)} here"]
