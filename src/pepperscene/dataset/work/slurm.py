"""Frames made by jobs of a Slurm cluster, which are asked for when a build begins and end with it."""

from __future__ import annotations

import shutil
import subprocess
import tempfile
import time
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, final

from pepperscene.dataset.work.cluster import connected, missing, quiet
from pepperscene.dataset.work.crew import Crew, Notice
from pepperscene.dataset.work.job import Job, Tell
from pepperscene.dataset.work.slurm_file import SlurmJobs, read_slurm_file
from pepperscene.dataset.work.units import Unit
from pepperscene.errors import InputError, SetupError, WorkerError

if TYPE_CHECKING:
    from dask_jobqueue import SLURMCluster

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
class Slurm(Crew):
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

    def make(self, job: Job, units: Sequence[Unit], tell: Tell, notice: Notice) -> None:
        """See `Crew.make`; the frames of different workers are told as they come."""
        from pepperscene.dataset.work.shift import Shift, marker_beside

        with _cluster(self._path, self._jobs) as cluster:
            upkeep = _Upkeep(cluster, self._jobs.jobs)
            notice(f"Slurm is asked for {self._jobs.jobs} jobs; frames are made once one of them runs")
            with (
                connected(cluster.scheduler_address) as client,
                marker_beside(job.folder) as marker,
                Shift(client, "Slurm", job, marker, units, upkeep.look) as shift,
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
            raise InputError(path, "", None, f"cannot be done here: {_words(fault)}") from None
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
        raise InputError(path, "", None, f"Slurm refuses such a job: {' '.join(words.split())}")


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
