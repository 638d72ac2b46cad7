"""Sizes and poses of the vegetative parts: stem, nodes, leaves, side shoots, and where they stand around it.

Names such as P-1 or L-4 are those of Barth et al. 2018, Table 1.
"""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from pepperscene.cultivar.notation import Angle, Length, Ratio
from pepperscene.document import Document


class PlantShape(Document):
    """The main stem: P-1 (stem diameter) and P-2 (lean across the row), and how the top is younger."""

    stem_parts: Annotated[int, Field(ge=2, le=200)]
    stem_diameter: Length
    top_diameter: Ratio
    lean: Angle
    zigzag: Angle
    groove: Length
    young_nodes: Annotated[int, Field(ge=0)]
    young_size: Annotated[float, Field(gt=0.0, le=1.0)]
    chosen: str


class NodeShape(Document):
    """I-1 and I-2."""

    internode_length: Length
    width: Length
    length: Length


class LeafShape(Document):
    """A leaf: its stem (petiole), its blade (lamina), how they are posed and how the blade is bent.

    Inclinations are above the horizontal, positive upwards, in the vertical plane that the leaf grows in.
    """

    petiole_length: Length
    length: Length
    width: Length
    petiole_inclination: Angle
    lamina_inclination: Angle
    petiole_diameter: Length
    petiole_tip: Ratio


class Blade(Document):
    """How blades bend, for leaves of the stem and of shoots alike."""

    size_correlation: Annotated[float, Field(ge=0.0, le=1.0)]
    droop: Angle
    sway: Angle
    roll: Angle
    fold: Angle
    curl: Angle
    twist: Angle
    margin_wave: Length
    margin_waves: Ratio
    blister: Length
    asymmetry: Ratio
    state_mean: Ratio
    state_spread: Ratio
    chosen: str


class Around(Document):
    """Angles around the stem, counter-clockwise seen from above, 0 towards the aisle (Fig. 3b).

    Attributes:
        leaf: L-1.
        side_shoot: S-1.
        fruit: F-1.
        leaf_step: from one leaf to the next, in turns of the cumulated L-1 distribution: leaves avoid the
            previous one and all the same follow L-1 as a whole. So for the next two:
        shoot_from_leaf: from a node's leaf to its side shoot.
        fruit_from_leaf: from a node's leaf to its fruit or cut.
    """

    leaf: Angle
    side_shoot: Angle
    fruit: Angle
    leaf_step: Ratio
    shoot_from_leaf: Ratio
    fruit_from_leaf: Ratio


class ShootShape(Document):
    """A side shoot: S-1 (length), S-3 (inclination), and how the parts at its end spread."""

    length: Length
    diameter: Length
    tip: Ratio
    inclination: Angle
    bend: Angle
    end_spread: Angle
