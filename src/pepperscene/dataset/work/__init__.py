"""Who makes the frames of a build: this process, a pool of workers on this machine, or a Dask cluster."""

from pepperscene.dataset.work.choice import crew_of
from pepperscene.dataset.work.crew import Crew, Losses, Notice
from pepperscene.dataset.work.here import Here
from pepperscene.dataset.work.job import Done, Job, Maker, Tell
from pepperscene.dataset.work.pool import Pool
from pepperscene.dataset.work.units import Queue, Unit, units_of

__all__ = [
    "Crew",
    "Done",
    "Here",
    "Job",
    "Losses",
    "Maker",
    "Notice",
    "Pool",
    "Queue",
    "Tell",
    "Unit",
    "crew_of",
    "units_of",
]
