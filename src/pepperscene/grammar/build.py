"""Building a plant's organs from its parameters: topology, poses and measures, nothing random."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from pepperscene.cultivar.forms import USUAL, Form
from pepperscene.grammar.curves import FloatArray, across, chain, direction, middles, upper_side
from pepperscene.grammar.parameters import (
    CutParameters,
    FruitParameters,
    LeafParameters,
    PhytomerParameters,
    PlantParameters,
    ShootParameters,
)
from pepperscene.grammar.plant import Organ, OrganKind, Plant

_FORMS: Final[dict[str, Form]] = {
    "internode": "internode",
    "node": "node",
    "side_shoot": "stalk",
    "petiole": "stalk",
    "lamina": "blade",
    "peduncle": "peduncle",
    "calyx": "calyx",
    "fruit": "fruit",
    "cut": "cut",
}
KINDS: Final = {name: USUAL[form] for name, form in _FORMS.items()}
INTERNODE_POINTS: Final = 3
SHOOT_POINTS: Final = 6
PETIOLE_POINTS: Final = 10
LAMINA_POINTS: Final = 14
PEDUNCLE_POINTS: Final = 8

# Chosen from photographs:
_PETIOLE_SHARE: Final = 0.5  # of the bend between petiole and blade, that the petiole takes
_JOINT: Final = 0.12  # the rest is taken within about this share of the midrib
_PETIOLE_SWAY: Final = 0.3  # share of a leaf's sway that its petiole takes
_SUNK: Final = 0.8  # parts start this share of the node's radius out, so that no gap shows
_CALYX_HEIGHT: Final = 0.05  # of the fruit's diameter
# Where parts stand on a node, in half node lengths above its centre: a shoot in the axil above its leaf.
_LEAF_LIFT, _SHOOT_LIFT, _FRUIT_LIFT = -0.3, 0.4, 0.1


@dataclass(frozen=True, eq=False)
class NodeFrame:
    """Where a node stands: its index among the organs, centre, axis, radius and half its length."""

    organ: int
    centre: FloatArray
    axis: FloatArray
    radius: float
    half_length: float

    def side(self, azimuth: float, lift: float) -> FloatArray:
        """The point `(3,)` on the node's side where a part starts that grows towards `azimuth`."""
        outward = across(direction(azimuth, 0.0), self.axis)
        return self.centre + lift * self.half_length * self.axis + _SUNK * self.radius * outward


@dataclass
class _Growth:
    """The organs so far; new ones are added at the end, so a parent stands before its children."""

    organs: list[Organ] = field(default_factory=list)
    phytomer: int = 0

    def add(
        self, kind: OrganKind, parent: int, curve: FloatArray, up: FloatArray, measures: dict[str, float]
    ) -> int:
        self.organs.append(Organ(kind, parent, self.phytomer, curve, up, measures))
        return len(self.organs) - 1


def build(parameters: PlantParameters) -> Plant:
    """The plant that the parameters describe; the same parameters give the same arrays, bit for bit."""
    organs, frames = build_frame(parameters)
    fruit = [phytomer.fruit for phytomer in parameters.phytomers]
    return Plant(parameters.cultivar, (*organs, *build_fruit(fruit, frames, len(organs))), KINDS)


def build_frame(parameters: PlantParameters) -> tuple[list[Organ], list[NodeFrame]]:
    """All but fruit and cuts: stem, side shoots and leaves; and where the nodes stand."""
    growth = _Growth()
    frames = _stem(growth, parameters.phytomers)
    for growth.phytomer, (phytomer, frame) in enumerate(zip(parameters.phytomers, frames, strict=True)):
        if phytomer.leaf is not None:
            _leaf(growth, frame.organ, frame.side(phytomer.leaf.azimuth, _LEAF_LIFT), phytomer.leaf)
        if phytomer.shoot is not None:
            _shoot(growth, frame.organ, frame.side(phytomer.shoot.azimuth, _SHOOT_LIFT), phytomer.shoot)
    return growth.organs, frames


def build_fruit(
    fruit: Iterable[FruitParameters | CutParameters | None], frames: Iterable[NodeFrame], first: int
) -> list[Organ]:
    """Peduncles, calyces, fruit and cuts, one entry of `fruit` a node.

    Args:
        fruit: what each node carries.
        frames: where each node stands.
        first: how many organs the plant has already.
    """
    growth = _Growth()
    for growth.phytomer, (one, frame) in enumerate(zip(fruit, frames, strict=True)):
        if isinstance(one, FruitParameters):
            _fruit(growth, frame, one, first)
        elif one is not None:
            _cut(growth, frame, one)
    return growth.organs


def _stem(growth: _Growth, phytomers: tuple[PhytomerParameters, ...]) -> list[NodeFrame]:
    """Internodes and nodes in turn. Node centres are joined by straight sections; nodes take the bends."""
    axes = [direction(one.azimuth, one.inclination) for one in phytomers]
    axes.append(axes[-1])
    centre, above, parent = np.zeros(3), 0.0, -1
    frames = []
    for growth.phytomer, (one, axis, after) in enumerate(zip(phytomers, axes[:-1], axes[1:], strict=True)):
        next_centre = centre + one.length * axis
        half = 0.5 * min(one.node_length, 0.8 * one.length)
        # The section between the two swellings.
        clear = one.length - above - half
        curve = chain(centre + above * axis, np.tile(axis, (INTERNODE_POINTS - 1, 1)), clear)
        up = across(np.array([0.0, -1.0, 0.0]), axis)
        measures = {"radius_m": one.radius, "radius_tip_m": one.radius_tip}
        section = growth.add(
            "internode", parent, curve, up, measures | {"groove_m": one.groove, "seed": one.seed}
        )
        # The swelling, which takes the bend.
        curve = np.stack((curve[-1], next_centre, next_centre + half * after))
        measures = {"radius_m": one.node_radius, "radius_end_m": one.radius_tip}
        parent = growth.add("node", section, curve, up, measures)
        along = axis + after
        frames.append(NodeFrame(parent, next_centre, along / math.sqrt(along @ along), one.node_radius, half))
        centre, above = next_centre, half
    return frames


def _shoot(growth: _Growth, parent: int, base: FloatArray, one: ShootParameters) -> None:
    slopes = one.inclination + one.bend * middles(SHOOT_POINTS)
    steps = direction(one.azimuth, slopes)
    curve = chain(base, steps, one.length)
    up = upper_side(one.azimuth, one.inclination, steps[0])
    measures = {"radius_m": one.radius, "radius_tip_m": one.radius_tip}
    shoot = growth.add("side_shoot", parent, curve, up, measures)
    for end in one.ends:
        if isinstance(end, ShootParameters):
            _shoot(growth, shoot, curve[-1], end)
        else:
            _leaf(growth, shoot, curve[-1], end)


def _leaf(growth: _Growth, parent: int, base: FloatArray, one: LeafParameters) -> None:
    """A petiole that arches over, and a blade that leaves it without a kink and soon hangs."""
    hang = one.inclination + 0.5 * one.droop
    joint = one.petiole_inclination + _PETIOLE_SHARE * (hang - one.petiole_inclination)
    # The petiole bends more the farther out, where it is thinner.
    s = middles(PETIOLE_POINTS)
    slopes = one.petiole_inclination + (joint - one.petiole_inclination) * s**1.5
    steps = direction(one.azimuth, slopes, _PETIOLE_SWAY * one.sway * s)
    curve = chain(base, steps, one.petiole_length)
    up = upper_side(one.azimuth, one.petiole_inclination, steps[0])
    measures = {"radius_m": one.petiole_radius, "radius_tip_m": one.petiole_radius_tip}
    petiole = growth.add("petiole", parent, curve, up, measures)
    # The midrib: from the petiole's end slope into an even droop about its middle.
    s = middles(LAMINA_POINTS)
    slopes = hang - one.droop * s + (joint - hang) * np.exp(-s / _JOINT)
    steps = direction(one.azimuth, slopes, one.sway * (_PETIOLE_SWAY + (1.0 - _PETIOLE_SWAY) * s))
    up = upper_side(one.azimuth, float(slopes[0]), steps[0], one.roll)
    measures = {"length_m": one.length, "width_m": one.width, **one.shape}
    growth.add("lamina", petiole, chain(curve[-1], steps, one.length), up, measures)


def _fruit(growth: _Growth, frame: NodeFrame, one: FruitParameters, first: int) -> None:
    """A peduncle that bends down, the calyx at its end, and the fruit that hangs from it."""
    base = frame.side(one.azimuth, _FRUIT_LIFT)
    steps = direction(one.azimuth, peduncle_slopes(one.inclination, one.end_inclination))
    curve = chain(base, steps, one.peduncle_length)
    up = upper_side(one.azimuth, one.inclination, steps[0])
    measures = {"radius_m": one.peduncle_radius, "radius_tip_m": one.peduncle_radius_tip}
    peduncle = first + growth.add("peduncle", frame.organ, curve, up, measures)
    axis = direction(one.hang_azimuth, one.hang_inclination)
    up = upper_side(one.hang_azimuth, one.hang_inclination, axis)
    stalk_end = curve[-1] + _CALYX_HEIGHT * one.diameter * axis
    measures = {"radius_m": one.calyx_radius, "seed": one.calyx_seed}
    calyx = first + growth.add("calyx", peduncle, np.stack((curve[-1], stalk_end)), up, measures)
    measures = {"length_m": one.length, "diameter_m": one.diameter, **one.shape}
    growth.add("fruit", calyx, np.stack((stalk_end, stalk_end + one.length * axis)), up, measures)


def _cut(growth: _Growth, frame: NodeFrame, one: CutParameters) -> None:
    base = frame.side(one.azimuth, _FRUIT_LIFT)
    axis = direction(one.azimuth, one.inclination)
    # The stump must reach out of the node that it starts in.
    out = (1.0 - _SUNK) * frame.radius + one.length
    up = upper_side(one.azimuth, one.inclination, axis)
    growth.add("cut", frame.organ, np.stack((base, base + out * axis)), up, {"radius_m": one.radius})


def peduncle_slopes(inclination: FloatArray | float, end_inclination: FloatArray | float) -> FloatArray:
    """Inclination of a peduncle's segments, `(..., 7)`: an even bend from the node to the calyx."""
    start, end = np.asarray(inclination)[..., None], np.asarray(end_inclination)[..., None]
    return np.asarray(start + (end - start) * middles(PEDUNCLE_POINTS))


def fruit_centres(
    frame: NodeFrame,
    one: FruitParameters,
    azimuth: FloatArray,
    inclination: FloatArray,
    end_inclination: FloatArray,
    hang_azimuth: FloatArray,
    hang_inclination: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Fruit centre `(k, 3)` and axis `(k, 3)` of a fruit in `k` poses, as `build_fruit` would place it."""
    outward = direction(azimuth, 0.0)
    outward = outward - (outward @ frame.axis)[:, None] * frame.axis
    outward = outward / np.linalg.norm(outward, axis=1, keepdims=True)
    base = frame.centre + _FRUIT_LIFT * frame.half_length * frame.axis + _SUNK * frame.radius * outward
    steps = direction(azimuth[:, None], peduncle_slopes(inclination, end_inclination))
    axis = direction(hang_azimuth, hang_inclination)
    end = base + one.peduncle_length * steps.mean(axis=1)
    return end + (_CALYX_HEIGHT * one.diameter + 0.5 * one.length) * axis, axis
