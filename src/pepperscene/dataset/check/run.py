"""Frames examined one by one, here or by several processes, and told in their order."""

from __future__ import annotations

import queue
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import ExitStack
from pathlib import Path
from typing import Final

from pepperscene.dataset.check.cross_frame import CrossFrameChecks
from pepperscene.dataset.check.files import frame_indices, manifest_faults, opened, stray_files
from pepperscene.dataset.check.findings import CheckResult, Finding, in_order
from pepperscene.dataset.check.one_frame import FrameExamination, examine_frame
from pepperscene.dataset.recipe.plan import Plan
from pepperscene.dataset.recipe.tables import ExpectTable
from pepperscene.dataset.store.dataset import FRAMES, MARK, Dataset
from pepperscene.dataset.store.journal import Journal
from pepperscene.dataset.subprocess_rpc import Connection, WorkerProcess, available_cores
from pepperscene.document import validate
from pepperscene.errors import ArgumentError, InputError, WorkerError

MOST_WORKERS: Final = 256  # chosen: more would wait for the disk
_WORTH: Final = 64  # chosen: frames for which it pays to start a process, which takes half a second
_AT_A_TIME: Final = 16  # chosen: frames that a process is asked for
_AHEAD: Final = 2  # chosen: such parts for each process that may wait to be told, so that memory stays flat


def examined(dataset: Dataset, indices: Sequence[int], workers: int | None) -> Iterator[FrameExamination]:
    """Every frame examined, in the order of the indices.

    Args:
        dataset: whose frames are examined.
        indices: of the frames.
        workers: processes; None for one for each core, and none beside this one for a few frames.

    Raises:
        InputError: workers are not 1 to 256.
        WorkerError: a process was lost.
    """
    if workers is not None and not 1 <= workers <= MOST_WORKERS:
        raise ArgumentError("workers", f"{workers} must be 1 to {MOST_WORKERS}")
    wanted = available_cores() if workers is None else workers
    many = min(wanted, -(-len(indices) // _WORTH))
    if many <= 1:
        return (examine_frame(dataset, index) for index in indices)
    return _by_many(dataset, indices, many)


def _by_many(dataset: Dataset, indices: Sequence[int], many: int) -> Iterator[FrameExamination]:
    parts = [indices[place : place + _AT_A_TIME] for place in range(0, len(indices), _AT_A_TIME)]
    idle: queue.SimpleQueue[WorkerProcess] = queue.SimpleQueue()
    with ExitStack() as stack:
        for _ in range(many):
            idle.put(_started(dataset, stack))
        # A thread for each process waits for what it says; the processes end before the threads.
        pool = stack.enter_context(ThreadPoolExecutor(many))
        waiting: deque[Future[list[FrameExamination]]] = deque()
        for part in parts:
            waiting.append(pool.submit(_asked, idle, part))
            if len(waiting) > _AHEAD * many:
                yield from waiting.popleft().result()
        while waiting:
            yield from waiting.popleft().result()


def _started(dataset: Dataset, stack: ExitStack) -> WorkerProcess:
    try:
        child = WorkerProcess(__name__, threads=1)
        stack.callback(child.close)
        child.send(dataset)
    except OSError as fault:
        raise WorkerError(f"no process can be started ({fault}); try --workers 1") from None
    return child


def _asked(idle: queue.SimpleQueue[WorkerProcess], part: Sequence[int]) -> list[FrameExamination]:
    child = idle.get()
    try:
        found: list[FrameExamination] = child.call(list(part))
    except (OSError, EOFError):
        raise WorkerError(
            f"a process that examined frames {part[0]} to {part[-1]} was lost ({child.close()}); "
            "try fewer workers"
        ) from None
    finally:
        # The others find out for themselves that it is lost.
        idle.put(child)
    return found


def serve(connection: Connection) -> None:
    """Examine the requested frames, in a worker process."""
    dataset: Dataset = connection.state
    for indices in connection:
        connection.send([examine_frame(dataset, index) for index in indices])


def check_dataset(
    folder: str | Path,
    workers: int | None = None,
    on_frame: Callable[[int, int], None] | None = None,
    frames: str | Sequence[int] | None = None,
) -> CheckResult:
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
    comparison, harvested = CrossFrameChecks(expect), False
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
    return CheckResult(in_order(findings), len(indices), tuple(comparison.apart()))


def _wanted(dataset: Dataset, frames: str | Sequence[int] | None) -> Sequence[int]:
    """The frames that must be there for what the user says, or for what builds were asked for."""
    if frames is None:
        return sorted(Journal(dataset.folder).wanted)
    try:
        plan = validate(Plan, dataset.info["recipe"]["plan"], dataset.folder / MARK)
    except (KeyError, TypeError):
        raise InputError(dataset.folder / MARK, "is required for --frames", key="recipe.plan") from None
    return plan.select_indices(frames)


def _is_whole(dataset: Dataset, indices: Sequence[int]) -> bool:
    try:
        return len(indices) == Plan.model_validate(dataset.info["recipe"]["plan"]).count
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
    told = dataset.info.get("expect")
    if told is None:
        return None, []
    try:
        return validate(ExpectTable, told if isinstance(told, dict) else {"expect": told}, MARK), []
    except InputError as fault:
        return None, [Finding("damaged", None, MARK, f"expect: {fault.key} {fault.problem}")]
