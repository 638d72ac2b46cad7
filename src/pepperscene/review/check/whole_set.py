"""Checks of a data set as a whole: its files and tables, duplicate frames, and statistics out of range."""

from __future__ import annotations

import math
import os
from array import array
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.atomic import SYSTEM_FILES, is_temporary
from pepperscene.classes import OrganClass
from pepperscene.dataset.store.dataset import FORMAT, FRAMES, MARK, Dataset, file_name
from pepperscene.dataset.store.folder import REPORT_FILES, SET_FILES
from pepperscene.dataset.store.frame_json import DIGITS, frame_index, is_as_written, read_json
from pepperscene.errors import InputError, short_repr
from pepperscene.outputs import OUTPUTS
from pepperscene.recipe.recipe import digest
from pepperscene.recipe.tables import ExpectTable
from pepperscene.review.check.findings import Finding
from pepperscene.review.check.one_frame import FrameTraits


def open_leniently(folder: Path) -> tuple[Dataset, list[Finding]]:
    """The data set in a folder, as far as its `dataset.json` can be read, and the problem of that file."""
    if not (folder / MARK).exists() and not (folder / FRAMES).is_dir():
        raise InputError(folder, f"holds no data set: there is no {MARK} in it")
    info: dict[str, Any] = {}
    problem = ""
    try:
        info = read_json(folder / MARK, within=folder)
        if info.get("format") != FORMAT:
            problem = f"has format = {short_repr(info.get('format'))}, must be {FORMAT!r}"
        elif not is_as_written(info):
            problem = "is not what was written: its checksum differs; the same build command repairs it"
        elif info.get("recipe_sha256") != digest({name: info.get(name) for name in ("recipe", "files")}):
            problem = "is not what was written: the recipe's checksum differs"
    except InputError as error:
        problem = error.problem
    return Dataset(folder, info), [Finding("damaged", None, MARK, problem)] if problem else []


def stray_files(dataset: Dataset, indices: Sequence[int]) -> Iterator[Finding]:
    """Yield files that belong to no frame, from other programs or killed builds."""
    known = set(indices)
    for entry in sorted(os.scandir(dataset.folder), key=lambda entry: entry.name):
        if entry.name in SYSTEM_FILES:
            continue
        if entry.name not in (*SET_FILES, *REPORT_FILES):
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


_STANDARD_ERRORS: Final = 3.0
"""Chosen: by which the mean of a part of a plan must leave the range of the whole."""
_MIN_SCENES: Final = 4  # chosen: with fewer, a part of a plan is not judged
_MIN_SCENES_FOR_OUTLIERS: Final = 8  # chosen: with fewer, no scene is an outlier
_OUTLIER_DEVIATIONS: Final = 6.0  # chosen: robust; of 42 scenes with nine numbers each, none by chance
_MAD_TO_SD: Final = 1.4826
"""Standard deviation of a normal distribution over its median absolute deviation."""

_DUPLICATES: Final = {
    "photo": "has the same photograph as frame {}",
    "content": "has the same images as frame {}",
    "view": "has the pose and seed of frame {}",
}
"""Traits in which two frames must differ; a frame is reported for the first of them only."""

_STATISTICS: Final = (*(organ.name.lower() for organ in OrganClass), "intensity")
"""The pixel fraction of each class, and the mean grey value of the photograph."""


class CrossFrameChecks:
    """Accumulates the traits of frames, and finds duplicates and statistics out of range.

    Args:
        expect: expectations of the recipe, or None.
    """

    def __init__(self, expect: ExpectTable | None) -> None:
        self._expect = expect or ExpectTable()
        self._indices = array("q")
        self._scenes = array("q")
        self._values = array("d")  # of `_STATISTICS` for every frame, nan if unknown
        self._digests = {trait: array("Q") for trait in (*_DUPLICATES, "row", "fruit")}

    def add(self, traits: FrameTraits) -> Iterator[Finding]:
        """Add a frame, and yield where it violates the expectations of a single frame."""
        yield from self._check_photo(traits)
        self._indices.append(traits.index)
        self._scenes.append(-1 if traits.scene is None else traits.scene)
        self._values.extend(traits.fractions or [math.nan] * len(OrganClass))
        self._values.append(math.nan if traits.mean is None else traits.mean)
        for trait, digests in self._digests.items():
            digests.append(getattr(traits, trait))

    def drift(self, whole: bool) -> Iterator[Finding]:
        """Yield means of the set that are outside the expected ranges.

        Args:
            whole: whether all frames of the plan exist; otherwise sampling error is allowed for.
        """
        ranges = dict(self._expect.share)
        if self._expect.intensity is not None:
            ranges["intensity"] = self._expect.intensity
        for name, (low, high) in ranges.items():
            values, _, scene_means = self._known_values(name)
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
                yield Finding("drift", None, "", f"the {_describe_statistic(name)} is {text}")

    def outlier_scenes(self) -> Iterator[str]:
        """Yield scenes whose means differ strongly from those of the others."""
        for name in _STATISTICS:
            _, scenes, means = self._known_values(name)
            if len(scenes) < _MIN_SCENES_FOR_OUTLIERS:
                continue
            centre = np.median(means)
            distances = np.abs(means - centre)
            limit = _OUTLIER_DEVIATIONS * _MAD_TO_SD * np.median(distances)
            for scene, mean in zip(scenes[distances > limit], means[distances > limit], strict=True):
                set_index, rotation = divmod(int(scene), 1000)
                text = f"{_describe_statistic(name)} {mean:.4g}, median of all scenes {centre:.4g}"
                if limit > 0:
                    yield f"set {set_index}, rotation {rotation} is an outlier: {text}"

    def _known_values(self, name: str) -> tuple[NDArray[np.float64], NDArray[np.int64], NDArray[np.float64]]:
        """The known values of a statistic, and scenes with their mean."""
        table = np.array(self._values).reshape(-1, len(_STATISTICS))
        values = table[:, _STATISTICS.index(name)]
        known = np.isfinite(values)
        scenes, inverse = np.unique(np.array(self._scenes)[known], return_inverse=True)
        return values[known], scenes, np.bincount(inverse, values[known]) / np.bincount(inverse)

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

    def frame_digests(self, trait: str) -> dict[int, int]:
        """A digest of each frame: `row` or `fruit`."""
        return dict(zip(self._indices, self._digests[trait], strict=True))

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


def _describe_statistic(statistic: str) -> str:
    return "mean grey value" if statistic == "intensity" else f"pixel fraction of {statistic}"
