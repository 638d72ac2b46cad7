"""A grown plant: organs with poses and measures, no triangles."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.cultivar.organs import OrganForm, OrganKind
from pepperscene.grammar.hashing import FloatArray


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
    kinds: Mapping[str, OrganKind]

    def of_kind(self, name: str) -> tuple[Organ, ...]:
        """The organs of one kind, in order."""
        return tuple(organ for organ in self.organs if organ.kind == name)

    def of_form(self, form: OrganForm) -> tuple[Organ, ...]:
        """The organs of all kinds of one form, in order."""
        names = {name for name, kind in self.kinds.items() if kind.form == form}
        return tuple(organ for organ in self.organs if organ.kind in names)


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

    kind: OrganKind
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


_LEAST: Final = 1e-4  # m, chosen: smaller than any organ that can be seen
_INF: Final = float("inf")

# Chosen: where a body would vanish or turn inside out. Angles have no limits.
_LIMITS: Final[Mapping[str, tuple[float, float]]] = {
    "length": (_LEAST, _INF),
    "width": (_LEAST, _INF),
    "diameter": (_LEAST, _INF),
    "groove": (0.0, _INF),
    "margin_wave": (0.0, _INF),
    "margin_waves": (0.0, _INF),
    "blister": (0.0, _INF),
    "vein": (0.0, _INF),
    "tip": (0.05, 20.0),
    "slenderness": (0.1, 10.0),
    "base": (0.05, 20.0),
    "widest": (0.05, 0.95),
    "asymmetry": (-0.9, 0.9),
    "lobes": (0.0, _INF),
    "lobe_depth": (0.0, _INF),
    "taper": (0.05, 5.0),
    "shoulder": (0.0, _INF),
    "point": (0.0, 1.0),
    "calyx_radius": (0.02, 10.0),
    "calyx_tooth": (0.0, 1.0),
    "calyx_state": (0.0, 1.0),
    "open": (0.0, 1.0),
    "state": (0.0, 1.0),
    "state_spread": (0.0, 1.0),
    "ripeness": (0.0, 1.0),
    "ripeness_spread": (0.0, 1.0),
}


def possible(name: str, values: FloatArray) -> FloatArray:
    """The values of a parameter, none beyond what an organ can have."""
    low, high = _LIMITS.get(name, (-_INF, _INF))
    return values if low == -_INF else np.minimum(np.maximum(values, low), high)
