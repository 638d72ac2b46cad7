"""The executor that submits jobs to a Slurm cluster when a build starts, and ends them with it."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import tempfile
import time
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final, Self, final

from pydantic import AfterValidator, Field, model_validator

from pepperscene.dataset.execution.dask_executor import connect, missing_extra, quiet_libraries, run_on_dask
from pepperscene.dataset.execution.executor import Dispatcher, Executor
from pepperscene.dataset.execution.job import BuildJob
from pepperscene.document import Document, read_toml, validate
from pepperscene.errors import InputError, SetupError, WorkerError

if TYPE_CHECKING:
    from dask_jobqueue import SLURMCluster


_MEMORY: Final = re.compile(r"\d+(\.\d+)? ?[MGT](i?B)?")
_WALLTIME: Final = re.compile(r"\d+(:\d\d){0,2}|\d+-\d\d?(:\d\d){0,2}")
"""Minutes, minutes:seconds, hours:minutes:seconds, days-hours and so on, as in the manual of `sbatch`."""

_DASK_NAMES: Final = {
    "workers": "processes",
    "partition": "queue",
    "directives": "job_extra_directives",
    "prologue": "job_script_prologue",
}
"""Arguments of `SLURMCluster` whose name is not the file's key."""

_COMMANDS: Final = ("sbatch", "squeue", "scancel")
_JOB_NAME: Final = "pepperscene"
_RENEW_S: Final = 60.0  # chosen: interval after which expired jobs are submitted again
_QUEUE_CHECK_S: Final = 10.0  # chosen: how often the queue is checked while there is no worker
_QUEUE_CHECKS: Final = (
    6  # chosen: checks in a row without a job; Slurm's controller is at times too busy to answer
)
_ANSWER_S: Final = 60.0  # chosen: how long Slurm may take to answer


def _must_be(description: str, test: Callable[[str], object]) -> AfterValidator:
    def check(text: str) -> str:
        if not test(text):
            raise ValueError(f"must be {description}")
        return text

    return AfterValidator(check)


_Line = Annotated[str, _must_be("a line of text", lambda text: text and text.isprintable())]
_Word = Annotated[
    str, _must_be("a word without blanks", lambda text: text.isprintable() and text.split() == [text])
]
_Memory = Annotated[str, _must_be('a number with a unit, such as "16 GB"', _MEMORY.fullmatch)]
_Walltime = Annotated[
    str, _must_be('a time in Slurm\'s format, such as "12:00:00" or "2-00:00:00"', _WALLTIME.fullmatch)
]
_Count = Annotated[int, Field(strict=True, ge=1, le=100_000)]


class SlurmJobs(Document):
    """A description of Slurm jobs.

    Attributes:
        jobs: number of jobs.
        cores: of each job.
        memory: of each job ("16 GB").
        walltime: of each job, in Slurm's format ("12:00:00", "2-00:00:00").
        workers: processes of each job, which share its cores and its memory evenly.
        partition, account: as of `sbatch`, or None for the cluster's default.
        directives: further options of `sbatch` ("--qos=long").
        prologue: lines of the job's script before the worker starts ("module load python").
        python: that runs the workers; None for the one of this process.
        interface: of the network that the nodes and this machine share ("ib0"); None for the first one.
        local_directory: on a node's disk, for Dask's files; None for Dask's default.
        log_directory: of the jobs' output; None for Slurm's default.
    """

    jobs: _Count
    cores: _Count
    memory: _Memory
    walltime: _Walltime
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

    def cluster_arguments(self) -> dict[str, Any]:
        """The arguments of `dask_jobqueue.SLURMCluster`."""
        # Missing values come from Dask's configuration, which a site may have adapted.
        stated = self.model_dump(exclude={"jobs"}, exclude_none=True)
        arguments = {_DASK_NAMES.get(key, key): value for key, value in stated.items() if value != ()}
        return {key: list(value) if isinstance(value, tuple) else value for key, value in arguments.items()}


def read_slurm_file(path: Path) -> SlurmJobs:
    """Read a description of jobs; its paths are relative to the file's folder.

    Raises:
        InputError: the file is missing or not TOML, a key is unknown or missing, or a value is not valid.
    """
    tables = read_toml(path)
    for key in ("python", "local_directory", "log_directory"):
        value = tables.get(key)
        if isinstance(value, str) and (key != "python" or os.sep in value):
            tables[key] = os.path.normpath(path.absolute().parent / Path(value).expanduser())
    return validate(SlurmJobs, tables, path)


@final
class SlurmExecutor(Executor):
    """Workers in jobs of a Slurm cluster, described by a file (see `SlurmJobs`).

    The scheduler runs in this process. Jobs may wait in Slurm's queue; frames are made as soon as the first
    one runs. An expired job is submitted again. Raises `InputError` if the file is not valid, and
    `SetupError` if this machine cannot submit jobs, or the extra `cluster` is not installed.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._jobs = read_slurm_file(path)
        try:
            import dask_jobqueue  # noqa: F401
        except ImportError:
            raise missing_extra() from None
        missing = next((name for name in _COMMANDS if shutil.which(name) is None), None)
        if missing is not None:
            raise SetupError(f"this machine cannot submit jobs to Slurm: it has no command {missing}")

    @property
    def size(self) -> int:
        """Number of workers in all jobs."""
        return self._jobs.jobs * self._jobs.workers

    def make(self, job: BuildJob, dispatcher: Dispatcher) -> None:
        """See `Executor.make`; frames are reported as they become complete."""
        with _cluster(self._path, self._jobs) as cluster:
            upkeep = _Upkeep(cluster, self._jobs.jobs)
            dispatcher.on_notice(
                f"{self._jobs.jobs} jobs were submitted to Slurm; frames are made once one of them runs"
            )
            with connect(cluster.scheduler_address) as client:
                run_on_dask(client, "Slurm", job, dispatcher, upkeep.check)


@contextmanager
def _cluster(path: Path, jobs: SlurmJobs) -> Iterator[SLURMCluster]:
    """A scheduler in this process, without workers; leaving the block ends its jobs.

    Raises `InputError` if Slurm or this machine cannot run such jobs.
    """
    import dask
    from dask_jobqueue import SLURMCluster

    # No dashboard: its port may be in use.
    site = dask.config.get("jobqueue.slurm.scheduler-options", None) or {}
    options = {"dashboard": False, "dashboard_address": ":0", **site}
    with quiet_libraries():
        try:
            with warnings.catch_warnings():
                # Without a network, Dask guesses this machine's address, with a warning.
                warnings.simplefilter("ignore")
                cluster = SLURMCluster(
                    **jobs.cluster_arguments(),
                    job_name=_JOB_NAME,
                    scheduler_options=options,
                    silence_logs=False,
                )
        except (OSError, ValueError, RuntimeError) as error:
            reason = " ".join(str(error).split()) or type(error).__name__
            raise InputError(path, f"cannot be used on this machine: {reason}") from None
        try:
            _check_accepted(path, str(cluster.job_script()))
            yield cluster
        finally:
            cluster.close(timeout=_ANSWER_S)


def _check_accepted(path: Path, job_script: str) -> None:
    """Raise `InputError` if Slurm would not accept a job."""
    with tempfile.NamedTemporaryFile("w", suffix=".sh") as file:
        file.write(job_script)
        file.flush()
        result = _run(["sbatch", "--test-only", file.name])
    if result is None or result.returncode:
        reason = "no answer" if result is None else (result.stderr.strip() or result.stdout.strip())
        raise InputError(path, f"Slurm refuses such a job: {' '.join(reason.split())}")


def _run(command: list[str]) -> subprocess.CompletedProcess[str] | None:
    try:
        return subprocess.run(command, capture_output=True, text=True, timeout=_ANSWER_S)
    except (OSError, subprocess.TimeoutExpired):
        return None


class _Upkeep:
    """Submits jobs, resubmits those that have ended, and detects when none is left."""

    def __init__(self, cluster: SLURMCluster, jobs: int) -> None:
        self._cluster, self._jobs = cluster, jobs
        self._submitted = self._checked = time.monotonic()
        self._checks_without_job = 0
        cluster.scale(jobs=jobs)

    def check(self, present: bool) -> None:
        """Called once a second; raises `WorkerError` if there is no worker and no job waits or runs."""
        now = time.monotonic()
        if now - self._submitted > _RENEW_S:
            self._submitted = now
            self._cluster.scale(jobs=self._jobs)
        if present:
            self._checks_without_job = 0
        elif now - self._checked > _QUEUE_CHECK_S:
            self._checked = now
            self._checks_without_job = 0 if self._has_job() else self._checks_without_job + 1
        if self._checks_without_job >= _QUEUE_CHECKS:
            raise WorkerError(
                "Slurm has none of the jobs any more, and no worker has started; see their output "
                "(log_directory) for the reason; complete frames are kept"
            )

    def _has_job(self) -> bool:
        """Whether a job of this build waits or runs."""
        workers: dict[Any, Any] = dict(self._cluster.workers)
        numbers = [str(worker.job_id) for worker in workers.values() if worker.job_id is not None]
        if not numbers:
            return False
        result = _run(["squeue", "--noheader", "--format=%i", f"--jobs={','.join(numbers)}"])
        return result is not None and bool(result.stdout.strip())
