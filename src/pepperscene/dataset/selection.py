"""The organs of a data set that an export describes as objects, and their categories."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Final

from pepperscene.classes import CLASS_COLOURS, RIPE_FROM, OrganClass, parse_class_mapping
from pepperscene.errors import ArgumentError

Parts = frozenset[int]
"""What a category consists of: class ids, `_RIPE` for ripe and `_UNRIPE` for unripe fruit."""

_RIPE: Final = int(OrganClass.PEPPER)
_UNRIPE: Final = len(OrganClass)
FRUIT: Final[Parts] = frozenset({_RIPE, _UNRIPE})

_DIVIDED: Final[Mapping[str, Parts]] = {
    "pepper.ripe": frozenset({_RIPE}),
    "pepper.unripe": frozenset({_UNRIPE}),
}
_PARTS: Final[Mapping[str, Parts]] = {
    **{organ.name.lower(): frozenset({int(organ)}) for organ in OrganClass},
    "pepper": FRUIT,
    **_DIVIDED,
}
_ORGANS: Final = ",".join(organ.name.lower() for organ in OrganClass if organ != OrganClass.BACKGROUND)


@dataclass(frozen=True)
class Category:
    """A category of objects.

    Attributes:
        name: in lower case.
        parts: the organs that it consists of.
    """

    name: str
    parts: Parts

    @property
    def id(self) -> int:
        """Id in COCO files: its lowest class id; that of a category of unripe fruit is 8."""
        return min(self.parts)

    @property
    def organ_class(self) -> OrganClass:
        """Its organ class of the lowest id; fruit for a category of unripe fruit."""
        return OrganClass.PEPPER if self.id == _UNRIPE else OrganClass(self.id)

    @property
    def members(self) -> list[str]:
        """The names of its parts, as in a mapping of classes."""
        hidden = _DIVIDED if self.parts >= FRUIT else ("pepper",)
        return [name for name, parts in _PARTS.items() if parts <= self.parts and name not in hidden]

    @property
    def colour(self) -> list[int]:
        """The class colour; half of it for unripe fruit, so that no two categories have the same colour."""
        colour = CLASS_COLOURS[self.organ_class]
        return [value // 2 for value in colour] if self.is_unripe else list(colour)

    @property
    def is_unripe(self) -> bool:
        """Whether it consists of unripe fruit only."""
        return self.id == _UNRIPE

    @property
    def has_fruit(self) -> bool:
        """Whether fruit belongs to it."""
        return bool(self.parts & FRUIT)


def parse_categories(
    text: str | None, ripe_from: float | None = None, fruit_name: str = "pepper", background: bool = False
) -> tuple[Category, ...]:
    """Parse "ripe=pepper.ripe,green=pepper.unripe,stalk=peduncle+stem,leaf"; all organ classes for None.

    Args:
        text: as `parse_class_mapping` reads it. Its members are the organ classes, or `pepper.ripe` and
            `pepper.unripe` instead of `pepper`.
        ripe_from: if it is given, a category of all fruit and nothing else becomes two, "ripe NAME" and
            "unripe NAME".
        fruit_name: of fruit to which the text gives no name.
        background: whether the background can be a member.

    Raises:
        ArgumentError: the text is not valid, or `ripe_from` is given and no category is divided by it.
    """
    members = [name for name in _PARTS if background or name != "background"]
    names = {
        "pepper": fruit_name,
        "pepper.ripe": f"ripe {fruit_name}",
        "pepper.unripe": f"unripe {fruit_name}",
    }
    mapping = parse_class_mapping(_ORGANS if text is None else text, members)
    used = [member for _, own in mapping for member in own]
    if "pepper" in used and any(member in used for member in _DIVIDED):
        raise ArgumentError("classes", "pepper is named twice, as a whole and divided by ripeness")
    categories: list[Category] = []
    for name, own in mapping:
        label = name or names.get(own[0], own[0])
        parts = frozenset[int]().union(*(_PARTS[member] for member in own))
        if parts == FRUIT and ripe_from is not None and own == ("pepper",):
            categories += [Category(f"ripe {label}", frozenset({_RIPE}))]
            categories += [Category(f"unripe {label}", frozenset({_UNRIPE}))]
        else:
            categories.append(Category(label, parts))
    _check_names(categories)
    if ripe_from is not None and not _is_divided(categories):
        allowed = "needs pepper as a class of its own, or pepper.ripe and pepper.unripe, in --classes"
        raise ArgumentError("ripe_from", allowed)
    return tuple(categories)


def _check_names(categories: Sequence[Category]) -> None:
    """Raise `ArgumentError` for a name that occurs twice or is that of what is in no category."""
    names = [category.name for category in categories]
    for category in categories:
        if names.count(category.name) > 1:
            raise ArgumentError("classes", f"the class {category.name} is named twice")
        if category.name == "background" and int(OrganClass.BACKGROUND) not in category.parts:
            raise ArgumentError(
                "classes", "background is the name of all that is in no class; choose another"
            )


def _is_divided(categories: Sequence[Category]) -> bool:
    """Whether a category has only ripe or only unripe fruit."""
    return any(len(category.parts & FRUIT) == 1 for category in categories)


_ALL: Final = parse_categories(None)


@dataclass(frozen=True)
class Selection:
    """The objects of an export.

    Attributes:
        categories: of the objects, in their order.
        smallest_px: visible pixels below which an organ is not a separate object.
        least_visible: visible fraction below which a fruit in the harvest truth is not a separate object.
        ripe_from: least ripeness of ripe fruit, where categories are divided by it.
        keep_truncated: whether organs that the image border may cut are separate objects.
    """

    categories: tuple[Category, ...] = _ALL
    smallest_px: int = 1
    least_visible: float = 0.0
    ripe_from: float = RIPE_FROM
    keep_truncated: bool = True

    @cached_property
    def is_divided(self) -> bool:
        """Whether categories depend on the ripeness of fruit."""
        return _is_divided(self.categories)

    @property
    def needs_harvest(self) -> bool:
        """Whether objects depend on the harvest truth."""
        return self.least_visible > 0 or self.is_divided

    @property
    def needs_organs(self) -> bool:
        """Whether the category of a pixel depends on its organ, and not only on its class."""
        return self.needs_harvest or self.smallest_px > 1 or not self.keep_truncated

    def _parts(self, organ_class: OrganClass, fruit: Mapping[str, Any] | None) -> Parts:
        """What an organ may be: of fruit of unknown ripeness, ripe or unripe fruit."""
        if organ_class != OrganClass.PEPPER:
            return frozenset({int(organ_class)})
        ripeness = (fruit or {}).get("ripeness")
        if ripeness is None or not self.is_divided:
            return FRUIT
        return frozenset({_RIPE if ripeness >= self.ripe_from else _UNRIPE})

    def possible(
        self, organ_class: OrganClass, fruit: Mapping[str, Any] | None = None
    ) -> tuple[Category, ...]:
        """The categories that an organ may belong to; none if it is not selected.

        `fruit` is its entry in the harvest truth, if it has one.
        """
        parts = self._parts(organ_class, fruit)
        return tuple(category for category in self.categories if category.parts & parts)

    def category(self, organ_class: OrganClass, fruit: Mapping[str, Any] | None = None) -> Category | None:
        """The category of an organ; None if it is not selected, or its ripeness is unknown.

        The arguments are those of `possible`.
        """
        parts = self._parts(organ_class, fruit)
        return next((category for category in self.categories if parts <= category.parts), None)

    @cached_property
    def rest_class(self) -> Mapping[int, OrganClass]:
        """By class id, the first class with the same possible categories; their rests are one segment."""
        possible = {organ: self.possible(organ) for organ in OrganClass}
        return {
            organ: next(first for first in OrganClass if possible[first] == categories)
            for organ, categories in possible.items()
        }

    def is_object(self, entry: Mapping[str, Any], fruit: Mapping[str, Any] | None, at_border: bool) -> bool:
        """Whether an organ of a selected class is a separate object.

        Args:
            entry: of its instance in the frame's JSON.
            fruit: its entry in the harvest truth, if it has one.
            at_border: whether it reaches the image border, by its visible pixels, or by all of it if its
                hidden parts are known. For fruit in the harvest truth, that truth counts.
        """
        is_truncated = at_border if fruit is None else fruit["truncated"]
        return (
            entry["plant"] >= 0
            and entry["pixels"] >= self.smallest_px
            and (fruit is None or fruit["visible_fraction"] >= self.least_visible)
            and (self.keep_truncated or not is_truncated)
            and self.category(OrganClass(entry["class"]), fruit) is not None
        )
