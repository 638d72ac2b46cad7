"""Check of a whole data set, with frames examined in this process or by workers, in the same order."""

from __future__ import annotations

import queue
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import ExitStack
from pathlib import Path
from typing import Final

from pepperscene.building.subprocess_rpc import Connection, WorkerProcess, available_cores
from pepperscene.dataset.store.dataset import FRAMES, MARK, Dataset
from pepperscene.dataset.store.rendering_error import RenderingErrors
from pepperscene.document import validate
from pepperscene.errors import ArgumentError, InputError, WorkerError
from pepperscene.recipe.plan import Plan
from pepperscene.recipe.tables import ExpectTable
from pepperscene.review.check.exposure import Exposures
from pepperscene.review.check.findings import CheckResult, Finding, sort_findings
from pepperscene.review.check.one_frame import FrameExamination, examine_frame
from pepperscene.review.check.tables import check_tables
from pepperscene.review.check.variation import DrawnValues
from pepperscene.review.check.whole_set import (
    CrossFrameChecks,
    open_leniently,
    stray_files,
)

MAX_WORKERS: Final = 256  # chosen: more would wait for the disk
_FRAMES_PER_WORKER: Final = 64  # chosen: worth starting a process, which takes half a second
_CHUNK: Final = 16  # chosen: frames per request to a process
_CHUNKS_AHEAD: Final = 2  # chosen: per process, finished but not yet yielded, to bound the memory


def examine_frames(
    dataset: Dataset, indices: Sequence[int], workers: int | None
) -> Iterator[FrameExamination]:
    """Examine frames in the order of the indices, with up to `workers` processes, by default one per core."""
    if workers is not None and not 1 <= workers <= MAX_WORKERS:
        raise ArgumentError("workers", f"{workers} must be 1 to {MAX_WORKERS}")
    limit = available_cores() if workers is None else workers
    count = min(limit, -(-len(indices) // _FRAMES_PER_WORKER))
    if count <= 1:
        # Too few frames for another process.
        return (examine_frame(dataset, index) for index in indices)
    return _examine_in_workers(dataset, indices, count)


def _examine_in_workers(dataset: Dataset, indices: Sequence[int], count: int) -> Iterator[FrameExamination]:
    chunks = [indices[start : start + _CHUNK] for start in range(0, len(indices), _CHUNK)]
    idle_workers: queue.SimpleQueue[WorkerProcess] = queue.SimpleQueue()
    with ExitStack() as stack:
        for _ in range(count):
            idle_workers.put(_start_worker(dataset, stack))
        # One thread per process waits for its answers; the processes end before the threads.
        pool = stack.enter_context(ThreadPoolExecutor(count))
        pending: deque[Future[list[FrameExamination]]] = deque()
        for chunk in chunks:
            pending.append(pool.submit(_request, idle_workers, chunk))
            if len(pending) > _CHUNKS_AHEAD * count:
                yield from pending.popleft().result()
        while pending:
            yield from pending.popleft().result()


def _start_worker(dataset: Dataset, stack: ExitStack) -> WorkerProcess:
    try:
        worker = WorkerProcess(__name__, threads=1)
        stack.callback(worker.close)
        worker.send(dataset)
    except OSError as error:
        raise WorkerError(f"no process can be started ({error}); try workers=1") from None
    return worker


def _request(idle_workers: queue.SimpleQueue[WorkerProcess], chunk: Sequence[int]) -> list[FrameExamination]:
    worker = idle_workers.get()
    try:
        examinations: list[FrameExamination] = worker.call(list(chunk))
    except (OSError, EOFError):
        raise WorkerError(
            f"a process that examined frames {chunk[0]} to {chunk[-1]} was lost ({worker.close()}); "
            "try fewer workers"
        ) from None
    finally:
        # Even a lost process goes back, so that other threads fail instead of waiting.
        idle_workers.put(worker)
    return examinations


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
    """Check a data set; nothing is written.

    Every file is read, decoded and compared with the frame's JSON. Then labels, measured values and
    photographs are checked, and all frames are compared with each other, with the manifest and with the
    expectations of the recipe. `KINDS` lists the kinds of findings.

    Args:
        folder: of the data set.
        workers: processes that read frames; None for one per core.
        on_frame: called after every frame with the number of frames done and the number of all.
        frames: that must exist, "A:B" (0-based, half-open) or indices; None for those in the
            manifest.

    Raises:
        InputError: the folder holds no data set, or an argument is not valid.
        WorkerError: a process was lost.
    """
    dataset, findings = open_leniently(Path(folder))
    indices = dataset.indices()
    findings += stray_files(dataset, indices)
    plan = _read_plan(dataset)
    if frames is None:
        required: Sequence[int] = ()
    elif plan is None:
        raise InputError(dataset.folder / MARK, "must be valid to select frames", key="recipe.plan")
    else:
        required = plan.select_indices(frames)
    findings += _missing_frames(dataset, indices, required)
    expect, problems = _read_expectations(dataset)
    findings += problems

    # Each frame by itself, in the same order for any number of workers.
    comparison, has_harvest = CrossFrameChecks(expect), False
    drawn, exposures, errors = DrawnValues(dataset.info), Exposures(dataset.info), RenderingErrors()
    for done, examination in enumerate(examine_frames(dataset, indices, workers), start=1):
        findings += examination.findings
        traits = examination.traits
        findings += comparison.add(traits)
        drawn.add(traits.index, traits.drawn)
        exposures.add(traits.mean, traits.saturated, traits.automatic)
        errors.add(*(traits.sampling.get(name) for name in ("target", "error_codes", "noise_codes")))
        has_harvest = has_harvest or examination.has_harvest
        if on_frame is not None:
            on_frame(done, len(indices))

    # All frames together.
    findings += comparison.duplicates()
    findings += comparison.drift(whole=plan is not None and len(indices) == plan.count)
    incomplete = {finding.index for finding in findings if finding.kind == "incomplete"}
    findings += (
        finding
        for finding in check_tables(
            dataset,
            comparison.frame_digests("row"),
            comparison.frame_digests("fruit"),
            has_harvest,
        )
        if finding.kind != "incomplete" or finding.index not in incomplete
    )
    notes = (*comparison.outlier_scenes(), *drawn.notes(), *exposures.notes(), *errors.notes())
    return CheckResult(sort_findings(findings), len(indices), notes)


def _read_plan(dataset: Dataset) -> Plan | None:
    try:
        return Plan.model_validate(dataset.info["recipe"]["plan"])
    except (KeyError, TypeError, ValueError):
        return None


def _missing_frames(dataset: Dataset, indices: Sequence[int], required: Sequence[int]) -> list[Finding]:
    if not indices:
        return [Finding("incomplete", None, "", "there are no frames")]
    existing_set = set(indices)
    return [
        Finding("incomplete", index, f"{FRAMES}/{dataset.frame_path(index).name}", "does not exist")
        for index in required
        if index not in existing_set
    ]


def _read_expectations(dataset: Dataset) -> tuple[ExpectTable | None, list[Finding]]:
    """The recipe's expectations in `dataset.json`."""
    expect = dataset.info.get("expect")
    if expect is None:
        return None, []
    try:
        return validate(ExpectTable, expect if isinstance(expect, dict) else {"expect": expect}, MARK), []
    except InputError as error:
        return None, [Finding("damaged", None, MARK, f"expect: {error.key} {error.problem}")]
