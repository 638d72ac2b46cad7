"""A grown plant: organs with poses and measures, no triangles."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from pepperscene.cultivar.forms import Form, Kind


@dataclass(frozen=True, eq=False)
class Organ:
    """One organ in plant coordinates: metres, z up, the stem's foot at the origin, -y towards the aisle.

    Attributes:
        kind: its name in the cultivar file, such as "lamina" or "shoot_petiole".
        parent: index of the organ that it grows out of, in the plant's list; -1 for the first internode.
        phytomer: position along the main stem, 0-based from the ground.
        curve: `(k, 3)` centreline from base to tip, metres, k >= 2: a tube's axis, a lamina's midrib, the
            line from a fruit's stalk end to its blossom end, a node's or a calyx's or a cut's short axis.
        up: `(3,)` unit vector across the base of the curve: the upper (adaxial) side of a lamina or petiole.
        measures: sizes and shape parameters, metres and radians, by the names that its mesh maker reads.
    """

    kind: str
    parent: int
    phytomer: int
    curve: NDArray[np.float64]
    up: NDArray[np.float64]
    measures: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Plant:
    """All organs of one plant; a parent stands before its children.

    Attributes:
        cultivar: its name.
        organs: as they grow out of one another.
        kinds: what each organ kind is: its body, label and surface.
    """

    cultivar: str
    organs: tuple[Organ, ...]
    kinds: Mapping[str, Kind]

    def of_kind(self, name: str) -> tuple[Organ, ...]:
        """The organs of one kind, in order."""
        return tuple(organ for organ in self.organs if organ.kind == name)

    def of_form(self, form: Form) -> tuple[Organ, ...]:
        """The organs of all kinds of one form, in order."""
        names = {name for name, kind in self.kinds.items() if kind.form == form}
        return tuple(organ for organ in self.organs if organ.kind in names)
