"""The eight classes of the published data set: ids, names and colours.

Source: layout of doi 10.4121/uuid:884958f5-b868-46e1-b3d8-a0b5d91b02c0; the colours are those of a public
reader of that data set.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import Final


class OrganClass(IntEnum):
    """Class id of a pixel or a face, as in the published label images."""

    BACKGROUND = 0
    LEAF = 1
    PEPPER = 2
    PEDUNCLE = 3
    STEM = 4
    SHOOT = 5  # side shoots and leaf stems (petioles)
    WIRE = 6
    CUT = 7


CLASS_COLOURS: Final[tuple[tuple[int, int, int], ...]] = (
    (0, 0, 0),
    (0, 49, 245),
    (255, 252, 82),
    (255, 0, 30),
    (255, 22, 243),
    (0, 254, 76),
    (254, 254, 254),
    (0, 255, 255),
)
"""8-bit RGB of each class id in the colour copies of the label images."""


@dataclass(frozen=True)
class Instance:
    """One organ or object with its own value in the instance image.

    Attributes:
        organ_class: the class of all its pixels.
        kind: the organ kind ("lamina", "fruit") or the kind of object ("twine").
        plant: number of the plant that it belongs to, 0-based; -1 for none.
        phytomer: position along the main stem, 0-based from the ground; -1 for none.
        parent: index of the instance that it grows on, in the same list; -1 for none.
    """

    organ_class: OrganClass
    kind: str
    plant: int = -1
    phytomer: int = -1
    parent: int = -1
