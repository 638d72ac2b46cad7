"""Organs of one kind, built together, on their way into the plant's list."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from pepperscene.grammar.curves import FloatArray
from pepperscene.grammar.parameters import Indices
from pepperscene.grammar.plant import Organ


@dataclass(frozen=True, eq=False)
class Bodies:
    """`n` organs of one kind.

    Attributes:
        kind: its name.
        number: `(n,)` of each in the plant.
        parent: `(n,)` number of what each grows out of.
        phytomer: `(n,)` where they stand.
        curves: `(n, k, 3)` centrelines.
        up: `(n, 3)` upper sides.
        measures: name -> `(n,)`.
    """

    kind: str
    number: Indices
    parent: Indices
    phytomer: Indices
    curves: FloatArray
    up: FloatArray
    measures: Mapping[str, FloatArray]

    def enter(self, organs: list[Organ | None]) -> None:
        """Put the organs at their places in the plant's list."""
        names = tuple(self.measures)
        columns = [column.tolist() for column in self.measures.values()]
        where = zip(self.number.tolist(), self.parent.tolist(), self.phytomer.tolist(), strict=True)
        rows = zip(where, self.curves, self.up, zip(*columns, strict=True), strict=True)
        for (number, parent, phytomer), curve, up, row in rows:
            organs[number] = Organ(self.kind, parent, phytomer, curve, up, dict(zip(names, row, strict=True)))
