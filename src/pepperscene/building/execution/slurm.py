"""The executor that submits jobs to a Slurm cluster when a build starts, and ends them with it."""

from __future__ import annotations

import os
import shutil
import subprocess
import tempfile
import time
import warnings
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, final

from pepperscene.building.execution.credentials import temporary_credentials
from pepperscene.building.execution.dask_executor import connect, missing_extra, quiet_libraries, run_on_dask
from pepperscene.building.execution.executor import Dispatcher, Executor
from pepperscene.building.execution.job import BuildJob
from pepperscene.building.execution.slurm_jobs import SlurmJobs, read_slurm_file
from pepperscene.errors import InputError, SetupError, WorkerError

if TYPE_CHECKING:
    from dask_jobqueue import SLURMCluster
    from distributed.security import Security


_COMMANDS: Final = ("sbatch", "squeue", "scancel")
_JOB_NAME: Final = "pepperscene"
_SITE_OPTIONS: Final = ("host", "interface", "port", "contact_address")
"""Options of the scheduler that a site may set in Dask's configuration."""
_RENEW_S: Final = 60.0  # chosen: interval after which expired jobs are submitted again
_QUEUE_CHECK_S: Final = 10.0  # chosen: how often the queue is checked while there is no worker
_QUEUE_CHECKS: Final = (
    6  # chosen: checks in a row without a job; Slurm's controller is at times too busy to answer
)
_ANSWER_S: Final = 60.0  # chosen: how long Slurm may take to answer


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
        with ExitStack() as stack:
            credentials = stack.enter_context(temporary_credentials(_credentials_folders(self._jobs, job)))
            cluster = stack.enter_context(_cluster(self._path, self._jobs, credentials))
            upkeep = _Upkeep(cluster, self._jobs.jobs)
            dispatcher.on_notice(
                f"{self._jobs.jobs} jobs were submitted to Slurm; frames are made once one of them runs"
            )
            client = stack.enter_context(connect(cluster.scheduler_address, credentials))
            run_on_dask(client, "Slurm", job, dispatcher, upkeep.check)


def _credentials_folders(jobs: SlurmJobs, job: BuildJob) -> tuple[Path, ...]:
    """Folders that the nodes see, for the key of a build, in the order of preference."""
    if jobs.credentials_directory is not None:
        return (Path(jobs.credentials_directory),)
    # Nodes see the data set in any case, but its folder may be shared with a group of users.
    existing = next(path for path in (job.folder, *job.folder.absolute().parents) if path.is_dir())
    return existing, Path(os.path.expanduser("~"))


@contextmanager
def _cluster(path: Path, jobs: SlurmJobs, credentials: Security) -> Iterator[SLURMCluster]:
    """A scheduler in this process, without workers; leaving the block ends its jobs.

    Raises `InputError` if Slurm or this machine cannot run such jobs.
    """
    import dask
    from dask_jobqueue import SLURMCluster

    from pepperscene.building.execution.dask_servers import SchedulerWithoutHttp
    from pepperscene.building.execution.slurm_script import SlurmJob, site_setting

    interface = jobs.interface or site_setting("interface")
    # The folder has mode 0700.
    with tempfile.TemporaryDirectory(prefix="pepperscene-") as private, quiet_libraries():
        try:
            # Dask adds its folder to the search path of modules; in /tmp, other users may make that folder.
            with warnings.catch_warnings(), dask.config.set({"temporary-directory": private}):
                # Without a network, Dask guesses this machine's address, with a warning.
                warnings.simplefilter("ignore")
                cluster = SLURMCluster(
                    job_cls=SlurmJob,
                    jobs=jobs,
                    credentials=credentials,
                    script_folder=Path(private),
                    interface=interface,
                    processes=jobs.workers,
                    job_name=_JOB_NAME,
                    protocol="tls://",
                    security=credentials,
                    scheduler_cls=SchedulerWithoutHttp,
                    scheduler_options=_scheduler_options(jobs, interface),
                    silence_logs=False,
                )
        except (OSError, ValueError, RuntimeError) as error:
            reason = " ".join(str(error).split()) or type(error).__name__
            raise InputError(path, f"cannot be used on this machine: {reason}") from None
        try:
            _check_accepted(path, cluster)
            yield cluster
        finally:
            cluster.close(timeout=_ANSWER_S)


def _scheduler_options(jobs: SlurmJobs, interface: str | None) -> dict[str, Any]:
    """The scheduler's address as the site has it, on one interface, and encryption whatever the site has."""
    from distributed.utils import get_ip

    from pepperscene.building.execution.slurm_script import site_setting

    site = dict(site_setting("scheduler-options") or {})
    options = {key: site[key] for key in _SITE_OPTIONS if key in site}
    if jobs.interface is not None:
        options.pop("host", None)
        options["interface"] = jobs.interface
    elif interface is None and not options.keys() & {"host", "interface"}:
        # Without an address, a scheduler would listen on all interfaces. This is the address that it would
        # announce: of the interface by which this machine reaches other networks.
        options["host"] = get_ip()
    return {**options, "dashboard": False}


def _check_accepted(path: Path, cluster: SLURMCluster) -> None:
    """Raise `InputError` if Slurm would not accept a job."""
    with cluster._dummy_job.job_file() as script:
        result = _run(["sbatch", "--test-only", script])
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
