"""From what a user says to who makes the frames."""

from __future__ import annotations

from pathlib import Path

from pepperscene.dataset.work.crew import Crew
from pepperscene.dataset.work.here import Here
from pepperscene.dataset.work.pool import MOST_WORKERS, Pool
from pepperscene.errors import InputError


def crew_of(
    workers: int | None = None, scheduler: str | None = None, slurm: str | Path | None = None
) -> Crew:
    """This process when nothing is said; else the one of the three that is.

    Raises:
        InputError: more than one is said, or the number or the file is not valid.
        SetupError: the extra `cluster` is not installed.
    """
    said = {"--workers": workers, "--scheduler": scheduler, "--slurm": slurm}
    named = [name for name, value in said.items() if value is not None]
    if len(named) > 1:
        raise InputError(named[1], "", None, f"goes without {named[0]}; one at a time")
    if scheduler is not None:
        from pepperscene.dataset.work.cluster import Cluster

        return Cluster(scheduler)
    if slurm is not None:
        from pepperscene.dataset.work.slurm import Slurm

        return Slurm(Path(slurm))
    if workers is None:
        return Here()
    if not 1 <= workers <= MOST_WORKERS:
        raise InputError("--workers", "", None, f"must be 1 to {MOST_WORKERS}, not {workers}")
    return Pool(workers)
