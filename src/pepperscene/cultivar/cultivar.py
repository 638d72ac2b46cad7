"""All parameters of a cultivar's plants, and reading them from a TOML file."""

from __future__ import annotations

import datetime
from pathlib import Path
from typing import Self

from pydantic import model_validator

from pepperscene.cultivar.forms import USUAL, Kind
from pepperscene.cultivar.lineage import inherited, lineage, stated_in
from pepperscene.cultivar.organs import AnyOrgan
from pepperscene.cultivar.pigments import PigmentPath
from pepperscene.cultivar.stem import Stem
from pepperscene.cultivar.structure import CALYX, check
from pepperscene.document import Document, validated
from pepperscene.errors import InputError


class Cultivar(Document):
    """All that is known about a cultivar's plants.

    Attributes:
        name: of the cultivar.
        species: its botanical name.
        source: where the numbers come from.
        date: of the growth stage that they describe.
        stem: the main stem.
        organs: kind -> its parameters and what grows on it.
        pigments: surface -> its path through pigment space.
    """

    name: str
    species: str
    source: str
    date: datetime.date | None = None
    stem: Stem
    organs: dict[str, AnyOrgan]
    pigments: dict[str, PigmentPath]

    @model_validator(mode="after")
    def _fits_together(self) -> Self:
        check(self.stem, self.organs, self.pigments)
        return self

    @property
    def kinds(self) -> dict[str, Kind]:
        """Every kind of organ that a plant can have, the fruit's calyx included."""
        kinds = {name: organ.kind for name, organ in self.organs.items()}
        if any(getattr(organ, "calyx", False) for organ in self.organs.values()):
            kinds[CALYX] = USUAL["calyx"]
        return kinds

    @property
    def grown(self) -> tuple[str, ...]:
        """The kinds that the plants do have, being of a probability above 0; in the file's order."""
        found, waiting = set(), [self.stem.internode, self.stem.node]
        while waiting:
            kind = waiting.pop()
            if kind not in found:
                found.add(kind)
                slots = self.organs[kind].bears
                waiting.extend(k for slot in slots for k in slot.kinds if slot.what.probabilities[k] > 0)
        if any(getattr(self.organs[kind], "calyx", False) for kind in found):
            found.add(CALYX)
        return tuple(kind for kind in self.kinds if kind in found)


def load_cultivar(name_or_path: str | Path) -> Cultivar:
    """A shipped cultivar by its name, or one from a TOML file, with what it inherits from others.

    Raises:
        InputError: not found, not TOML, or a parameter is missing, unknown or not allowed.
    """
    files = lineage(name_or_path)
    tables = inherited(files)
    try:
        return validated(Cultivar, tables, files[0][0])
    except InputError as fault:
        where = stated_in(files, tables, fault.key)
        raise InputError(where, fault.key, fault.value, fault.allowed) from None
