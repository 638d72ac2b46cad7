"""Check of a whole data set, with frames examined by several threads, in the same order for any number."""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Final

from pepperscene.dataset.store.dataset import FRAMES, MARK, Dataset
from pepperscene.document import validate
from pepperscene.errors import ArgumentError, InputError
from pepperscene.interrupts import raise_if_interrupted
from pepperscene.recipe.plan import Plan
from pepperscene.recipe.tables import ExpectTable
from pepperscene.review.check.findings import CheckResult, Finding, sort_findings
from pepperscene.review.check.notes import notes
from pepperscene.review.check.one_frame import FrameChecker, FrameTraits
from pepperscene.review.check.whole_set import (
    check_expectations,
    check_tables,
    duplicates,
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
