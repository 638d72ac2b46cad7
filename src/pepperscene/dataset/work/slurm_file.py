"""The file that tells what jobs to ask Slurm for."""

from __future__ import annotations

import os
import re
from pathlib import Path
from typing import Annotated, Any, Final, Self

from pydantic import AfterValidator, Field, model_validator

from pepperscene.document import Document, read_toml, validated

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
    return validated(SlurmJobs, tables, path)
