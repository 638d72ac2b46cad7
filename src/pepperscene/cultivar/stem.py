"""The main stem: how many parts, how thick, how straight, and how its top is younger."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from pepperscene.cultivar.notation import Angle, Factor, OncePerPlant, Size
from pepperscene.document import Document


class Stem(Document):
    """P-1 (stem diameter) and P-2 (lean across the row), and the kinds that the stem is made of.

    Attributes:
        parts: internodes, each with the node above it.
        young_nodes: of them, those at the top that still grow.
        young_size: size of the topmost one, of a grown one's.
        diameter: of the stem, mean from foot to top.
        top_diameter: ratio of the diameter at the top to that at the foot.
        lean: positive towards the aisle.
        zigzag: angle of a section to the plant's own line.
        internode: the kind of its sections.
        node: the kind of its nodes.
        source: of the plain numbers.
        chosen: why the plain numbers are what they are.
    """

    parts: Annotated[int, Field(ge=1, le=200)]
    young_nodes: Annotated[int, Field(ge=0, le=200)] = 0
    young_size: Annotated[float, Field(gt=0.0, le=1.0)] = 1.0
    diameter: Annotated[Size, OncePerPlant]
    top_diameter: Annotated[Factor, OncePerPlant]
    lean: Annotated[Angle, OncePerPlant]
    zigzag: Angle
    internode: str
    node: str
    source: str = ""
    chosen: str = ""
