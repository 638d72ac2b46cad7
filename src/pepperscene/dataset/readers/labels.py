"""Tables from the values or colours of masks to the classes of this package."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.classes import CLASS_COLOURS, IGNORE_COLOUR, OrganClass
from pepperscene.dataset.readers.image_set import VOID
from pepperscene.dataset.readers.pictures import EXIF_KEY, Exif, parse_exif
from pepperscene.document import read_toml
from pepperscene.errors import InputError

Colour = tuple[int, int, int]

LABEL_FILE: Final = "classes.toml"

_MAX_DISTANCE: Final = 32.0
"""In 8-bit RGB, at which a colour still matches one of the table. Chosen: above the few grey values by which
readers of the published set differ, below half the smallest distance between its colours."""

_HEX_COLOUR: Final = re.compile(r"#([0-9a-fA-F]{2})([0-9a-fA-F]{2})([0-9a-fA-F]{2})")
_CLASS_IDS: Final = {**{organ.name.lower(): int(organ) for organ in OrganClass}, "void": VOID}


@dataclass(frozen=True)
class LabelMap:
    """A table from mask values, or mask colours, to class ids."""

    source: str  # file or argument that defines it, for messages
    values: Mapping[int, int] = field(default_factory=dict)
    colours: Mapping[Colour, int] = field(default_factory=dict)  # by 8-bit RGB; the nearest colour counts
    otherwise: int | None = None  # class id of all else; None if all else is an error
    exif: Exif | None = None  # which pixels of photographs with an EXIF orientation the masks mark

    def map_values(self, values: NDArray[np.integer[Any]], file: str | Path) -> NDArray[np.uint8]:
        """Class ids of mask values, of any shape; `file` is for messages."""
        distinct, inverse = np.unique(values, return_inverse=True)
        ids = [self.values.get(int(value), self.otherwise) for value in distinct]
        undefined = [str(value) for value, known in zip(distinct, ids, strict=True) if known is None]
        if undefined:
            raise self._undefined_error(file, "value", undefined)
        return np.array(ids, np.uint8)[inverse].reshape(values.shape)

    def map_colours(self, rgb: NDArray[np.uint8], file: str | Path) -> NDArray[np.uint8]:
        """Class ids `(...)` of mask colours `(..., 3)`, by the nearest colour; `file` is for messages."""
        packed = rgb.astype(np.uint32) @ np.array([65536, 256, 1], np.uint32)
        codes, inverse = np.unique(packed, return_inverse=True)
        distinct = np.stack([codes >> 16, codes >> 8 & 255, codes & 255], axis=-1).astype(float)
        known = np.array(list(self.colours), float).reshape(-1, 3)
        distances = np.linalg.norm(distinct[:, None] - known, axis=-1)
        near = distances.min(axis=1, initial=np.inf) <= _MAX_DISTANCE
        if self.otherwise is None and not near.all():
            raise self._undefined_error(file, "colour", [f"#{code:06x}" for code in codes[~near]])
        ids = np.full(len(codes), VOID if self.otherwise is None else self.otherwise, np.uint8)
        ids[near] = np.array(list(self.colours.values()), np.uint8)[distances[near].argmin(axis=1)]
        return ids[inverse].reshape(packed.shape)

    def covers(self, values: NDArray[np.integer[Any]]) -> bool:
        """Whether every one of these mask values has a class."""
        if self.otherwise is not None and self.values:
            return True
        return set(np.unique(values).tolist()) <= set(self.values)

    def _undefined_error(self, file: str | Path, kind: str, undefined: list[str]) -> InputError:
        examples = ", ".join(undefined[:8]) + (", …" if len(undefined) > 8 else "")
        plural = "s" if len(undefined) > 1 else ""
        problem = f"has the {kind}{plural} {examples}, for which {self.source} defines no class"
        return InputError(file, f'{problem} (use "void" to ignore pixels)')


def parse_labels(table: Mapping[Any, Any], source: str | Path) -> LabelMap:
    """Parse a table as a user writes it.

    Args:
        table: keys are mask values (5 or "5"), mask colours ((255, 0, 0) or "#ff0000") or "otherwise"; values
            are classes: an `OrganClass`, its name in lower case, or "void" (or None) for unlabelled pixels.
            The key "exif" has the value "displayed" or "stored" (see `mark_orientation`).
        source: file or argument that holds the table.

    Raises:
        InputError: a key or a value is something else, or there are none.
    """
    values: dict[int, int] = {}
    colours: dict[Colour, int] = {}
    otherwise: int | None = None
    exif = parse_exif(table[EXIF_KEY], source) if EXIF_KEY in table else None
    for key, organ_class in table.items():
        if key == EXIF_KEY:
            continue
        class_id = parse_class(organ_class, str(key), source)
        if key == "otherwise":
            otherwise = class_id
        elif (colour := _parse_colour(key)) is not None:
            colours[colour] = class_id
        elif (value := _parse_value(key)) is not None:
            values[value] = class_id
        else:
            allowed = 'must be a mask value, a colour as "#ff0000", or "otherwise"'
            raise InputError(source, allowed, key=str(key))
    if not values and not colours:
        raise InputError(source, "must give a class to at least one mask value or colour")
    return LabelMap(str(source), values, colours, otherwise, exif)


def read_labels(folder: Path) -> LabelMap | None:
    """Read the `classes.toml` of a folder; None if there is none."""
    path = folder / LABEL_FILE
    return parse_labels(read_toml(path), path) if path.exists() else None


def parse_class(organ_class: Any, key: str, source: str | Path) -> int:
    """Class id of an `OrganClass`, its name in lower case, its id, or "void" or None; else `InputError`.

    Messages name the `key` that it belongs to, and the `source`, a file or an argument.
    """
    if organ_class is None:
        return VOID
    if isinstance(organ_class, str) and organ_class in _CLASS_IDS:
        return _CLASS_IDS[organ_class]
    is_integer = isinstance(organ_class, int) and not isinstance(organ_class, bool)
    if is_integer and organ_class in _CLASS_IDS.values():
        return int(organ_class)
    raise InputError(source, f"must be one of {', '.join(_CLASS_IDS)}", key=key, value=organ_class)


def _parse_colour(key: Any) -> Colour | None:
    """A colour written as three numbers or as #rrggbb."""
    if isinstance(key, str):
        match = _HEX_COLOUR.fullmatch(key)
        return None if match is None else (int(match[1], 16), int(match[2], 16), int(match[3], 16))
    if isinstance(key, tuple) and len(key) == 3 and all(isinstance(k, int) and 0 <= k <= 255 for k in key):
        return key
    return None


def _parse_value(key: Any) -> int | None:
    if isinstance(key, str) and key.isascii() and key.isdecimal():
        return int(key)
    return int(key) if isinstance(key, int) and not isinstance(key, bool) and key >= 0 else None


PALETTE: Final = LabelMap(
    "the published colour scale",
    colours={**{colour: organ for organ, colour in enumerate(CLASS_COLOURS)}, IGNORE_COLOUR: VOID},
)
"""The published colours and that of ignored pixels, which colour masks mean unless a table says otherwise."""

_MONTOYA_2021: Final = {1: "pepper", 2: "pepper", 3: "peduncle", 4: "pepper", 5: "peduncle", 6: "peduncle"}
"""Montoya Cavero and Escobedo 2021, "Sweet Pepper and Peduncle Segmentation": green fruit, red fruit, green
peduncle, yellow fruit, red peduncle, yellow peduncle; 0 is all else, leaves and stems included."""

KNOWN_LABELS: Final[Mapping[str, LabelMap]] = MappingProxyType(
    {
        # The ids of the published set, and of this package's class images.
        "published": LabelMap(
            "'published'", {**{int(organ): int(organ) for organ in OrganClass}, VOID: VOID}, PALETTE.colours
        ),
        # Its background is of several classes, and therefore void,
        "montoya2021": parse_labels({0: "void", **_MONTOYA_2021, 255: "void"}, "'montoya2021'"),
        # or "background", for class tables that put all these classes into one.
        "montoya2021_background": parse_labels(
            {0: "background", **_MONTOYA_2021, 255: "void"}, "'montoya2021_background'"
        ),
    }
)
"""Label tables that are known by name."""
