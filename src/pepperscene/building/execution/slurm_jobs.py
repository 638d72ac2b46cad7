"""The file that describes Slurm jobs."""

from __future__ import annotations

import os
import re
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Final, Self

from pydantic import AfterValidator, Field, model_validator

from pepperscene.document import Document, read_toml, validate

_MEMORY: Final = re.compile(r"\d+(\.\d+)? ?[MGT](i?B)?", re.ASCII)
_WALLTIME: Final = re.compile(r"\d+(:\d\d){0,2}|\d+-\d\d?(:\d\d){0,2}", re.ASCII)
"""Minutes, minutes:seconds, hours:minutes:seconds, days-hours and so on, as in the manual of `sbatch`."""

_WORD: Final = re.compile(r"[\w.,:@%+=/-]+")
"""Characters that neither a shell nor `sbatch` takes for anything else."""

_QUOTING: Final = frozenset("'\"\\")
"""Characters that `sbatch` takes for quoting in the lines of a script, and a backslash in a path switches
off the number of the job."""


_PATHS: Final = ("python", "local_directory", "log_directory", "credentials_directory")


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
_LogFolder = Annotated[
    _Line, _must_be("a path without quotes and backslashes", lambda text: not _QUOTING & set(text))
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
            the folder of the data set, or else the home folder.
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
    log_directory: _LogFolder | None = None
    credentials_directory: _Line | None = None

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
