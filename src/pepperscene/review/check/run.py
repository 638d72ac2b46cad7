"""Check of a whole data set, with frames examined by several threads, and notes on unusual values."""

from __future__ import annotations

import os
from collections import Counter, deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Any, Final

import numpy as np

from pepperscene.dataset.store.dataset import FRAMES, MARK, Dataset
from pepperscene.document import validate
from pepperscene.errors import ArgumentError, InputError
from pepperscene.frame import RenderingErrors
from pepperscene.interrupts import raise_if_interrupted
from pepperscene.recipe.camera_tables import AUTO
from pepperscene.recipe.plan import Plan
from pepperscene.recipe.tables import ExpectTable
from pepperscene.recipe.variation.recorded import (
    as_number,
    distinct_draws,
    goodness_of_fit,
    read_variation,
    recorded_twins,
)
from pepperscene.review.check.findings import CheckResult, Finding, sort_findings
from pepperscene.review.check.one_frame import FrameChecker, FrameTraits
from pepperscene.review.check.whole_set import (
    STATISTICS,
    check_expectations,
    check_tables,
    describe_statistic,
    duplicates,
    known_values,
    open_leniently,
    stray_files,
)

MAX_WORKERS: Final = 256  # chosen: more would wait for the disk
_THREADS: Final = min(8, os.cpu_count() or 1)  # chosen: more would wait for the part that holds Python's lock


def check_dataset(
    folder: str | Path,
    workers: int | None = None,
    on_frame: Callable[[int, int], None] | None = None,
    frames: str | Sequence[int] | None = None,
) -> CheckResult:
    """Check a data set; nothing is written.

    Every file is read, decoded and compared with the frame's JSON. Then labels, measured values and
    photographs are checked, and all frames are compared with each other, with the manifest and with the
    expectations of the recipe. `KINDS` lists the kinds of findings.

    Args:
        folder: of the data set.
        workers: threads that read frames; None for one per core, at most eight.
        on_frame: called after every frame with the number of frames done and the number of all.
        frames: that must exist, "A:B" (0-based, half-open) or indices; None for those in the manifest.

    Raises:
        InputError: the folder holds no data set, or an argument is not valid.
    """
    if workers is not None and not 1 <= workers <= MAX_WORKERS:
        raise ArgumentError("workers", f"{workers} must be 1 to {MAX_WORKERS}")
    dataset, findings = open_leniently(Path(folder))
    indices, info = dataset.indices(), dataset.info
    plan = Plan.model_validate(info["recipe"]["plan"]) if info else None
    if frames is not None and plan is None:
        raise InputError(dataset.folder / MARK, "must be valid to select frames", key="recipe.plan")
    required = plan.select_indices(frames) if plan is not None and frames is not None else ()
    findings += stray_files(dataset, indices)
    if not indices:
        findings.append(Finding("incomplete", None, "", "there are no frames"))
    missing = set(required) - set(indices) if indices else set()
    findings += (
        Finding("incomplete", index, f"{FRAMES}/{dataset.frame_path(index).name}", "does not exist")
        for index in missing
    )

    # Each frame by itself.
    traits: list[FrameTraits] = []
    for found, frame in _check_frames(dataset, indices, workers or _THREADS):
        findings += found
        traits.append(frame)
        if on_frame is not None:
            on_frame(len(traits), len(indices))

    # All frames together.
    findings += duplicates(traits)
    if "expect" in info:
        try:
            expect = validate(ExpectTable, info["expect"], MARK)
            findings += check_expectations(traits, expect, plan is not None and len(indices) == plan.count)
        except InputError as error:
            findings.append(Finding("damaged", None, MARK, f"expect: {error.detail}"))
    if info:
        findings += (
            finding
            for finding in check_tables(dataset, traits)
            if finding.kind != "incomplete" or finding.index not in missing
        )
    return CheckResult(sort_findings(findings), len(indices), tuple(notes(traits, info)))


def _check_frames(
    dataset: Dataset, indices: Sequence[int], workers: int
) -> Iterator[tuple[list[Finding], FrameTraits]]:
    """Check each frame, in order. Decoding, checksums and arithmetic of images release Python's lock."""
    checker = FrameChecker(dataset)
    with ThreadPoolExecutor(min(workers, len(indices)) or 1) as pool:
        pending: deque[Future[tuple[list[Finding], FrameTraits]]] = deque()
        try:
            for index in indices:
                raise_if_interrupted()
                pending.append(pool.submit(checker.check, index))
                # Few are in memory at a time.
                if len(pending) > 2 * workers:
                    yield pending.popleft().result()
            while pending:
                yield pending.popleft().result()
        finally:
            for future in pending:
                future.cancel()


_MIN_SCENES: Final = 8  # chosen: with fewer, no scene is an outlier
_OUTLIER_DEVIATIONS: Final = 6.0  # chosen: robust; of 42 scenes with nine numbers each, none by chance
_MAD_TO_SD: Final = 1.4826
"""Standard deviation of a normal distribution over its median absolute deviation."""

_UNLIKELY: Final = 1e-4
"""Chosen: a probability that one of ten thousand correct values has by chance."""

_DARK: Final = 40.0
"""Chosen: mean grey value. The photographs of Barth et al. 2018, by flash in the dark, have 37."""
_BRIGHT: Final = 180.0  # chosen: mean grey value; leaves of such photographs are nearly white
_SATURATED: Final = 0.05  # chosen: fraction of the pixels; well exposed daylight has a tenth of it
_LONGEST_NAME: Final = 40  # chosen: of a limit in a note


def notes(frames: Sequence[FrameTraits], info: Mapping[str, Any]) -> Iterator[str]:
    """Yield what is unusual but valid.

    Args:
        frames: all frames of the set.
        info: the content of `dataset.json`, of valid types, or empty.
    """
    yield from outlier_scenes(frames)
    if info:
        yield from unlikely_draws(frames, info["recipe"])
    yield from exposure_notes(frames, info)
    errors = RenderingErrors()
    for frame in frames:
        errors.add(*(frame.sampling.get(name) for name in ("target", "error_codes", "noise_codes")))
    yield from errors.notes()


def outlier_scenes(frames: Sequence[FrameTraits]) -> Iterator[str]:
    """Yield scenes whose means differ strongly from those of the others."""
    for name in STATISTICS:
        _, scenes, means = known_values(frames, name)
        if len(scenes) < _MIN_SCENES:
            continue
        centre = np.median(means)
        distances = np.abs(means - centre)
        limit = _OUTLIER_DEVIATIONS * _MAD_TO_SD * np.median(distances)
        for scene, mean in zip(scenes[distances > limit], means[distances > limit], strict=True):
            set_index, rotation = divmod(int(scene), 1000)
            text = f"{describe_statistic(name)} {mean:.4g}, median of all scenes {centre:.4g}"
            if limit > 0:
                yield f"set {set_index}, rotation {rotation} is an outlier: {text}"


def unlikely_draws(frames: Sequence[FrameTraits], recipe: Mapping[str, Any]) -> Iterator[str]:
    """Yield a note for each value whose draws do not fit its distribution."""
    plan, twins = Plan.model_validate(recipe["plan"]), recorded_twins(recipe)
    inside = [frame for frame in frames if frame.index < plan.count]
    indices = np.array([frame.index for frame in inside], np.int64)
    for varied in read_variation(recipe):
        # The values of twins are not drawn.
        if varied.name in twins:
            continue
        numbers = np.array([as_number(varied, frame.drawn.get(varied.name)) for frame in inside], float)
        draws = distinct_draws(varied, plan, indices, numbers)
        p = goodness_of_fit(varied, draws)
        if p is not None and p < _UNLIKELY:
            yield (
                f"the {len(draws)} draws of {varied.name} do not fit the recipe's distribution, "
                f"{varied.describe()}: such draws have a probability of {p:.1g}"
            )


def exposure_notes(frames: Sequence[FrameTraits], info: Mapping[str, Any]) -> Iterator[str]:
    """Yield at most one note on the mean brightness, and one on limits of automatic exposure."""
    if "expect" not in info:
        # The recipe's expectations are checked elsewhere.
        yield from _brightness(frames, info)
    automatic = [frame.automatic for frame in frames if frame.automatic]
    reached = [limit for exposure in automatic if (limit := exposure.get("limited_by")) is not None]
    if reached:
        limits = Counter(str(limit)[:_LONGEST_NAME] for limit in reached)
        listing = ", ".join(f"{count} {name}" for name, count in sorted(limits.items()))
        number = f"{len(reached)} of {len(automatic)} automatic exposures"
        yield f"{number} reached a limit ({listing}), so their grey is not auto_exposure.target_grey"


def _brightness(frames: Sequence[FrameTraits], info: Mapping[str, Any]) -> Iterator[str]:
    photos = [(frame.mean, frame.saturated) for frame in frames if frame.mean is not None]
    if not photos:
        return
    mean, saturated = (sum(values) / len(photos) for values in zip(*photos, strict=True))
    is_auto = info.get("recipe", {}).get("camera", {}).get("exposure_us") == AUTO
    if mean < _DARK:
        problem = f"the photographs are dark: their mean grey value is {mean:.0f} of 255"
        yield f"{problem}; {_advice(is_auto, 'longer', 'raise')}"
    elif mean > _BRIGHT or saturated > _SATURATED:
        problem = "the photographs are overexposed: "
        problem += f"their mean grey value is {mean:.0f} of 255, and {saturated:.1%} of their pixels"
        yield f"{problem} have a channel at 255; {_advice(is_auto, 'shorter', 'lower')}"


def _advice(is_auto: bool, length: str, change: str) -> str:
    if is_auto:
        return f"{change} auto_exposure.target_grey, or widen auto_exposure.exposure_us"
    return f'set a {length} camera.exposure_us, or exposure_us = "auto"'
