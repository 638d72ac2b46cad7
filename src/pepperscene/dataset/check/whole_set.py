"""Checks of a data set as a whole: its files and tables, duplicate frames, and statistics out of range."""

from __future__ import annotations

import math
import os
from array import array
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from statistics import median, stdev
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.classes import OrganClass
from pepperscene.dataset.check.findings import Finding
from pepperscene.dataset.check.one_frame import FrameTraits, manifest_digest
from pepperscene.dataset.recipe.recipe import digest
from pepperscene.dataset.recipe.tables import ExpectTable
from pepperscene.dataset.store.atomic import is_temporary
from pepperscene.dataset.store.dataset import DIGITS, FORMAT, FRAMES, MARK, Dataset, file_name, read_json
from pepperscene.dataset.store.folder import LITTER, OWN
from pepperscene.dataset.store.manifest import FRUIT, MANIFEST
from pepperscene.errors import InputError
from pepperscene.frame import OUTPUTS


def frame_indices(dataset: Dataset) -> tuple[int, ...]:
    """Indices of the frames whose JSON exists, ascending; a build's file names have six digits."""
    folder = dataset.folder / FRAMES
    names = (entry.name for entry in os.scandir(folder)) if folder.is_dir() else ()
    return tuple(sorted(index for name in names if (index := _frame_index(name, ".json")) is not None))


def _frame_index(name: str, suffix: str) -> int | None:
    """Index of the frame of a file, None if it is not a frame's."""
    stem = name.removesuffix(suffix)
    is_frame = name.endswith(suffix) and len(stem) == DIGITS and stem.isascii() and stem.isdecimal()
    return int(stem) if is_frame else None


def open_leniently(folder: Path) -> tuple[Dataset, list[Finding]]:
    """The data set in a folder, as far as its `dataset.json` can be read, and the problems of that file.

    Raises:
        InputError: the folder holds no data set.
    """
    if not (folder / MARK).exists() and not (folder / FRAMES).is_dir():
        raise InputError(folder, f"holds no data set: there is no {MARK} in it")
    try:
        info = read_json(folder / MARK)
    except InputError as error:
        return Dataset(folder, {}), [Finding("damaged", None, MARK, error.problem)]
    problem = _info_problem(info)
    return Dataset(folder, info), [] if problem is None else [Finding("damaged", None, MARK, problem)]


def _info_problem(info: Mapping[str, Any]) -> str | None:
    if info.get("format") != FORMAT:
        return f"has format = {info.get('format')!r}, must be {FORMAT!r}"
    if info.get("recipe_sha256") != digest({name: info.get(name) for name in ("recipe", "files")}):
        return "is not what was written: the recipe's checksum differs"
    return None


def stray_files(dataset: Dataset, indices: Sequence[int]) -> Iterator[Finding]:
    """Yield files that belong to no frame: those of other programs, and those left by a killed build."""
    known = set(indices)
    for entry in sorted(os.scandir(dataset.folder), key=lambda entry: entry.name):
        if entry.name in LITTER:
            continue
        if entry.name not in OWN:
            yield Finding("extra", None, _printable(entry.name), _stray_problem(entry))
        elif entry.name == FRAMES or entry.name in OUTPUTS:
            if entry.is_dir():
                suffix = ".json" if entry.name == FRAMES else OUTPUTS[entry.name].suffix
                yield from _stray_files_in(entry, suffix, known)
            else:
                yield Finding("extra", None, entry.name, "is a file, but must be a folder")


def _stray_files_in(folder: os.DirEntry[str], suffix: str, known: set[int]) -> Iterator[Finding]:
    for entry in os.scandir(folder):
        index = _frame_index(entry.name, suffix)
        if entry.name in LITTER or index in known:
            continue
        problem = _stray_problem(entry) if index is None else "belongs to no frame: its JSON does not exist"
        yield Finding("extra", index, f"{folder.name}/{_printable(entry.name)}", problem)


def _printable(name: str) -> str:
    """A file name, in which file systems allow bytes that are not text."""
    return name.encode(errors="backslashreplace").decode()


def _stray_problem(entry: os.DirEntry[str]) -> str:
    if is_temporary(Path(entry.path)):
        return "is a temporary file of a build that was killed or still runs"
    return "does not belong to a data set"


_BATCH_ROWS: Final = 4096  # chosen: rows in memory at a time


def check_tables(dataset: Dataset, row_digests: Mapping[int, int], harvest: bool) -> Iterator[Finding]:
    """Yield the problems of the tables of a data set.

    Args:
        dataset: that the tables belong to.
        row_digests: digest of the expected row of the manifest for each frame.
        harvest: whether there must be a table of fruit.
    """
    from pyarrow import ArrowException, parquet

    expected = dict(row_digests)
    try:
        with parquet.ParquetFile(dataset.folder / MANIFEST) as file:
            for batch in file.iter_batches(_BATCH_ROWS):
                for row in batch.to_pylist():
                    yield from _check_row(row, expected)
    except FileNotFoundError:
        yield Finding("missing", None, MANIFEST, "does not exist; the same build command writes it again")
        return
    except (OSError, ArrowException, KeyError, ValueError) as error:
        yield Finding("damaged", None, MANIFEST, f"cannot be read ({' '.join(str(error).split())[:80]})")
        return
    for index in sorted(expected):
        yield Finding("contradiction", index, MANIFEST, "has no row for this frame")
    if harvest and not (dataset.folder / FRUIT).is_file():
        yield Finding("missing", None, FRUIT, "does not exist, although frames have the output harvest")


def _check_row(row: Mapping[str, object], expected: dict[int, int]) -> Iterator[Finding]:
    """Compare a row with the frame's digest, which is removed from `expected`."""
    index = int(str(row["index"]))
    if index not in expected:
        yield Finding("incomplete", index, MANIFEST, "has a row for this frame, whose JSON does not exist")
    elif expected.pop(index) != manifest_digest(row):
        yield Finding("contradiction", index, MANIFEST, "disagrees with the JSON of this frame")


_STANDARD_ERRORS: Final = 3.0
"""Chosen: by which the mean of a part of a plan must leave the range of the whole."""
_MIN_SCENES: Final = 4  # chosen: with fewer, a part of a plan is not judged
_MIN_SCENES_FOR_OUTLIERS: Final = 8  # chosen: with fewer, no scene is an outlier
_OUTLIER_DEVIATIONS: Final = 6.0  # chosen: robust; of 42 scenes with nine numbers each, none by chance
_MAD_TO_SD: Final = 1.4826
"""Standard deviation of a normal distribution over its median absolute deviation."""

_DUPLICATES: Final = {
    "picture": "has the same photograph as frame {}",
    "content": "has the same images as frame {}",
    "view": "has the pose and seed of frame {}",
}
"""Traits in which two frames must differ; a frame is reported for the first of them only."""

_CLASS_NAMES: Final = tuple(organ.name.lower() for organ in OrganClass)
_INTENSITY: Final = "intensity"


Sums = dict[str, NDArray[np.float64]]
"""Sum and number of the values of each statistic."""


class CrossFrameChecks:
    """Accumulates the traits of frames, and finds duplicates and statistics out of range.

    Args:
        expect: expectations of the recipe, or None.
    """

    def __init__(self, expect: ExpectTable | None) -> None:
        self._expect = expect or ExpectTable()
        self._indices = array("q")
        self._digests = {trait: array("Q") for trait in (*_DUPLICATES, "row")}
        self._sums: Sums = {}
        self._scene_sums: dict[int, Sums] = {}

    def add(self, traits: FrameTraits) -> Iterator[Finding]:
        """Add a frame, and yield where it violates the expectations of a single frame."""
        yield from self._check_photo(traits)
        self._indices.append(traits.index)
        for trait, digests in self._digests.items():
            digests.append(getattr(traits, trait))
        fractions = traits.fractions
        values = {} if fractions is None else dict(zip(_CLASS_NAMES, fractions, strict=True))
        if traits.mean is not None:
            values[_INTENSITY] = traits.mean
        scene = self._scene_sums.setdefault(-1 if traits.scene is None else traits.scene, {})
        for name, value in values.items():
            for sums in (self._sums, scene):
                sums[name] = sums.get(name, 0.0) + np.array([value, 1.0])

    def drift(self, whole: bool) -> Iterator[Finding]:
        """Yield means of the set that are outside the expected ranges.

        Args:
            whole: whether all frames of the plan exist; for a part of it, chance is allowed for.
        """
        ranges = dict(self._expect.share)
        if self._expect.intensity is not None:
            ranges[_INTENSITY] = self._expect.intensity
        for name, (low, high) in ranges.items():
            if name not in self._sums:
                continue
            total, count = self._sums[name]
            mean = total / count
            tolerance = 0.0 if whole else _STANDARD_ERRORS * self._standard_error(name)
            if not low - tolerance <= mean <= high + tolerance:
                values = f"{mean:.4g} over {count:.0f} frames, expected {low:g} to {high:g}"
                yield Finding("drift", None, "", f"the {_statistic(name)} is {values}")

    def outlier_scenes(self) -> Iterator[str]:
        """Yield scenes whose means differ strongly from those of the others."""
        if len(self._scene_sums) < _MIN_SCENES_FOR_OUTLIERS:
            return
        for name in self._sums:
            means = self._scene_means(name)
            centre = median(means.values())
            deviation = _MAD_TO_SD * median(abs(mean - centre) for mean in means.values())
            for scene, mean in means.items():
                if deviation > 0 and abs(mean - centre) > _OUTLIER_DEVIATIONS * deviation:
                    set_index, rotation = divmod(scene, 1000)
                    yield (
                        f"set {set_index}, rotation {rotation} is an outlier: {_statistic(name)} {mean:.4g}, "
                        f"median of all scenes {centre:.4g}"
                    )

    def _scene_means(self, name: str) -> dict[int, float]:
        known = {scene: sums[name] for scene, sums in self._scene_sums.items() if name in sums}
        return {scene: float(total / count) for scene, (total, count) in known.items()}

    def _standard_error(self, name: str) -> float:
        """Of the mean, from scene to scene: the frames of a scene show the same plants."""
        means = list(self._scene_means(name).values())
        return stdev(means) / math.sqrt(len(means)) if len(means) >= _MIN_SCENES else math.inf

    def duplicates(self) -> Iterator[Finding]:
        """Yield frames that repeat an earlier one, each once."""
        indices, reported = np.array(self._indices), set[int]()
        for trait, problem in _DUPLICATES.items():
            digests = np.array(self._digests[trait])
            # Equal digests are adjacent, in the order of the frames.
            order = np.lexsort((indices, digests))
            digests, ordered = digests[order], indices[order]
            first = 0
            repeated = np.flatnonzero((digests[1:] == digests[:-1]) & (digests[1:] != 0)) + 1
            for position in repeated.tolist():
                if digests[position] != digests[first]:
                    first = position - 1
                index = int(ordered[position])
                if index not in reported:
                    reported.add(index)
                    file = f"{FRAMES}/{index:0{DIGITS}d}.json"
                    yield Finding("duplicate", index, file, problem.format(ordered[first]))

    def row_digests(self) -> dict[int, int]:
        """Digest of the expected row of the manifest for each frame."""
        return dict(zip(self._indices, self._digests["row"], strict=True))

    def _check_photo(self, traits: FrameTraits) -> Iterator[Finding]:
        if traits.mean is None:
            return
        file = file_name(traits.index, "colour")
        if self._expect.frame_intensity is not None:
            low, high = self._expect.frame_intensity
            if not low <= traits.mean <= high:
                problem = f"has the mean grey value {traits.mean:.4g}, expected {low:g} to {high:g}"
                yield Finding("drift", traits.index, file, problem)
        limit = self._expect.saturated
        if limit is not None and traits.saturated > limit:
            problem = (
                f"{traits.saturated:.1%} of its pixels have a channel at 255, expected at most {limit:.1%}"
            )
            yield Finding("drift", traits.index, file, problem)


def _statistic(name: str) -> str:
    return "mean grey value" if name == _INTENSITY else f"pixel fraction of {name}"
