"""The eight classes of the published data set: ids, names, colours, and the notation that merges them.

Source: layout of doi 10.4121/uuid:884958f5-b868-46e1-b3d8-a0b5d91b02c0; the colours are those of a public
reader of that data set.
"""

from __future__ import annotations

import re
from collections.abc import Collection
from dataclasses import dataclass
from enum import IntEnum
from typing import Final

from pepperscene.errors import ArgumentError


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


RIPE_FROM: Final = 0.5
"""Mean ripeness from which a fruit counts as ripe, chosen: half of its colour has changed."""

PLANT_CLASSES: Final = frozenset(OrganClass) - {OrganClass.BACKGROUND, OrganClass.WIRE}
"""Classes of organs, without the twine that holds them."""

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

IGNORE_CLASS: Final = 255
"""Class id of pixels that are neither an organ nor background: training and evaluation leave them out
(`ignore_index=255`, as in Cityscapes and PASCAL VOC)."""

IGNORE_COLOUR: Final[tuple[int, int, int]] = (128, 128, 128)
"""8-bit RGB of `IGNORE_CLASS`. Chosen: a grey, far from the colours of all classes."""


_CLASS_NAME: Final = re.compile(r"[a-z][a-z0-9_]*", re.ASCII)


def parse_class_mapping(
    text: str, members: Collection[str], where: str = "classes"
) -> tuple[tuple[str, tuple[str, ...]], ...]:
    """Parse the notation that chooses, merges and renames classes: "fruit=pepper,stalk=peduncle+stem,leaf".

    Args:
        text: comma-separated classes, each a member or `name=member+member`.
        members: what a class can consist of, such as the names of organ classes.
        where: name of the argument, for messages.

    Returns:
        The name of each class, or "" if none is given, and its members.

    Raises:
        ArgumentError: a name is not valid, a member is unknown, or either occurs twice.
    """
    classes: list[tuple[str, tuple[str, ...]]] = []
    found: set[str] = set()
    for part in (part.strip() for part in text.split(",")):
        name, _, joined = (piece.strip() for piece in part.partition("="))
        if not _CLASS_NAME.fullmatch(name) and (joined or name not in members):
            raise ArgumentError(where, f"a class is named in lower-case letters, digits and _, not {name!r}")
        parts = tuple(member.strip() for member in (joined or name).split("+"))
        for member in parts:
            if member not in members:
                raise ArgumentError(where, f"{member!r} is none of {', '.join(members)}")
            if member in found:
                raise ArgumentError(where, f"{member} is named twice")
            found.add(member)
        if name in (other or own[0] for other, own in classes):
            raise ArgumentError(where, f"the class {name} is named twice")
        classes.append((name if joined else "", parts))
    return tuple(classes)


@dataclass(frozen=True)
class Appearance:
    """How one organ looks different from others with the same surface, whatever their labels are.

    Attributes:
        residue: mean fraction of its upper side that dust or spray residue covers, in [0, 1].
        ageing: 0 for healthy tissue, 1 for an organ that has dried completely.
        variant: number from 0 to 65535 that chooses among the textures of its surface.
    """

    residue: float = 0.0
    ageing: float = 0.0
    variant: int = 0


FAR_ROW: Final = "far_row"
"""Kind of an instance that is all plants of a far row."""


@dataclass(frozen=True)
class Instance:
    """One organ or object with its own value in the instance image.

    Attributes:
        organ_class: the class of all its pixels, unless they are ignored.
        kind: the organ kind ("lamina", "fruit") or the kind of object ("twine").
        plant: number of the plant that it belongs to, 0-based; -1 for none.
        phytomer: position along the main stem, 0-based from the ground; -1 for none.
        parent: index of the instance that it grows on, in the same list; -1 for none.
        far_row: number of the row that it belongs to, beyond the recipe's own plants; -1 for none.
        ignored: whether its pixels have `IGNORE_CLASS` instead of its class.
        full: whether its plant is grown in full although it is in a far row, whose other plants are coarse.
    """

    organ_class: OrganClass
    kind: str
    plant: int = -1
    phytomer: int = -1
    parent: int = -1
    far_row: int = -1
    ignored: bool = False
    full: bool = False

    def numbered(self, plant: int, parent: int, far_row: int) -> Instance:
        """The instance with another plant, parent and far row.

        A scene can have 50,000 of them, and `dataclasses.replace` takes five times as long.
        """
        instance = object.__new__(Instance)
        instance.__dict__.update(self.__dict__, plant=plant, parent=parent, far_row=far_row)
        return instance

    @property
    def class_id(self) -> int:
        """The id of its pixels in label images."""
        return IGNORE_CLASS if self.ignored else int(self.organ_class)
