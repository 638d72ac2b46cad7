"""Units handed out to the workers of a Dask cluster: one to each, another to whoever is done."""

from __future__ import annotations

import pickle
import queue
import time
import uuid
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, Final, Self

from pepperscene.dataset.execution.dask_worker import TOPIC, Call, MisfitError, Order
from pepperscene.dataset.execution.executor import LostWorkers, Notice, UnitQueue, WorkUnit
from pepperscene.dataset.execution.job import BuildJob, FrameDone, Tell
from pepperscene.errors import OutputError, PepperError, WorkerError

if TYPE_CHECKING:
    from distributed import Client, Future


_ROLL_S: Final = 1.0
"""Chosen: how often it is asked which workers there are."""

_PATIENCE_S: Final = 60.0
"""Chosen: how long workers may take to finish the frames that they are at when one has failed."""

_SHORT_PATIENCE_S: Final = 5.0
"""Chosen: the same, when the user wants an end."""

Upkeep = Callable[[bool], None]
"""Called once in a while, with whether there is a worker; raises `WorkerError` when none will ever come."""


@dataclass(frozen=True, eq=False)
class _Errand:
    """A unit that a worker is at."""

    address: str
    unit: WorkUnit
    future: Future


class DaskDispatcher:
    """The workers of one build, as far as this process knows, and the units that are left.

    Dask would by itself send a lost worker's task to another one, whole; here the rest of a unit is handed
    out anew, and who goes on with the plants of a set is decided by `UnitQueue`.

    Args:
        client: of the cluster.
        where: what the user calls the cluster.
        job: what is asked for.
        marker: file beside what is written, for workers to see.
        units: the frames.
        upkeep: see there.
    """

    def __init__(
        self,
        client: Client,
        where: str,
        job: BuildJob,
        marker: Path,
        units: Sequence[WorkUnit],
        upkeep: Upkeep,
    ) -> None:
        self._client, self._where, self._upkeep = client, where, upkeep
        self._order = Order.of(uuid.uuid4().hex, marker, job)
        self._queue, self._losses = UnitQueue(units), LostWorkers()
        self._events: queue.SimpleQueue[tuple[int, FrameDone | None]] = queue.SimpleQueue()
        self._number = 0
        self._busy: dict[int, _Errand] = {}
        self._open: set[int] = set()
        self._last: dict[str, WorkUnit] = {}
        self._misfits: dict[str, str] = {}
        self._told: set[int] = set()

    def __enter__(self) -> Self:
        self._client.subscribe_topic(TOPIC, self._heard)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, fault: BaseException | None, trace: TracebackType | None
    ) -> None:
        for number in list(self._busy):
            self._recall(number)
        if isinstance(fault, PepperError):
            self._wait(_PATIENCE_S)
        elif fault is not None:
            self._wait(_SHORT_PATIENCE_S)
        with suppress(Exception):
            # The scheduler may be what was lost.
            self._client.unsubscribe_topic(TOPIC)

    def run(self, tell: Tell, notice: Notice) -> None:
        """Hand out units until all are done; see `Executor.make`."""
        called = -_ROLL_S
        while self._queue or self._busy:
            if time.monotonic() - called >= _ROLL_S:
                self._call_the_roll(notice)
                called = time.monotonic()
            try:
                number, done = self._events.get(timeout=_ROLL_S)
            except queue.Empty:
                continue
            if done is not None:
                self._tell(done, tell)
            elif number in self._busy:
                self._ended(number, notice)

    # What workers do

    def _heard(self, event: tuple[float, dict[str, Any]]) -> None:
        """What a worker tells, heard in the client's thread."""
        _, told = event
        if told.get("build") == self._order.build:
            done = None if told["done"] is None else pickle.loads(told["done"])
            if done is None:
                self._open.discard(told["number"])
            else:
                self._events.put((told["number"], done))

    def _tell(self, done: FrameDone, tell: Tell) -> None:
        """Tell of a frame, once, even if a worker that was thought to be lost has made it, too."""
        if done.index not in self._told:
            self._told.add(done.index)
            tell(done)

    def _ended(self, number: int, notice: Notice) -> None:
        """Find out how a unit ended, and what is next for its worker."""
        from distributed import KilledWorker

        errand = self._busy[number]
        fault = errand.future.exception() if errand.future.status == "error" else None
        if errand.future.status in ("finished", "error"):
            # Also where it could not even be begun, and nobody tells so.
            self._open.discard(number)
        if fault is None and not errand.unit.after(self._told).indices:
            self._recall(number)
            self._give(errand.address)
        elif fault is None or isinstance(fault, KilledWorker):
            self._lose(number, notice)
        elif (why := _misfit(fault)) is not None:
            self._dismiss(number, why, notice)
        else:
            self._recall(number)
            raise fault

    # Who is there

    def _call_the_roll(self, notice: Notice) -> None:
        """Miss those who are gone, give those who have come something to do."""
        present = self._present()
        for number, errand in list(self._busy.items()):
            if errand.address not in present:
                self._lose(number, notice)
        at_work = {errand.address for errand in self._busy.values()}
        for address in sorted(present - at_work - self._misfits.keys()):
            self._give(address)
        if not self._busy and present and present <= self._misfits.keys():
            address = min(present)
            raise WorkerError(
                f"no worker at {self._where} fits: the one at {address} {self._misfits[address]}"
            )
        self._upkeep(bool(present))

    def _present(self) -> set[str]:
        """Addresses of the workers that the scheduler knows."""
        try:
            if self._client.status == "running":
                return set(self._client.nthreads())
        except (OSError, TimeoutError):
            pass
        self._open.clear()
        raise WorkerError(
            f"the scheduler at {self._where} is lost; the frames that are whole are kept, and the same "
            "command goes on"
        )

    def _give(self, address: str) -> None:
        """The next unit for a worker, without what was told since it was put back."""
        last = self._last.get(address)
        while (unit := self._queue.next(last)) is not None:
            unit = unit.after(self._told)
            if unit.indices:
                break
        else:
            return
        number, self._number = self._number, self._number + 1
        future = self._client.submit(
            pickle.loads,
            pickle.dumps(Call(self._order, number, unit.indices), protocol=5),
            key=f"pepperscene-{self._order.build}-{number}",
            workers=[address],
            allow_other_workers=False,
            pure=False,
        )
        self._busy[number] = _Errand(address, unit, future)
        self._open.add(number)
        self._last[address] = unit
        future.add_done_callback(lambda _: self._events.put((number, None)))

    def _lose(self, number: int, notice: Notice) -> None:
        """Put back what is left of a lost worker's unit."""
        errand = self._recall(number)
        self._open.discard(number)
        left = errand.unit.after(self._told)
        if left.indices:
            self._queue.put_back(left)
            notice(self._losses.note(left.indices[0], f"at {errand.address}"))

    def _dismiss(self, number: int, why: str, notice: Notice) -> None:
        """Give nothing more to a worker that cannot make frames of this build."""
        errand = self._recall(number)
        self._queue.put_back(errand.unit)
        self._misfits[errand.address] = why
        notice(f"the worker at {errand.address} {why}; it is left out")

    # How it ends

    def _recall(self, number: int) -> _Errand:
        """Forget about a task; a worker that is at it ends after its frame."""
        errand = self._busy.pop(number)
        with suppress(Exception):
            errand.future.cancel()
        return errand

    def _wait(self, patience_s: float) -> None:
        """Let workers finish the frames that they are at."""
        until = time.monotonic() + patience_s
        while self._open and time.monotonic() < until:
            time.sleep(0.05)


def _misfit(fault: BaseException) -> str | None:
    """What keeps a worker from making frames at all, if that is what a fault says."""
    if isinstance(fault, MisfitError):
        return str(fault)
    # Where this package, or a module of the user's, is missing or another one, the call cannot be read.
    unread = isinstance(fault, AttributeError) and str(fault).startswith("Can't get attribute")
    return f"cannot begin ({fault})" if unread or isinstance(fault, ImportError) else None


@contextmanager
def marker_beside(folder: Path) -> Iterator[Path]:
    """A file in a folder, or in what there is already of the folders above it.

    Raises:
        OutputError: it cannot be written.
    """
    standing = next(path for path in (folder, *folder.parents) if path.is_dir())
    marker = standing / f".pepperscene.{uuid.uuid4().hex}.tmp"
    try:
        marker.touch()
    except OSError as fault:
        raise OutputError(f"{standing}: cannot be written to ({fault.strerror or fault})") from None
    try:
        yield marker
    finally:
        marker.unlink(missing_ok=True)
