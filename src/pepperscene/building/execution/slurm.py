"""The executor that submits jobs to a Slurm cluster when a build starts, and ends them with it."""

from __future__ import annotations

import os
import re
import shlex
import shutil
import subprocess
import sys
import tempfile
import time
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final, Self, final

from pydantic import AfterValidator, Field, model_validator

from pepperscene.building.execution.dask_executor import connect, missing_extra, quiet_libraries, run_on_dask
from pepperscene.building.execution.executor import Dispatcher, Executor
from pepperscene.building.execution.job import BuildJob
from pepperscene.document import Document, read_toml, validate
from pepperscene.errors import InputError, SetupError, WorkerError

if TYPE_CHECKING:
    from dask_jobqueue import SLURMCluster
    from distributed import Security

_COMMANDS: Final = ("sbatch", "squeue", "scancel")
_SITE_OPTIONS: Final = ("host", "interface", "port", "contact_address")
"""Options of the scheduler that a site may set in Dask's configuration; others could end encryption."""
_RENEW_S: Final = 60.0  # chosen: interval after which expired jobs are submitted again
_QUEUE_CHECK_S: Final = 10.0  # chosen: how often the queue is checked while there is no worker
_QUEUE_CHECKS: Final = 6  # chosen: checks in a row without a job; Slurm can be too busy to answer
_ANSWER_S: Final = 60.0  # chosen: how long Slurm may take to answer

_PATHS: Final = ("python", "local_directory", "log_directory", "credentials_directory")
_WORD: Final = re.compile(r"[\w.,:@%+=/-]+")
"""Characters that neither a shell nor `sbatch` takes for anything else: dask-jobqueue quotes nothing."""
_MEMORY: Final = re.compile(r"\d+(\.\d+)? ?[MGT](i?B)?", re.ASCII)
_WALLTIME: Final = re.compile(r"\d+(:\d\d){0,2}|\d+-\d\d?(:\d\d){0,2}", re.ASCII)
"""Minutes, minutes:seconds, hours:minutes:seconds, days-hours and so on, as in the manual of `sbatch`."""


def _must_be(description: str, test: Callable[[str], object]) -> AfterValidator:
    def check(text: str) -> str:
        if not test(text):
            raise ValueError(f"must be {description}")
        return text

    return AfterValidator(check)


_Line = Annotated[str, _must_be("a line of text", lambda text: text and text.isprintable())]
_Word = Annotated[
    str, _must_be("a word without blanks, quotes and other special characters", _WORD.fullmatch)
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
        interface: of the network that the nodes and this machine share ("ib0"); None for the one by which
            this machine reaches other networks.
        local_directory: on a node's disk, for Dask's files; None for the node's temporary folder.
        log_directory: of the jobs' output; None for Slurm's default.
        credentials_directory: that the nodes and this machine share, where the build keeps its key; None for
            the home folder.
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
    python: _Word | None = None
    interface: _Word | None = None
    local_directory: _Word | None = None
    log_directory: _Word | None = None
    credentials_directory: _Word | None = None

    @model_validator(mode="after")
    def _check(self) -> Self:
        if self.workers > self.cores:
            raise ValueError(f"workers = {self.workers} must not be more than cores = {self.cores}")
        return self


def read_slurm_file(path: Path) -> SlurmJobs:
    """Read a description of jobs; its paths are relative to the file's folder.

    Raises:
        InputError: the file is missing or not TOML, a key is unknown or missing, or a value is not valid.
    """
    tables = read_toml(path)
    for key in _PATHS:
        value = tables.get(key)
        # What is not a line of text is rejected below.
        if isinstance(value, str) and value.isprintable() and (key != "python" or os.sep in value):
            tables[key] = os.path.normpath(path.absolute().parent / os.path.expanduser(value))
    return validate(SlurmJobs, tables, path)


@final
class SlurmExecutor(Executor):
    """Workers in jobs of a Slurm cluster, described by a file (see `SlurmJobs`).

    The scheduler runs in this process, and answers only processes with the build's key. Jobs may wait in
    Slurm's queue; frames are made as soon as the first one runs. An expired job is submitted again. Raises
    `InputError` if the file is not valid, and `SetupError` if this machine cannot submit jobs, or the extra
    `cluster` is not installed.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._jobs = read_slurm_file(path)
        try:
            import cryptography  # noqa: F401 - for temporary credentials
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
            with connect(cluster.scheduler_address, cluster.security) as client:
                run_on_dask(client, "Slurm", job, dispatcher, upkeep.check)


@contextmanager
def _cluster(path: Path, jobs: SlurmJobs) -> Iterator[SLURMCluster]:
    """A scheduler in this process, without workers; leaving the block ends its jobs.

    Raises `InputError` if Slurm or this machine cannot run such jobs.
    """
    import dask
    from dask_jobqueue import SLURMCluster

    with (
        tempfile.TemporaryDirectory(prefix="pepperscene-") as private,
        _temporary_credentials(path, jobs) as credentials,
        quiet_libraries(),
    ):
        try:
            # Dask adds its folder to the search path of modules; in /tmp, other users may make that folder.
            # HTTP servers without routes answer nothing.
            private_scheduler = {"temporary-directory": private, "distributed.scheduler.http.routes": []}
            with warnings.catch_warnings(), dask.config.set(private_scheduler):
                # Without a network, Dask guesses this machine's address, with a warning.
                warnings.simplefilter("ignore")
                cluster = SLURMCluster(
                    queue=jobs.partition,
                    account=jobs.account,
                    walltime=jobs.walltime,
                    cores=jobs.cores,
                    memory=jobs.memory,
                    processes=jobs.workers,
                    job_name="pepperscene",
                    python=jobs.python or (None if _site("python") else shlex.quote(sys.executable)),
                    interface=jobs.interface,
                    local_directory='"$pepperscene_folder"',
                    log_directory=jobs.log_directory,
                    job_extra_directives=list(jobs.directives) or None,
                    job_script_prologue=[
                        *(jobs.prologue or _site("job-script-prologue") or ()),
                        *_isolate(jobs.local_directory or _site("local-directory")),
                    ],
                    worker_extra_args=[*(_site("worker-extra-args") or ()), "--no-dashboard"],
                    protocol="tls://",
                    security=credentials,
                    scheduler_options=_scheduler_options(jobs),
                    silence_logs=False,
                )
        except (OSError, ValueError, RuntimeError) as error:
            reason = " ".join(str(error).split()) or type(error).__name__
            raise InputError(path, f"cannot be used on this machine: {reason}") from None
        try:
            _check_accepted(path, cluster.job_script(), Path(private))
            yield cluster
        finally:
            cluster.close(timeout=_ANSWER_S)


@contextmanager
def _temporary_credentials(path: Path, jobs: SlurmJobs) -> Iterator[Security]:
    """A certificate and its key for one build, as files that only this user can read and the nodes see.

    The key is needed to use any process of the cluster. Dask-jobqueue would write the files, too, but keep
    them until its objects are collected.
    """
    from distributed import Security

    parent, problem = Path(jobs.credentials_directory or os.path.expanduser("~")), ""
    try:
        # Who may rename the folder could give the workers another key.
        if parent.stat().st_mode & 0o022:
            problem = f"{parent} can be written to by other users"
        elif not _WORD.fullmatch(str(parent)):
            problem = f"{parent} has blanks or special characters in its path"
        else:
            folder = tempfile.mkdtemp(prefix=".pepperscene-", dir=parent)
    except OSError as error:
        problem = f"{parent} cannot be written to ({error.strerror})"
    if problem:
        raise InputError(
            path, f"must be a folder for the key of a build: {problem}", key="credentials_directory"
        )
    try:
        temporary, files = Security.temporary(), []
        for name, text in (
            ("certificate.pem", temporary.tls_worker_cert),
            ("key.pem", temporary.tls_worker_key),
        ):
            file = Path(folder, name)
            file.touch(mode=0o600)
            file.write_text(text)
            files.append(str(file))
        roles = ("scheduler", "worker", "client")
        yield Security(
            require_encryption=True,
            tls_ca_file=files[0],
            **{f"tls_{role}_cert": files[0] for role in roles},
            **{f"tls_{role}_key": files[1] for role in roles},
        )
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def _isolate(parent: str | None) -> tuple[str, ...]:
    """Lines after which a worker imports no module that another user may have written, and has no pages.

    Dask adds its folder to the search path, so it gets one that only this user can read, which the job
    removes at the end. `python -m` adds the current folder.
    """
    parent = parent or '"${TMPDIR:-/tmp}"'
    return (
        f"mkdir -p -- {parent} && pepperscene_folder=$(mktemp -d -- {parent}/pepperscene-XXXXXXXXXX) || exit",
        """trap 'rm -rf -- "$pepperscene_folder"' EXIT""",
        "export PYTHONSAFEPATH=1 DASK_DISTRIBUTED__WORKER__HTTP__ROUTES='[]'",
    )


def _site(key: str) -> Any:
    """A value of Dask's configuration for Slurm, which a site may have adapted; None if it is not set."""
    import dask

    return dask.config.get(f"jobqueue.slurm.{key}", None)


def _scheduler_options(jobs: SlurmJobs) -> dict[str, Any]:
    """The scheduler's address as the site has it, unless the file names an interface; no dashboard."""
    site = _site("scheduler-options") or {}
    options = {key: site[key] for key in _SITE_OPTIONS if key in site}
    if jobs.interface is not None:
        options = {key: value for key, value in options.items() if key != "host"}
        options["interface"] = jobs.interface
    return {**options, "dashboard": False, "dashboard_address": ":0"}


def _check_accepted(path: Path, script: str, folder: Path) -> None:
    """Raise `InputError` if Slurm would not accept a job."""
    file = folder / "job.sh"
    file.write_text(script, encoding="utf-8")
    result = _run(["sbatch", "--test-only", str(file)])
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
