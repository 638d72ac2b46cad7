"""The whole check: what each frame, all frames together, the tables and the folder are wrong in."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from pepperscene.dataset.check.across import Comparison
from pepperscene.dataset.check.crew import examined
from pepperscene.dataset.check.listing import frame_indices, opened, stray_files
from pepperscene.dataset.check.manifest_rows import manifest_faults
from pepperscene.dataset.check.verdict import Finding, Verdict, in_order
from pepperscene.dataset.journal import Journal
from pepperscene.dataset.plan import Plan
from pepperscene.dataset.store import FRAMES, MARK, Dataset
from pepperscene.dataset.tables import ExpectTable
from pepperscene.document import validated
from pepperscene.errors import InputError


def check(
    folder: str | Path,
    workers: int | None = None,
    on_frame: Callable[[int, int], None] | None = None,
    frames: str | Sequence[int] | None = None,
) -> Verdict:
    """Look for faults in a data set; nothing is written.

    Every file is read, decoded and compared with what the frame's JSON says of it; then labels, distances and
    pictures are examined, and all frames compared with each other, with the manifest and with what the recipe
    expects. `KINDS` lists what can be found.

    Args:
        folder: of the data set.
        workers: processes that read frames; None for one for each core.
        on_frame: called after every frame with the number of frames so far and of all.
        frames: that must be there, "A:B" (0-based, half-open) or indices; None for those that builds were
            asked for, as the journal knows them, and those that the manifest names.

    Raises:
        InputError: the folder holds no data set, or an argument is not valid.
        WorkerError: a process was lost.
    """
    dataset, findings = opened(Path(folder))
    indices = frame_indices(dataset)
    findings += stray_files(dataset, indices)
    wanted = _wanted(dataset, frames)
    findings += _incomplete(dataset, indices, wanted)
    expect, faults = _expected(dataset)
    findings += faults

    # Frame by frame, whatever the number of processes in the same order.
    comparison, harvested = Comparison(expect), False
    for done, one in enumerate(examined(dataset, indices, workers), start=1):
        findings += one.findings
        findings += comparison.add(one.traits)
        harvested = harvested or one.harvested
        if on_frame is not None:
            on_frame(done, len(indices))

    # Then all together.
    findings += comparison.duplicates()
    findings += comparison.drift(whole=_is_whole(dataset, indices))
    known = {finding.index for finding in findings if finding.kind == "incomplete"}
    findings += (
        one
        for one in manifest_faults(dataset, comparison.rows(), harvested)
        if one.kind != "incomplete" or one.index not in known
    )
    return Verdict(in_order(findings), len(indices), tuple(comparison.apart()))


def _wanted(dataset: Dataset, frames: str | Sequence[int] | None) -> Sequence[int]:
    """The frames that must be there for what the user says, or for what builds were asked for."""
    if frames is None:
        return sorted(Journal(dataset.folder).wanted)
    try:
        plan = validated(Plan, dataset.about["recipe"]["plan"], dataset.folder / MARK)
    except (KeyError, TypeError):
        raise InputError(dataset.folder / MARK, "recipe.plan", None, "is required for --frames") from None
    return plan.chosen(frames)


def _is_whole(dataset: Dataset, indices: Sequence[int]) -> bool:
    try:
        return len(indices) == Plan.model_validate(dataset.about["recipe"]["plan"]).count
    except (KeyError, TypeError, ValueError):
        return False


def _incomplete(dataset: Dataset, indices: Sequence[int], wanted: Sequence[int]) -> list[Finding]:
    if not indices:
        return [Finding("incomplete", None, "", "there are no frames")]
    there = set(indices)
    return [
        Finding("incomplete", index, f"{FRAMES}/{dataset.frame_path(index).name}", "is not there")
        for index in wanted
        if index not in there
    ]


def _expected(dataset: Dataset) -> tuple[ExpectTable | None, list[Finding]]:
    """What `dataset.json` says that the recipe expects."""
    told = dataset.about.get("expect")
    if told is None:
        return None, []
    try:
        return validated(ExpectTable, told if isinstance(told, dict) else {"expect": told}, MARK), []
    except InputError as fault:
        return None, [Finding("damaged", None, MARK, f"expect: {fault.key} {fault.allowed}")]
