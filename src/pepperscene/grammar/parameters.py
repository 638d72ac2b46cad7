"""All numbers that make one plant, drawn or given: from them alone it can be built again."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field


@dataclass(frozen=True)
class LeafParameters:
    """A petiole and its lamina; metres and radians.

    Attributes:
        azimuth: around the vertical, counter-clockwise seen from above, 0 towards the aisle.
        petiole_length: along the petiole.
        petiole_radius: at its base.
        petiole_radius_tip: at the blade.
        petiole_inclination: above the horizontal, at its base.
        length: of the midrib.
        width: of the blade, flat.
        inclination: of the midrib above the horizontal, half-way along; -pi / 2 hangs straight down.
        droop: downward bend of the midrib from base to tip, without that of the joint with the petiole.
        sway: sideways bend of petiole and midrib together, counter-clockwise.
        roll: of the blade about its midrib, at the base.
        shape: measures of the blade that only its mesh maker reads.
    """

    azimuth: float
    petiole_length: float
    petiole_radius: float
    petiole_radius_tip: float
    petiole_inclination: float
    length: float
    width: float
    inclination: float
    droop: float = 0.0
    sway: float = 0.0
    roll: float = 0.0
    shape: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class ShootParameters:
    """A side shoot and what stands at its end; metres and radians.

    Attributes:
        azimuth: as of a leaf.
        length: along the shoot.
        radius: at its base.
        radius_tip: at its end.
        inclination: above the horizontal, at its base.
        bend: of its inclination, from base to end; negative is downwards.
        ends: leaves and further shoots.
    """

    azimuth: float
    length: float
    radius: float
    radius_tip: float
    inclination: float
    bend: float
    ends: tuple[LeafParameters | ShootParameters, ...]


@dataclass(frozen=True)
class FruitParameters:
    """A peduncle, its calyx and its fruit; metres and radians.

    Attributes:
        azimuth: as of a leaf.
        peduncle_length: along the peduncle.
        peduncle_radius: at the node.
        peduncle_radius_tip: at the calyx.
        inclination: of the peduncle above the horizontal, at the node.
        end_inclination: of the peduncle at the calyx.
        hang_azimuth: of the fruit's axis.
        hang_inclination: of the fruit's axis from stalk end to blossom end.
        calyx_radius: of the calyx' disc.
        calyx_seed: of its own noise, in [0, 1).
        length: of the fruit along its axis.
        diameter: of the fruit at its widest.
        shape: measures of the fruit that only its mesh maker reads.
    """

    azimuth: float
    peduncle_length: float
    peduncle_radius: float
    peduncle_radius_tip: float
    inclination: float
    end_inclination: float
    hang_azimuth: float
    hang_inclination: float
    calyx_radius: float
    calyx_seed: float
    length: float
    diameter: float
    shape: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class CutParameters:
    """The stump of a peduncle whose fruit was harvested; metres and radians."""

    azimuth: float
    inclination: float
    length: float
    radius: float


@dataclass(frozen=True)
class PhytomerParameters:
    """One section of the main stem, and all that grows from the node at its top; metres and radians.

    Attributes:
        length: from the centre of the node below (or the ground) to the centre of this one.
        azimuth: of the section's direction.
        inclination: of the section's direction above the horizontal, about pi / 2.
        radius: of the stem at the node below.
        radius_tip: of the stem at this node.
        groove: depth of the stem's grooves.
        seed: of the section's own noise, in [0, 1).
        node_length: of the swelling.
        node_radius: of the swelling at its widest.
        leaf: if the node carries one.
        shoot: if the node carries one.
        fruit: or the cut that one left, if the node carries one.
    """

    length: float
    azimuth: float
    inclination: float
    radius: float
    radius_tip: float
    groove: float
    seed: float
    node_length: float
    node_radius: float
    leaf: LeafParameters | None = None
    shoot: ShootParameters | None = None
    fruit: FruitParameters | CutParameters | None = None


@dataclass(frozen=True)
class PlantParameters:
    """A plant from the ground up."""

    cultivar: str
    phytomers: tuple[PhytomerParameters, ...]
