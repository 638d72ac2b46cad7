"""How the images of an export differ from those of the data set: cut out, or through a pinhole."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from pepperscene.classes import PLANT_CLASSES, OrganClass, parse_class_mapping
from pepperscene.errors import ArgumentError

_PARTS: Final[dict[str, frozenset[int]]] = {
    "plant": frozenset(map(int, PLANT_CLASSES)),
    "fruit": frozenset({int(OrganClass.PEPPER)}),
    **{organ.name.lower(): frozenset({int(organ)}) for organ in OrganClass if organ},
}


@dataclass(frozen=True)
class ImageOptions:
    """How images differ from those of the data set.

    Attributes:
        foreground: class ids of what masks and points have; None for all that is not ignored.
        cut_out: class ids whose share of each pixel is a fourth channel of photographs; None for no such.
        is_undistorted: whether images are those of a pinhole camera whose principal point is in the middle.
    """

    foreground: frozenset[int] | None = None
    cut_out: frozenset[int] | None = None
    is_undistorted: bool = False


def parse_foreground(text: str) -> frozenset[int]:
    """The class ids of "plant", "fruit", or classes such as "leaf+stem".

    Raises:
        ArgumentError: a name is unknown, or occurs twice.
    """
    if "=" in text:
        raise ArgumentError("mask", f"{text!r} must be classes such as leaf+stem, without a name")
    mapping = parse_class_mapping(text.replace("+", ","), _PARTS, "mask")
    return frozenset[int]().union(*(_PARTS[name] for _, own in mapping for name in own))
