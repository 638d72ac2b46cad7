"""Checks of a data set as a whole: its files and tables, duplicate frames, and statistics out of range."""

from __future__ import annotations

import math
import os
from collections.abc import Iterator, Sequence
from itertools import groupby
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.atomic import SYSTEM_FILES, is_temporary
from pepperscene.classes import OrganClass
from pepperscene.dataset.store.dataset import FORMAT, FRAMES, MARK, Dataset, file_name
from pepperscene.dataset.store.fields import DatasetFields
from pepperscene.dataset.store.folder import REPORT_FILES, SET_FILES
from pepperscene.dataset.store.frame_json import DIGITS, frame_index, is_as_written, read_json
from pepperscene.dataset.store.manifest import (
    FRUIT,
    MANIFEST,
    Row,
    open_table_file,
    table_columns,
    table_schema,
)
from pepperscene.document import validate
from pepperscene.errors import InputError, short_repr
from pepperscene.outputs import OUTPUTS
from pepperscene.recipe.recipe import digest
from pepperscene.recipe.tables import ExpectTable
from pepperscene.review.check.findings import Finding
from pepperscene.review.check.one_frame import FrameTraits, fruit_digest, row_digest


def open_leniently(folder: Path) -> tuple[Dataset, list[Finding]]:
    """The data set in a folder, and the problem of its `dataset.json`, if any; its `info` is empty then."""
    if not (folder / MARK).exists() and not (folder / FRAMES).is_dir():
        raise InputError(folder, f"holds no data set: there is no {MARK} in it")
    try:
        info = read_json(folder / MARK, within=folder)
        if info.get("format") != FORMAT:
            raise InputError("", f"has format = {short_repr(info.get('format'))}, must be {FORMAT!r}")
        if not is_as_written(info):
            raise InputError("", "is not what was written: its checksum differs")
        if info.get("recipe_sha256") != digest({name: info.get(name) for name in ("recipe", "files")}):
            raise InputError("", "is not what was written: the recipe's checksum differs")
        validate(DatasetFields, info, "")
    except InputError as error:
        return Dataset(folder, {}), [Finding("damaged", None, MARK, error.detail)]
    return Dataset(folder, info), []


def stray_files(dataset: Dataset, indices: Sequence[int]) -> Iterator[Finding]:
    """Yield files that belong to no frame, from other programs or killed builds."""
    known = set(indices)
    for entry in sorted(os.scandir(dataset.folder), key=lambda entry: entry.name):
        if entry.name not in (*SET_FILES, *REPORT_FILES, *SYSTEM_FILES):
            yield _stray_file(entry)
        elif entry.name == FRAMES or entry.name in OUTPUTS:
            if not entry.is_dir():
                yield Finding("extra", None, entry.name, "is a file, but must be a folder")
                continue
            suffix = ".json" if entry.name == FRAMES else OUTPUTS[entry.name].suffix
            for file in os.scandir(entry):
                index = frame_index(file.name, suffix)
                if file.name not in SYSTEM_FILES and index not in known:
                    yield _stray_file(file, f"{entry.name}/", index)


def _stray_file(entry: os.DirEntry[str], folder: str = "", index: int | None = None) -> Finding:
    problem = "does not belong to a data set"
    if is_temporary(Path(entry.path)):
        problem = "is a temporary file of a build that was killed or still runs"
    elif index is not None:
        problem = "belongs to no frame: its JSON does not exist"
    # File systems allow names that are not text.
    name = entry.name.encode(errors="backslashreplace").decode()
    return Finding("extra", index, folder + name, problem)


def check_tables(dataset: Dataset, frames: Sequence[FrameTraits]) -> Iterator[Finding]:
    """Yield the problems of the tables of a data set, compared with its frames."""
    checks = {MANIFEST: _check_manifest, FRUIT: _check_fruit}
    for name, check in checks.items():
        if (dataset.folder / name).exists():
            yield from _check_readable(name, check(dataset, frames))
        elif name == MANIFEST or any(frame.has_harvest for frame in frames):
            yield Finding("missing", None, name, "does not exist; the same build command writes it again")


def _check_readable(name: str, findings: Iterator[Finding]) -> Iterator[Finding]:
    """The findings of a table, the last one of which is that it cannot be read to its end."""
    from pyarrow import ArrowException

    try:
        yield from findings
    except InputError as error:
        yield Finding("damaged", None, name, error.problem)
    except (OSError, ArrowException, LookupError, ValueError, TypeError, MemoryError) as error:
        reason = " ".join(str(error).split()) or type(error).__name__
        yield Finding("damaged", None, name, f"cannot be read ({reason[:80]})")


def _check_manifest(dataset: Dataset, frames: Sequence[FrameTraits]) -> Iterator[Finding]:
    expected, columns = {frame.index: frame.row for frame in frames}, table_columns(MANIFEST, dataset.info)
    for row in _read_rows(dataset, MANIFEST):
        index = int(row["index"])
        if index not in expected:
            problem = "has a row for this frame, whose JSON does not exist"
            yield Finding("incomplete", index, MANIFEST, problem)
        elif expected.pop(index) not in (0, row_digest(row, columns)):
            yield Finding("contradiction", index, MANIFEST, "disagrees with the JSON of this frame")
    for index, row_of_frame in expected.items():
        if row_of_frame:
            yield Finding("contradiction", index, MANIFEST, "has no row for this frame")


def _check_fruit(dataset: Dataset, frames: Sequence[FrameTraits]) -> Iterator[Finding]:
    groups = groupby(_read_rows(dataset, FRUIT), lambda row: int(row["index"]))
    found = {index: fruit_digest(group) for index, group in groups}
    expected, nothing = {frame.index: frame.fruit for frame in frames}, fruit_digest(())
    for index in sorted(found.keys() | expected.keys()):
        if expected.get(index, nothing) not in (0, found.get(index, nothing)):
            yield Finding("contradiction", index, FRUIT, "disagrees with the harvest of this frame")


def _read_rows(dataset: Dataset, name: str) -> Iterator[Row]:
    """The rows of a table, of which some thousand are in memory at a time."""
    from pyarrow import parquet

    with (
        open_table_file(dataset.folder / name, dataset.folder) as content,
        parquet.ParquetFile(content, page_checksum_verification=True) as file,
    ):
        if not file.schema_arrow.equals(table_schema(table_columns(name, dataset.info))):
            raise ValueError("it has other columns than this version writes")
        for batch in file.iter_batches(4096):
            yield from batch.to_pylist()


_DUPLICATES: Final = {
    "photo": "has the same photograph as frame {}",
    "content": "has the same images as frame {}",
    "view": "has the pose and seed of frame {}",
}
"""Traits in which two frames must differ; a frame is reported for the first of them only."""


def duplicates(frames: Sequence[FrameTraits]) -> Iterator[Finding]:
    """Yield frames that repeat an earlier one, each once."""
    reported = set[int]()
    for trait, problem in _DUPLICATES.items():
        first: dict[int, int] = {}
        for frame in frames:
            value = getattr(frame, trait)
            earlier = first.setdefault(value, frame.index)
            if value and earlier != frame.index and frame.index not in reported:
                reported.add(frame.index)
                file = f"{FRAMES}/{frame.index:0{DIGITS}d}.json"
                yield Finding("duplicate", frame.index, file, problem.format(earlier))


STATISTICS: Final = (*(organ.name.lower() for organ in OrganClass), "intensity")
"""The pixel fraction of each class, and the mean grey value of the photograph."""

_STANDARD_ERRORS: Final = 3.0
"""Chosen: by which the mean of a part of a plan must leave the range of the whole."""
_MIN_SCENES: Final = 4  # chosen: with fewer, a part of a plan is not judged


def describe_statistic(name: str) -> str:
    """One of `STATISTICS` in words."""
    return "mean grey value" if name == "intensity" else f"pixel fraction of {name}"


def known_values(
    frames: Sequence[FrameTraits], name: str
) -> tuple[NDArray[np.float64], NDArray[np.int64], NDArray[np.float64]]:
    """The known values of one of `STATISTICS`, the scenes of these frames, and the mean of each scene."""
    if name == "intensity":
        known = [(frame.scene, frame.mean) for frame in frames if frame.mean is not None]
    else:
        organ = STATISTICS.index(name)
        known = [(frame.scene, frame.fractions[organ]) for frame in frames if frame.fractions is not None]
    values = np.array([value for _, value in known], float)
    scenes, inverse = np.unique(np.array([scene for scene, _ in known], np.int64), return_inverse=True)
    return values, scenes, np.bincount(inverse, values) / np.bincount(inverse)


def check_expectations(frames: Sequence[FrameTraits], expect: ExpectTable, whole: bool) -> Iterator[Finding]:
    """Yield frames, and means of the set, that are outside the ranges that the recipe expects.

    Args:
        frames: of the set.
        expect: the expectations.
        whole: whether all frames of the plan exist; otherwise sampling error of means is allowed for.
    """
    for frame in frames:
        yield from _check_photo(frame, expect)
    ranges = dict(expect.share)
    if expect.intensity is not None:
        ranges["intensity"] = expect.intensity
    for name, (low, high) in ranges.items():
        values, _, scene_means = known_values(frames, name)
        if len(values) == 0:
            continue
        mean, tolerance = values.mean(), 0.0
        if not whole:
            # The standard error from scene to scene: the frames of a scene show the same plants.
            too_few = len(scene_means) < _MIN_SCENES
            error = math.inf if too_few else scene_means.std(ddof=1) / math.sqrt(len(scene_means))
            tolerance = _STANDARD_ERRORS * error
        if not low - tolerance <= mean <= high + tolerance:
            text = f"{mean:.4g} over {len(values)} frames, expected {low:g} to {high:g}"
            yield Finding("drift", None, "", f"the {describe_statistic(name)} is {text}")


def _check_photo(frame: FrameTraits, expect: ExpectTable) -> Iterator[Finding]:
    if frame.mean is None:
        return
    file = file_name(frame.index, "colour")
    if expect.frame_intensity is not None:
        low, high = expect.frame_intensity
        if not low <= frame.mean <= high:
            problem = f"has the mean grey value {frame.mean:.4g}, expected {low:g} to {high:g}"
            yield Finding("drift", frame.index, file, problem)
    limit = expect.saturated
    if limit is not None and frame.saturated > limit:
        problem = f"{frame.saturated:.1%} of its pixels have a channel at 255, expected at most {limit:.1%}"
        yield Finding("drift", frame.index, file, problem)
