"""All numbers that make one plant, drawn or given: from them alone it can be built again."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pepperscene.cultivar.forms import Kind

FloatArray = NDArray[np.float64]
Indices = NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class KindParameters:
    """All organs of one kind, a row each; metres, radians and plain numbers.

    Attributes:
        kind: their body, label and surface.
        number: `(n,)` of each organ in the plant; a fruit's calyx stands just before it.
        parent: `(n,)` number of the organ that each grows out of; -1 for the first internode. Of a fruit,
            what bears its calyx.
        phytomer: `(n,)` position along the main stem, 0-based from the ground.
        values: name -> `(n,)`. The names are those of the form's parameters in a cultivar file (`length`,
            `diameter`, `inclination`), and besides: `seed`, in (0, 1), of the organ's own noise; `azimuth`,
            around the vertical, counter-clockwise seen from above, from the aisle (-y) for what stands on a
            node and from its parent's own direction for all others; `at`, its place along the parent, 0 base
            to 1 tip; `lift` on a node, in half node lengths above its centre; `sideways`, 1 for what leaves
            its parent's side and lies in its parent's plane, as a leaflet does, otherwise 0.
            An internode has `azimuth` and `inclination` of its direction, `diameter` and `diameter_tip` of
            the stem, `state` and `state_tip`; a node the stem's `diameter` and `groove`; a fruit its
            `ripeness` and `calyx_seed`.
    """

    kind: Kind
    number: Indices
    parent: Indices
    phytomer: Indices
    values: Mapping[str, FloatArray]

    def __post_init__(self) -> None:
        for column in (self.number, self.parent, self.phytomer, *self.values.values()):
            column.flags.writeable = False

    def __len__(self) -> int:
        return len(self.number)

    def picked(self, rows: Indices) -> KindParameters:
        """Some of the organs."""
        if len(rows) == len(self):
            return self
        values = {name: column[rows] for name, column in self.values.items()}
        return KindParameters(self.kind, self.number[rows], self.parent[rows], self.phytomer[rows], values)


@dataclass(frozen=True, eq=False)
class PlantParameters:
    """A plant from the ground up.

    Attributes:
        cultivar: its name.
        organs: kind's name -> its organs; kinds of which the plant has none are there without rows.
    """

    cultivar: str
    organs: Mapping[str, KindParameters]

    def changed(self, kind: str, row: int, **values: float) -> PlantParameters:
        """The same plant, but for some numbers of one organ.

        Args:
            kind: name of its kind.
            row: which organ of that kind, 0-based from the ground.
            values: the new numbers, by the names of `KindParameters.values`.

        Raises:
            ValueError: there is no such kind, organ or number, or a new number is not finite.
        """
        found = self.organs.get(kind)
        if found is None or row not in range(len(found)):
            raise ValueError(f"the plant has no organ {row} of the kind {kind}")
        unknown = set(values) - set(found.values)
        if unknown:
            raise ValueError(f"{kind} has no {sorted(unknown)[0]}; it has {', '.join(found.values)}")
        columns = {name: column.copy() for name, column in found.values.items()}
        for name, value in values.items():
            if not np.isfinite(value):
                raise ValueError(f"{name} must be a finite number, not {value}")
            columns[name][row] = value
        return replace(self, organs={**self.organs, kind: replace(found, values=columns)})
