"""A plant: its organs with poses and measures, and the parameters from which they are built."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.cultivar import Cultivar, OrganForm, OrganKind
from pepperscene.grammar.hashing import FloatArray

Indices = NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class Organ:
    """One organ in plant coordinates: metres, z up, the stem's foot at the origin, -y towards the aisle.

    Attributes:
        kind: its name in the cultivar file, such as "lamina" or "shoot_petiole".
        parent: index of the organ that bears it, in the plant's list; -1 for the first internode.
        phytomer: position along the main stem, 0-based from the ground.
        curve: `(k, 3)` centreline from base to tip, metres, k >= 2: a tube's axis, a lamina's midrib, the
            line from a fruit's stalk end to its blossom end, the short axis of a node, a calyx or a cut.
        up: `(3,)` unit vector across the base of the curve: the upper (adaxial) side of a lamina or petiole.
        measures: sizes and shape parameters, metres and radians, by the names that its mesh generator reads.
    """

    kind: str
    parent: int
    phytomer: int
    curve: FloatArray
    up: FloatArray
    measures: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Plant:
    """All organs of one plant; parents come before their children.

    Attributes:
        cultivar: its name.
        organs: ordered so that parents come first.
        kinds: form, label and surface of each organ kind.
        grown_from: the cultivar, whose pigments give the colours of the organs; None if it is unknown.
    """

    cultivar: str
    organs: tuple[Organ, ...]
    kinds: Mapping[str, OrganKind]
    grown_from: Cultivar | None = None

    def __repr__(self) -> str:
        height = max((float(organ.curve[:, 2].max()) for organ in self.organs), default=0.0)
        fruit = len(self.of_form("fruit"))
        return f"Plant({self.cultivar}, {len(self.organs)} organs, {fruit} fruit, {height:.2f} m high)"

    def _repr_html_(self) -> str:
        """A drawing from the side, for notebooks."""
        from pepperscene.notebook_view import figure_html, object_html

        return object_html(repr(self), [figure_html(_plant_svg(self), "seen along y")])

    def of_kind(self, name: str) -> tuple[Organ, ...]:
        """Organs of one kind, in order."""
        return tuple(organ for organ in self.organs if organ.kind == name)

    def of_form(self, form: OrganForm) -> tuple[Organ, ...]:
        """Organs of all kinds of one form, in order."""
        return tuple(organ for organ in self.organs if self.kinds[organ.kind].form == form)


# Drawings of plants from the side, for notebooks.
_HEIGHT_PX: Final = 480  # chosen: a plant of four metres is then legible in a notebook
_MARGIN_M: Final = 0.1  # chosen: half of a large leaf
_BLADE: Final = 0.4  # chosen: drawn part of a blade's width, because most blades are seen at an angle
_STROKES: Final[dict[OrganForm, tuple[str, float]]] = {
    "internode": ("#6b8e4e", 8.0),
    "node": ("#6b8e4e", 10.0),
    "stalk": ("#86ab5f", 4.0),
    "blade": ("#2e7d32", 0.0),
    "peduncle": ("#4f7d3a", 6.0),
    "calyx": ("#4f7d3a", 8.0),
    "fruit": ("#c62828", 0.0),
    "flower": ("#dddddd", 12.0),
}
"""Chosen: colour and width in millimetres of the strokes of each form; 0 for the organ's own width."""
_RIPE: Final = 0.5  # chosen: ripeness from which fruit is drawn in its ripe colour
_UNRIPE: Final = "#33691e"


def _plant_svg(plant: Plant) -> str:
    """SVG of the centrelines of all organs, seen along y: blades and fruit about as wide as they are."""
    points = np.concatenate([np.zeros((1, 3)), *(organ.curve for organ in plant.organs)])
    left, bottom = points[:, 0].min() - _MARGIN_M, points[:, 2].min() - _MARGIN_M
    width, height = np.ptp(points[:, 0]) + 2 * _MARGIN_M, np.ptp(points[:, 2]) + 2 * _MARGIN_M
    # Millimetres, y downwards.
    lines = "".join(
        _organ_line(plant.kinds[organ.kind].form, organ, left, bottom + height) for organ in plant.organs
    )
    return (
        f'<svg height="{_HEIGHT_PX}" viewBox="0 0 {1e3 * width:.0f} {1e3 * height:.0f}" '
        f'xmlns="http://www.w3.org/2000/svg" fill="none" stroke-linecap="round">{lines}</svg>'
    )


def _organ_line(form: OrganForm, organ: Organ, left: float, top: float) -> str:
    measures, curve = organ.measures, organ.curve
    colour, width_mm = _STROKES.get(form, ("#888888", 4.0))
    if width_mm == 0.0:
        width_mm = 1e3 * measures.get("diameter_m", _BLADE * measures.get("width_m", 0.01))
    if measures.get("ripeness", 1.0) < _RIPE:
        colour = _UNRIPE
    x, y = 1e3 * (curve[:, 0] - left), 1e3 * (top - curve[:, 2])
    path = " ".join(f"{a:.0f},{b:.0f}" for a, b in zip(x, y, strict=True))
    return f'<polyline points="{path}" stroke="{colour}" stroke-width="{width_mm:.0f}" stroke-opacity="0.7"/>'


@dataclass(frozen=True, eq=False)
class KindParameters:
    """All organs of one kind, one row each; metres, radians and plain numbers.

    Attributes:
        kind: form, label and surface.
        number: `(n,)` of each organ in the plant; a fruit's calyx has the number before.
        parent: `(n,)` number of the organ that bears it; -1 for the first internode. Of a fruit, the organ
            that bears its calyx.
        phytomer: `(n,)` position along the main stem, 0-based from the ground.
        values: name -> `(n,)`. The names are those of the form's parameters in a cultivar file (`length`,
            `diameter`, `inclination`), and in addition: `seed`, in (0, 1), of the organ's own noise;
            `azimuth`, around the vertical, counter-clockwise seen from above, relative to the aisle (-y) for
            organs on nodes and to the parent's own direction for all others; `at`, position along the parent,
            0 base to 1 tip; `lift` on a node, in half node lengths above its centre; `sideways`, 1 for organs
            that leave their parent's side in its plane, as leaflets do, otherwise 0.
            An internode has the `azimuth` and `inclination` of its direction, `diameter` and `diameter_tip`
            of the stem, `state` and `state_tip`; a node the stem's `diameter` and `groove`; a fruit its
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

    def select(self, rows: Indices) -> KindParameters:
        """The organs of these rows."""
        if len(rows) == len(self):
            return self
        values = {name: column[rows] for name, column in self.values.items()}
        return KindParameters(self.kind, self.number[rows], self.parent[rows], self.phytomer[rows], values)


@dataclass(frozen=True, eq=False)
class PlantParameters:
    """Parameters of all organs of one plant.

    Attributes:
        cultivar: its name.
        organs: name of a kind -> its organs; kinds of which the plant has none have no rows.
        drawn_from: the cultivar; None if it is unknown.
    """

    cultivar: str
    organs: Mapping[str, KindParameters]
    drawn_from: Cultivar | None = None

    def with_values(self, kind: str, row: int, **values: float) -> PlantParameters:
        """Replace some numbers of one organ.

        Args:
            kind: name of its kind.
            row: index of the organ among those of that kind, 0-based from the ground.
            values: the new numbers, by the names of `KindParameters.values`.

        Raises:
            ValueError: there is no such kind, organ or number, or a new number is not finite.
        """
        group = self.organs.get(kind)
        if group is None or row not in range(len(group)):
            raise ValueError(f"the plant has no organ {row} of the kind {kind}")
        unknown = set(values) - set(group.values)
        if unknown:
            raise ValueError(f"{kind} has no {sorted(unknown)[0]}; it has {', '.join(group.values)}")
        columns = {name: column.copy() for name, column in group.values.items()}
        for name, value in values.items():
            if not np.isfinite(value):
                raise ValueError(f"{name} must be a finite number, not {value}")
            columns[name][row] = value
        return replace(self, organs={**self.organs, kind: replace(group, values=columns)})


_SMALLEST: Final = 1e-4  # m, chosen: smaller than any visible organ
_INF: Final = float("inf")

# Chosen: beyond these a mesh would vanish or turn inside out. Angles have no limits.
_LIMITS: Final[Mapping[str, tuple[float, float]]] = {
    **dict.fromkeys(("length", "width", "diameter"), (_SMALLEST, _INF)),
    **dict.fromkeys(("groove", "margin_wave", "margin_waves", "blister", "vein"), (0.0, _INF)),
    **dict.fromkeys(("lobes", "lobe_depth", "shoulder", "bites", "bite_width", "tears"), (0.0, _INF)),
    **dict.fromkeys(("sinus", "teeth", "tooth_depth"), (0.0, _INF)),
    **dict.fromkeys(("state", "state_spread", "residue", "ageing", "tear_depth"), (0.0, 1.0)),
    **dict.fromkeys(("ripeness", "ripeness_spread"), (0.0, 1.0)),
    **dict.fromkeys(("point", "calyx_tooth", "calyx_state", "open"), (0.0, 1.0)),
    **dict.fromkeys(("tip", "base"), (0.05, 20.0)),
    "slenderness": (0.1, 10.0),
    "widest": (0.05, 0.95),
    "asymmetry": (-0.9, 0.9),
    "taper": (0.05, 5.0),
    "calyx_radius": (0.02, 10.0),
    "neck": (0.2, 1.0),
    "neck_length": (0.02, 1.0),
}


def clip_to_limits(name: str, values: FloatArray) -> FloatArray:
    """Clip the values of a parameter to the limits of an organ."""
    low, high = _LIMITS.get(name, (-_INF, _INF))
    return values if low == -_INF else np.minimum(np.maximum(values, low), high)
