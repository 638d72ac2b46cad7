"""The classes that a network separates: those of `OrganClass`, or mergers of them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Self

import numpy as np
from numpy.typing import NDArray

from pepperscene.classes import CLASS_COLOURS, IGNORE_CLASS, OrganClass, parse_class_mapping
from pepperscene.errors import ArgumentError, InputError

FRUIT_CLASSES: Final = "other=background+leaf+stem+shoot+wire+cut,fruit=pepper,peduncle"
"""Classes of photographs whose masks know fruit and peduncles only."""

_IDS: Final = {organ.name.lower(): int(organ) for organ in OrganClass}


@dataclass(frozen=True)
class ClassTable:
    """Classes in the order of a network's outputs.

    Attributes:
        names: of the classes, lower case.
        members: ids of `OrganClass` that each class consists of. An id in no class is dropped: its pixels are
            ignored as void ones are.
    """

    names: tuple[str, ...]
    members: tuple[frozenset[int], ...]

    @classmethod
    def organs(cls) -> Self:
        """The eight classes of the published data set."""
        return cls(tuple(_IDS), tuple(frozenset({class_id}) for class_id in _IDS.values()))

    @classmethod
    def parse(cls, text: str | None, where: str = "classes", *, least: int = 2) -> Self:
        """Read a table from text.

        Args:
            text: as `parse_class_mapping` reads it, of organ classes; those that do not occur are dropped.
                None for all eight.
            where: name of the argument, for messages.
            least: least number of classes.

        Raises:
            ArgumentError: a name is unknown or occurs twice, or there are fewer classes than `least`.
        """
        if text is None:
            return cls.organs()
        classes = parse_class_mapping(text, tuple(_IDS), where)
        names = tuple(name or organs[0] for name, organs in classes)
        if len(names) < least:
            raise ArgumentError(where, f"there must be two classes or more, not {len(names)}")
        return cls(names, tuple(frozenset(_IDS[organ] for organ in organs) for _, organs in classes))

    def __len__(self) -> int:
        return len(self.names)

    def __str__(self) -> str:
        """The text that `parse` reads."""
        organs = [name.lower() for name in OrganClass.__members__]
        parts = []
        for name, ids in zip(self.names, self.members, strict=True):
            joined = "+".join(organs[class_id] for class_id in sorted(ids))
            parts.append(name if joined == name else f"{name}={joined}")
        return ",".join(parts)

    @property
    def colours(self) -> NDArray[np.uint8]:
        """8-bit RGB of each class `(k, 3)`: the published colour of its first organ class."""
        return np.array([CLASS_COLOURS[min(ids)] for ids in self.members], np.uint8)

    def indices(self, class_ids: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Index of the class of each pixel, from ids of `OrganClass`; `IGNORE_CLASS` if dropped or void."""
        lookup = np.full(256, IGNORE_CLASS, np.uint8)
        for index, ids in enumerate(self.members):
            lookup[list(ids)] = index
        return lookup[class_ids]

    def merging(self, finer: ClassTable, where: str = "classes") -> NDArray[np.float32]:
        """Matrix `(len(self), len(finer))` of 0 and 1 that adds probabilities of a finer table's classes.

        A class of the finer table whose organ classes are all dropped here has a column of zeros.

        Raises:
            InputError: a class of the finer table belongs to two classes of this one or only partly to one,
                or a class of this one holds no class of the finer table.
        """
        matrix = np.zeros((len(self), len(finer)), np.float32)
        for column, (name, ids) in enumerate(zip(finer.names, finer.members, strict=True)):
            for line, own in enumerate(self.members):
                if ids <= own:
                    matrix[line, column] = 1
                elif ids & own:
                    problem = f"the model's class {name} is only partly in {self.names[line]}"
                    raise InputError(where, f"{problem}: its classes are {finer}")
        for line, name in enumerate(self.names):
            if not matrix[line].any():
                raise InputError(where, f"the model knows nothing of {name}: its classes are {finer}")
        return matrix


def parse_shares(text: str, where: str = "prior") -> dict[str, float]:
    """Shares by class of a text such as `fruit=0.04,peduncle=0.003`; raises `ArgumentError`."""
    shares = {}
    for part in text.split(","):
        name, equals, number = (item.strip() for item in part.partition("="))
        try:
            value = float(number)
        except ValueError:
            value = -1.0
        if not (name and equals) or not 0.0 < value < 1.0 or name in shares:
            problem = (
                f"must be classes with shares above 0 and below 1, as fruit=0.04,peduncle=0.003, not {text!r}"
            )
            raise ArgumentError(where, problem)
        shares[name] = value
    return shares
