"""Which files a data set has, against which it should have."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from pepperscene.dataset.check.findings import Finding
from pepperscene.dataset.check.one_frame import manifest_digest
from pepperscene.dataset.recipe.recipe import digest
from pepperscene.dataset.store.atomic import is_temporary
from pepperscene.dataset.store.dataset import DIGITS, FORMAT, FRAMES, MARK, Dataset, read_json
from pepperscene.dataset.store.folder import LITTER, OWN
from pepperscene.dataset.store.manifest import FRUIT, MANIFEST
from pepperscene.errors import InputError
from pepperscene.frame import OUTPUTS


def frame_indices(dataset: Dataset) -> tuple[int, ...]:
    """The frames whose JSON is there, ascending; files of other names than builds give are none."""
    folder = dataset.folder / FRAMES
    names = (entry.name for entry in os.scandir(folder)) if folder.is_dir() else ()
    return tuple(sorted(int(stem) for stem in map(_stem, names) if stem is not None))


def _stem(name: str, suffix: str = ".json") -> str | None:
    """The six digits of a frame's file, None when it is not one."""
    stem = name.removesuffix(suffix)
    own = name.endswith(suffix) and len(stem) == DIGITS and stem.isascii() and stem.isdecimal()
    return stem if own else None


def opened(folder: Path) -> tuple[Dataset, list[Finding]]:
    """The data set in a folder, as far as its `dataset.json` can be read, and what is wrong with that.

    Raises:
        InputError: there is nothing of a data set in the folder.
    """
    if not (folder / MARK).exists() and not (folder / FRAMES).is_dir():
        raise InputError(folder, f"holds no data set: there is no {MARK} in it")
    try:
        about = read_json(folder / MARK)
    except InputError as fault:
        return Dataset(folder, {}), [Finding("damaged", None, MARK, fault.problem)]
    return Dataset(folder, about), [Finding("damaged", None, MARK, what) for what in _about_faults(about)]


def _about_faults(about: Mapping[str, Any]) -> Iterator[str]:
    if about.get("format") != FORMAT:
        yield f"says format = {about.get('format')!r}, which must be {FORMAT!r}"
    elif about.get("recipe_sha256") != digest({name: about.get(name) for name in ("recipe", "files")}):
        yield "is not what was written: the recipe's checksum is another"


def stray_files(dataset: Dataset, indices: Sequence[int]) -> Iterator[Finding]:
    """Files that belong to no frame of the data set: foreign ones, and those that a killed build left."""
    known = set(indices)
    for entry in sorted(os.scandir(dataset.folder), key=lambda one: one.name):
        if entry.name in LITTER:
            continue
        if entry.name not in OWN:
            yield Finding("extra", None, _printable(entry.name), _stray(entry))
        elif entry.name == FRAMES or entry.name in OUTPUTS:
            if entry.is_dir():
                suffix = ".json" if entry.name == FRAMES else OUTPUTS[entry.name].suffix
                yield from _stray_in(entry, suffix, known)
            else:
                yield Finding("extra", None, entry.name, "is a file where a folder should be")


def _stray_in(folder: os.DirEntry[str], suffix: str, known: set[int]) -> Iterator[Finding]:
    for entry in os.scandir(folder):
        stem = _stem(entry.name, suffix)
        if entry.name in LITTER or (stem is not None and int(stem) in known):
            continue
        name = f"{folder.name}/{_printable(entry.name)}"
        if stem is not None:
            yield Finding("extra", int(stem), name, "belongs to no frame: its JSON is not there")
        else:
            yield Finding("extra", None, name, _stray(entry))


def _printable(name: str) -> str:
    """A file's name, of which file systems allow bytes that are no text."""
    return name.encode(errors="backslashreplace").decode()


def _stray(entry: os.DirEntry[str]) -> str:
    if is_temporary(Path(entry.path)):
        return "is a temporary file, left by a build that was ended or still runs"
    return "does not belong to a data set"


_ROWS: Final = 4096  # chosen: rows that are held at a time


def manifest_faults(dataset: Dataset, rows: Mapping[int, int], harvested: bool) -> Iterator[Finding]:
    """What is wrong with the tables of a data set.

    Args:
        dataset: that they belong to.
        rows: digest of what the manifest must say of each frame.
        harvested: whether there must be a table of fruit.
    """
    from pyarrow import ArrowException, parquet

    left = dict(rows)
    try:
        with parquet.ParquetFile(dataset.folder / MANIFEST) as file:
            for batch in file.iter_batches(_ROWS):
                for row in batch.to_pylist():
                    yield from _row_faults(row, left)
    except FileNotFoundError:
        yield Finding("missing", None, MANIFEST, "is not there; the same build writes it again")
        return
    except (OSError, ArrowException, KeyError, ValueError) as fault:
        yield Finding("damaged", None, MANIFEST, f"cannot be read ({' '.join(str(fault).split())[:80]})")
        return
    for index in sorted(left):
        yield Finding("contradiction", index, MANIFEST, "has no row for this frame")
    if harvested and not (dataset.folder / FRUIT).is_file():
        yield Finding("missing", None, FRUIT, "is not there, though frames have the output harvest")


def _row_faults(row: Mapping[str, object], left: dict[int, int]) -> Iterator[Finding]:
    index = int(str(row["index"]))
    if index not in left:
        yield Finding("incomplete", index, MANIFEST, "has a row for this frame, whose JSON is not there")
    elif left.pop(index) != manifest_digest(row):
        yield Finding("contradiction", index, MANIFEST, "says otherwise of this frame than its JSON")
