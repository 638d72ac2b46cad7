"""Frames made by jobs of a Slurm cluster, which are asked for when a build begins and end with it."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import tempfile
import time
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final, Self, final

from pydantic import AfterValidator, Field, model_validator

from pepperscene.dataset.execution.dask_cluster import connected, missing, quiet
from pepperscene.dataset.execution.executor import Executor, Notice, WorkUnit
from pepperscene.dataset.execution.job import BuildJob, Tell
from pepperscene.document import Document, read_toml, validate
from pepperscene.errors import InputError, SetupError, WorkerError

if TYPE_CHECKING:
    from dask_jobqueue import SLURMCluster


_MEMORY: Final = re.compile(r"\d+(\.\d+)? ?[MGT](i?B)?")
_WALLTIME: Final = re.compile(r"\d+(:\d\d){0,2}|\d+-\d\d?(:\d\d){0,2}")
"""Minutes, minutes:seconds, hours:minutes:seconds, days-hours and so on, as the manual of `sbatch` has it."""


def _line(text: str) -> str:
    if not text or not text.isprintable():
        raise ValueError("must be a line of text")
    return text


def _word(text: str) -> str:
    if not text.isprintable() or text.split() != [text]:
        raise ValueError("must be a word without blanks")
    return text


def _memory(text: str) -> str:
    if not _MEMORY.fullmatch(text):
        raise ValueError('must be a number with a unit, such as "16 GB"')
    return text


def _walltime(text: str) -> str:
    if not _WALLTIME.fullmatch(text):
        raise ValueError('must be a time as Slurm writes it, such as "12:00:00" or "2-00:00:00"')
    return text


_Line = Annotated[str, AfterValidator(_line)]
_Word = Annotated[str, AfterValidator(_word)]
_Count = Annotated[int, Field(strict=True, ge=1, le=100_000)]


class SlurmJobs(Document):
    """Jobs as a user asks for them.

    Attributes:
        jobs: how many.
        cores: of each.
        memory: of each ("16 GB").
        walltime: of each, as Slurm writes it ("12:00:00", "2-00:00:00").
        workers: processes of each job; they share its cores and its memory evenly.
        partition, account: as of `sbatch`, or None for the cluster's own.
        directives: further options of `sbatch` ("--qos=long").
        prologue: lines of the job's script before the worker begins ("module load python").
        python: that runs the workers; None for the one that runs this.
        interface: of the network that the nodes and this machine share ("ib0"); None for the first one.
        local_directory: for what Dask keeps on a node's disk, or None for where it finds room.
        log_directory: of the jobs' output; None leaves it to Slurm.
    """

    jobs: _Count
    cores: _Count
    memory: Annotated[str, AfterValidator(_memory)]
    walltime: Annotated[str, AfterValidator(_walltime)]
    workers: _Count = 1
    partition: _Word | None = None
    account: _Word | None = None
    directives: tuple[_Line, ...] = ()
    prologue: tuple[_Line, ...] = ()
    python: _Line | None = None
    interface: _Word | None = None
    local_directory: _Line | None = None
    log_directory: _Line | None = None

    @model_validator(mode="after")
    def _check(self) -> Self:
        if self.workers > self.cores:
            raise ValueError(f"workers = {self.workers} must not be more than cores = {self.cores}")
        return self

    def for_dask(self) -> dict[str, Any]:
        """The arguments of `dask_jobqueue.SLURMCluster`."""
        told = {
            "cores": self.cores,
            "processes": self.workers,
            "memory": self.memory,
            "walltime": self.walltime,
            "queue": self.partition,
            "account": self.account,
            "job_extra_directives": list(self.directives) or None,
            "job_script_prologue": list(self.prologue) or None,
            "python": self.python,
            "interface": self.interface,
            "local_directory": self.local_directory,
            "log_directory": self.log_directory,
        }
        # What is not said is left to Dask's own configuration, in which a site tells what is right there.
        return {name: value for name, value in told.items() if value is not None}


def read_slurm_file(path: Path) -> SlurmJobs:
    """The jobs that a file asks for; its folders are seen from where it lies.

    Raises:
        InputError: the file is missing or not TOML, a key is unknown or missing, or a value is not valid.
    """
    tables = read_toml(path)
    for key in ("python", "local_directory", "log_directory"):
        value = tables.get(key)
        if isinstance(value, str) and (key != "python" or os.sep in value):
            tables[key] = os.path.normpath(path.absolute().parent / Path(value).expanduser())
    return validate(SlurmJobs, tables, path)


_COMMANDS: Final = ("sbatch", "squeue", "scancel")

_RENEW_S: Final = 60.0
"""Chosen: how often jobs that have ended, because their time was over, are asked for again."""

_LOOK_S: Final = 10.0
"""Chosen: how often the queue is looked at while there is no worker."""

_LOOKS: Final = 6
"""Chosen: how often in a row no job may be found; Slurm's controller is at times too busy to answer."""

_ANSWER_S: Final = 60.0
"""Chosen: how long Slurm may take to answer."""

_NAME: Final = "pepperscene"


@final
class SlurmExecutor(Executor):
    """Workers in jobs of a Slurm cluster, started from a machine that can submit jobs.

    The scheduler runs in this process. The jobs wait in Slurm's queue for as long as it takes; frames are
    made as soon as the first one runs. A job whose time is over is asked for again.

    Args:
        path: of the file that tells what to ask for; see `SlurmJobs`.

    Raises:
        InputError: the file is not valid.
        SetupError: this machine cannot submit jobs, or the extra `cluster` is not installed.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._jobs = read_slurm_file(path)
        try:
            import dask_jobqueue  # noqa: F401
        except ImportError:
            raise missing() from None
        lacking = next((name for name in _COMMANDS if shutil.which(name) is None), None)
        if lacking is not None:
            raise SetupError(f"this machine cannot submit jobs to Slurm: it has no command {lacking}")

    @property
    def size(self) -> int:
        """Number of workers that are asked for."""
        return self._jobs.jobs * self._jobs.workers

    def make(self, job: BuildJob, units: Sequence[WorkUnit], tell: Tell, notice: Notice) -> None:
        """See `Executor.make`; the frames of different workers are told as they come."""
        from pepperscene.dataset.execution.dask_dispatch import DaskDispatcher, marker_beside

        with _cluster(self._path, self._jobs) as cluster:
            upkeep = _Upkeep(cluster, self._jobs.jobs)
            notice(f"Slurm is asked for {self._jobs.jobs} jobs; frames are made once one of them runs")
            with (
                connected(cluster.scheduler_address) as client,
                marker_beside(job.folder) as marker,
                DaskDispatcher(client, "Slurm", job, marker, units, upkeep.look) as shift,
            ):
                shift.run(tell, notice)


def script(path: Path) -> str:
    """The script of a job that a file asks for.

    Raises:
        InputError: the file is not valid.
    """
    with _cluster(path, read_slurm_file(path), ask=False) as cluster:
        return str(cluster.job_script())


@contextmanager
def _cluster(path: Path, jobs: SlurmJobs, *, ask: bool = True) -> Iterator[SLURMCluster]:
    """A scheduler in this process, without workers; leaving the block ends the jobs that it has.

    Raises:
        InputError: Slurm or this machine cannot do what the file asks for.
    """
    import dask
    from dask_jobqueue import SLURMCluster

    # A page that shows what a scheduler is at needs a port that others may have.
    site = dask.config.get("jobqueue.slurm.scheduler-options", None) or {}
    options = {"dashboard": False, "dashboard_address": ":0", **site}
    with quiet():
        try:
            with warnings.catch_warnings():
                # Without a network it is guessed by which address this machine can be reached.
                warnings.simplefilter("ignore")
                cluster = SLURMCluster(
                    **jobs.for_dask(), job_name=_NAME, scheduler_options=options, silence_logs=False
                )
        except (OSError, ValueError, RuntimeError) as fault:
            raise InputError(path, f"cannot be done here: {_words(fault)}") from None
        try:
            if ask:
                _ask(path, str(cluster.job_script()))
            yield cluster
        finally:
            cluster.close(timeout=_ANSWER_S)


def _ask(path: Path, job_script: str) -> None:
    """Raise the `InputError` that tells why Slurm would not take a job, if there is a reason."""
    with tempfile.NamedTemporaryFile("w", suffix=".sh") as file:
        file.write(job_script)
        file.flush()
        answer = _told(["sbatch", "--test-only", file.name])
    if answer is None or answer.returncode:
        words = "no answer" if answer is None else (answer.stderr.strip() or answer.stdout.strip())
        raise InputError(path, f"Slurm refuses such a job: {' '.join(words.split())}")


def _told(command: list[str]) -> subprocess.CompletedProcess[str] | None:
    try:
        return subprocess.run(command, capture_output=True, text=True, timeout=_ANSWER_S)
    except (OSError, subprocess.TimeoutExpired):
        return None


class _Upkeep:
    """Asks for jobs, again for those that have ended, and notices when there are none any more."""

    def __init__(self, cluster: SLURMCluster, jobs: int) -> None:
        self._cluster, self._jobs = cluster, jobs
        self._asked = self._looked = time.monotonic()
        self._in_vain = 0
        cluster.scale(jobs=jobs)

    def look(self, present: bool) -> None:
        """Once in a while; raises `WorkerError` when no job waits or runs and there is no worker."""
        now = time.monotonic()
        if now - self._asked > _RENEW_S:
            self._asked = now
            self._cluster.scale(jobs=self._jobs)
        if present:
            self._in_vain = 0
        elif now - self._looked > _LOOK_S:
            self._looked = now
            self._in_vain = 0 if self._queued() else self._in_vain + 1
        if self._in_vain >= _LOOKS:
            raise WorkerError(
                "Slurm has none of the jobs any more, and no worker has begun; their output tells why "
                "(log_directory says where it lies), and the frames that are whole are kept"
            )

    def _queued(self) -> bool:
        """Whether a job of this build waits or runs."""
        workers: dict[Any, Any] = dict(self._cluster.workers)
        numbers = [str(worker.job_id) for worker in workers.values() if worker.job_id is not None]
        if not numbers:
            return False
        answer = _told(["squeue", "--noheader", "--format=%i", f"--jobs={','.join(numbers)}"])
        return answer is not None and bool(answer.stdout.strip())


def _words(fault: Exception) -> str:
    return " ".join(str(fault).split()) or type(fault).__name__
