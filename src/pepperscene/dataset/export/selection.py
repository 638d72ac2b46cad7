"""The organs of a data set that an export describes as objects, and their categories."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Final

from pepperscene.classes import OrganClass
from pepperscene.errors import ArgumentError

ORGANS: Final = tuple(organ for organ in OrganClass if organ != OrganClass.BACKGROUND)

UNRIPE_CATEGORY: Final = len(OrganClass)
"""Id of unripe fruit where ripe and unripe fruit are two categories; ripe fruit has that of the class."""


@dataclass(frozen=True)
class Category:
    """A category of objects.

    Attributes:
        id: in COCO files; the class id, except for unripe fruit.
        name: in lower case.
        organ_class: of its organs.
    """

    id: int
    name: str
    organ_class: OrganClass


@dataclass(frozen=True)
class Selection:
    """The objects of an export.

    Attributes:
        classes: of the organs that are objects, in the order of their categories.
        smallest_px: visible pixels below which an organ is not a separate object.
        least_visible: visible fraction below which a fruit in the harvest truth is not a separate object.
        ripe_from: least ripeness of ripe fruit; None if ripe and unripe fruit are one category.
    """

    classes: tuple[OrganClass, ...] = ORGANS
    smallest_px: int = 1
    least_visible: float = 0.0
    ripe_from: float | None = None

    @property
    def needs_harvest(self) -> bool:
        """Whether objects depend on the harvest truth."""
        return self.least_visible > 0 or self.ripe_from is not None

    @cached_property
    def categories(self) -> tuple[Category, ...]:
        """All categories, in the order of the classes; ripe fruit before unripe fruit."""
        return tuple(category for organ in self.classes for category in self.of_class(organ))

    def of_class(self, organ_class: OrganClass) -> tuple[Category, ...]:
        """The categories of a class; none if it is not selected."""
        if organ_class not in self.classes:
            return ()
        name = organ_class.name.lower()
        if organ_class != OrganClass.PEPPER or self.ripe_from is None:
            return (Category(int(organ_class), name, organ_class),)
        ripe = Category(int(organ_class), f"ripe {name}", organ_class)
        return ripe, Category(UNRIPE_CATEGORY, f"unripe {name}", organ_class)

    def category(self, organ_class: OrganClass, fruit: Mapping[str, Any] | None) -> Category | None:
        """The category of an organ; None if its class is not selected, or its ripeness is unknown.

        Args:
            organ_class: of the organ.
            fruit: its entry in the harvest truth, if it has one.
        """
        categories = self.of_class(organ_class)
        if len(categories) < 2:
            return categories[0] if categories else None
        ripeness = (fruit or {}).get("ripeness")
        if ripeness is None or self.ripe_from is None:
            return None
        return categories[0 if ripeness >= self.ripe_from else 1]

    def is_object(self, entry: Mapping[str, Any], fruit: Mapping[str, Any] | None) -> bool:
        """Whether an organ of a selected class is a separate object.

        Args:
            entry: of its instance in the frame's JSON.
            fruit: its entry in the harvest truth, if it has one.
        """
        is_large = entry["plant"] >= 0 and entry["pixels"] >= self.smallest_px
        is_visible = fruit is None or fruit["visible_fraction"] >= self.least_visible
        return is_large and is_visible and self.category(OrganClass(entry["class"]), fruit) is not None


def parse_classes(text: str | None) -> tuple[OrganClass, ...]:
    """Parse "pepper,leaf"; all organ classes for None.

    Raises:
        ArgumentError: a name is unknown or repeated.
    """
    if text is None:
        return ORGANS
    known = {organ.name.lower(): organ for organ in ORGANS}
    names = [name.strip() for name in text.split(",")]
    for name in names:
        if name not in known:
            raise ArgumentError("classes", f"{name!r} is not an organ class; allowed are {', '.join(known)}")
    if len(set(names)) < len(names):
        raise ArgumentError("classes", f"{text!r} must name each class once")
    return tuple(known[name] for name in names)
