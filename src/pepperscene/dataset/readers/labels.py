"""What the values or colours of a foreign mask mean, as classes of this package."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.classes import CLASS_COLOURS, OrganClass
from pepperscene.dataset.readers.image_set import VOID
from pepperscene.document import read_toml
from pepperscene.errors import InputError

Colour = tuple[int, int, int]

OTHERWISE: Final = "otherwise"
"""The key that stands for all values that no other key names."""

LABEL_FILE: Final = "classes.toml"

_NEAR: Final = 32.0
"""Distance in 8-bit RGB within which a colour counts as one of the told ones. Chosen: above the few grey
values by which readers of the published set differ, below half the least distance between its colours."""

_COLOUR: Final = re.compile(r"#([0-9a-fA-F]{2})([0-9a-fA-F]{2})([0-9a-fA-F]{2})")
_NAMES: Final = {**{organ.name.lower(): int(organ) for organ in OrganClass}, "void": VOID}


@dataclass(frozen=True)
class LabelMap:
    """A table from mask values, or mask colours, to class ids.

    Attributes:
        where: what says so, for messages.
        values: class id by mask value.
        colours: class id by 8-bit RGB; the nearest colour counts.
        otherwise: class id of all else; None when all else is a fault.
    """

    where: str
    values: Mapping[int, int] = field(default_factory=dict)
    colours: Mapping[Colour, int] = field(default_factory=dict)
    otherwise: int | None = None

    def of_values(self, values: NDArray[np.integer[Any]], where: Path) -> NDArray[np.uint8]:
        """Class ids of mask values, of any shape.

        Raises:
            InputError: a value has no meaning.
        """
        found, place = np.unique(values, return_inverse=True)
        ids = [self.values.get(int(value), self.otherwise) for value in found]
        missing = [str(value) for value, known in zip(found, ids, strict=True) if known is None]
        if missing:
            raise self._without_meaning(where, "value", missing)
        return np.array(ids, np.uint8)[place].reshape(values.shape)

    def of_colours(self, rgb: NDArray[np.uint8], where: Path) -> NDArray[np.uint8]:
        """Class ids `(...)` of mask colours `(..., 3)`, by the nearest colour that is near enough.

        Raises:
            InputError: a colour is near to none.
        """
        packed = rgb.astype(np.uint32) @ np.array([65536, 256, 1], np.uint32)
        codes, place = np.unique(packed, return_inverse=True)
        found = np.stack([codes >> 16, codes >> 8 & 255, codes & 255], axis=-1).astype(float)
        known = np.array(list(self.colours), float).reshape(-1, 3)
        far = np.linalg.norm(found[:, None] - known, axis=-1)
        near = far.min(axis=1, initial=np.inf) <= _NEAR
        if self.otherwise is None and not near.all():
            raise self._without_meaning(where, "colour", [f"#{code:06x}" for code in codes[~near]])
        ids = np.full(len(codes), VOID if self.otherwise is None else self.otherwise, np.uint8)
        ids[near] = np.array(list(self.colours.values()), np.uint8)[far[near].argmin(axis=1)]
        return ids[place].reshape(packed.shape)

    def knows(self, values: NDArray[np.integer[Any]]) -> bool:
        """Whether every one of these mask values has a meaning."""
        if self.otherwise is not None and self.values:
            return True
        return set(np.unique(values).tolist()) <= set(self.values)

    def _without_meaning(self, where: Path, kind: str, found: list[str]) -> InputError:
        shown = ", ".join(found[:8]) + (", …" if len(found) > 8 else "")
        plural = "s" if len(found) > 1 else ""
        return InputError(
            where, f'has the {kind}{plural} {shown}, of which {self.where} says nothing ("void" leaves out)'
        )


def labels_of(told: Mapping[Any, Any], where: str | Path) -> LabelMap:
    """A table as a user writes it.

    Args:
        told: keys are mask values (5 or "5"), mask colours ((255, 0, 0) or "#ff0000") or "otherwise"; values
            are classes: an `OrganClass`, its name in lower case, or "void" (or None) for pixels of which
            nobody says anything.
        where: the file or argument that says so.

    Raises:
        InputError: a key or a value is something else, or there are none.
    """
    values: dict[int, int] = {}
    colours: dict[Colour, int] = {}
    otherwise: int | None = None
    for key, meant in told.items():
        organ = _class_id(meant, str(key), where)
        if key == OTHERWISE:
            otherwise = organ
        elif (colour := _colour(key)) is not None:
            colours[colour] = organ
        elif (value := _value(key)) is not None:
            values[value] = organ
        else:
            raise InputError(
                where, 'must be a mask value, a colour as "#ff0000", or "otherwise"', key=str(key)
            )
    if not values and not colours:
        raise InputError(where, "must give a class to at least one mask value or colour")
    return LabelMap(str(where), values, colours, otherwise)


def labels_in(folder: Path) -> LabelMap | None:
    """What the `classes.toml` of a folder says; None when there is none.

    Raises:
        InputError: the file is damaged.
    """
    path = folder / LABEL_FILE
    return labels_of(read_toml(path), path) if path.exists() else None


def _class_id(meant: Any, key: str, where: str | Path) -> int:
    if meant is None:
        return VOID
    if isinstance(meant, str) and meant in _NAMES:
        return _NAMES[meant]
    if isinstance(meant, int) and not isinstance(meant, bool) and meant in _NAMES.values():
        return int(meant)
    raise InputError(where, f"must be one of {', '.join(_NAMES)}", key=key, value=meant)


def _colour(key: Any) -> Colour | None:
    """A colour told as three numbers or as #rrggbb."""
    if isinstance(key, str):
        match = _COLOUR.fullmatch(key)
        return None if match is None else (int(match[1], 16), int(match[2], 16), int(match[3], 16))
    if isinstance(key, tuple) and len(key) == 3 and all(isinstance(k, int) and 0 <= k <= 255 for k in key):
        return key
    return None


def _value(key: Any) -> int | None:
    if isinstance(key, str) and key.isascii() and key.isdecimal():
        return int(key)
    return int(key) if isinstance(key, int) and not isinstance(key, bool) and key >= 0 else None


PALETTE: Final = LabelMap(
    "the published colour scale", colours={colour: organ for organ, colour in enumerate(CLASS_COLOURS)}
)
"""The published colours; what a mask in colours means when nobody says otherwise."""

KNOWN_LABELS: Final[Mapping[str, LabelMap]] = MappingProxyType(
    {
        # The ids of the published set, and of this package's class images.
        "published": LabelMap(
            "'published'", {**{int(organ): int(organ) for organ in OrganClass}, VOID: VOID}, PALETTE.colours
        ),
        # Montoya Cavero and Escobedo 2021, "Sweet Pepper and Peduncle Segmentation": green fruit, red fruit,
        # green peduncle, yellow fruit, red peduncle; all else is one background, leaves and stems as well, so
        # that nothing is known of it.
        "montoya2021": labels_of(
            {0: "void", 1: "pepper", 2: "pepper", 3: "peduncle", 4: "pepper", 5: "peduncle", 255: "void"},
            "'montoya2021'",
        ),
    }
)
"""Meanings of masks that are known by name."""
