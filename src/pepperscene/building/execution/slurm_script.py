"""The script of a Slurm job that starts Dask workers."""

from __future__ import annotations

import os
import shlex
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, final

import dask
from dask_jobqueue.slurm import SLURMJob

from pepperscene.building.execution.dask_servers import WORKER_CLASS
from pepperscene.building.execution.slurm_jobs import SlurmJobs

if TYPE_CHECKING:
    from distributed.security import Security


def site_setting(key: str) -> Any:
    """A value of Dask's configuration for Slurm, which a site may have adapted; None if it is not set."""
    return dask.config.get(f"jobqueue.slurm.{key}", None)


@final
class SlurmJob(SLURMJob):
    """A job that starts workers which have the credentials of a build, and no HTTP server.

    All values of the user's file are words of the script, whatever characters they contain; only its
    directives and prologue are lines of the script. Values of Dask's configuration are text of the script,
    as dask-jobqueue has it, so that they may contain variables of the shell.

    Args:
        scheduler: address.
        name: of the workers.
        jobs: the user's file.
        credentials: whose files the workers read.
        script_folder: that only this user can write to, for the script on its way to `sbatch`.
        interface: of the user's file or of the site.
        others: arguments of `SLURMJob`.
    """

    job_header: str

    def __init__(
        self,
        scheduler: str | None = None,
        name: str | None = None,
        *,
        jobs: SlurmJobs,
        credentials: Security,
        script_folder: Path,
        interface: str | None = None,
        **others: Any,
    ) -> None:
        # `SLURMJob` would write the paths of credentials without quotation marks.
        del others["security"]
        tls = credentials.get_tls_config_for_role("worker")
        options = [
            f"--tls-{key}={shlex.quote(tls[key.replace('-', '_')])}" for key in ("ca-file", "cert", "key")
        ]
        super().__init__(
            scheduler,
            name,
            queue=jobs.partition,
            account=jobs.account,
            walltime=jobs.walltime,
            cores=jobs.cores,
            memory=jobs.memory,
            python=_python(jobs),
            interface=interface and shlex.quote(interface),
            local_directory='"$pepperscene_folder"',
            worker_extra_args=[
                *(site_setting("worker-extra-args") or site_setting("extra") or []),
                *options,
                "--no-dashboard",
                f"--worker-class={WORKER_CLASS}",
            ],
            job_extra_directives=list(jobs.directives) or None,
            job_script_prologue=[
                *(jobs.prologue or site_setting("job-script-prologue") or site_setting("env-extra") or []),
                *_protect_modules(jobs),
            ],
            **others,
        )
        if jobs.log_directory is not None:
            os.makedirs(jobs.log_directory, exist_ok=True)
            self.job_header = "\n".join(
                [*_log_directives(jobs.log_directory, self.job_name), self.job_header]
            )
        self._script_folder = script_folder

    @contextmanager
    def job_file(self) -> Iterator[str]:
        """The script as a file that other users can neither read nor replace before Slurm has read it."""
        with tempfile.NamedTemporaryFile(
            "w", suffix=".sh", dir=self._script_folder, encoding="utf-8"
        ) as file:
            file.write(self.job_script())
            file.flush()
            yield file.name


def _python(jobs: SlurmJobs) -> str | None:
    """The user's Python, or None if the site has one."""
    python = jobs.python or (None if site_setting("python") else sys.executable)
    return python and shlex.quote(python)


def _protect_modules(jobs: SlurmJobs) -> tuple[str, ...]:
    """Lines after which Python imports no module that another user of the node may have written.

    Dask adds its folder to the search path, so it gets one that only this user can read, which the job
    removes at the end. `python -m` adds the current folder.
    """
    parent = shlex.quote(jobs.local_directory) if jobs.local_directory else site_setting("local-directory")
    parent = parent or '"${TMPDIR:-/tmp}"'
    return (
        f"mkdir -p -- {parent} && pepperscene_folder=$(mktemp -d -- {parent}/pepperscene-XXXXXXXXXX) || exit",
        """trap 'rm -rf -- "$pepperscene_folder"' EXIT""",
        "export PYTHONSAFEPATH=1",
    )


def _log_directives(folder: str, name: str) -> tuple[str, ...]:
    """Lines for the output of the job; Slurm replaces single percent signs and keeps double ones."""
    path = f"{folder.replace('%', '%%')}/{name}-%J"
    return tuple(
        f"#SBATCH -{option} {shlex.quote(f'{path}.{end}')}" for option, end in (("e", "err"), ("o", "out"))
    )
