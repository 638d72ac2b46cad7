"""Frames made in this very process, with all of its cores."""

from __future__ import annotations

import platform
from collections.abc import Sequence
from itertools import chain
from typing import final

from pepperscene.dataset.work.crew import Crew, Notice
from pepperscene.dataset.work.job import Job, Maker, Tell
from pepperscene.dataset.work.units import Unit


@final
class Here(Crew):
    """This process. It shares frames' work out to all cores, and needs the memory of one."""

    size = 1

    def make(self, job: Job, units: Sequence[Unit], tell: Tell, notice: Notice) -> None:
        """See `Crew.make`; frames are told in ascending order."""
        with Maker(job, platform.node()) as maker:
            maker.make(chain.from_iterable(unit.indices for unit in units), tell)
