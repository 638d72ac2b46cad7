"""COCO's JSON files, written record by record: the annotations of 10,000 frames are never held at once."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any

from pepperscene.classes import CLASS_COLOURS, OrganClass


class Records:
    """One JSON file with a record a line: `info`, `licenses`, `categories`, `annotations`, `images`.

    Args:
        path: of the file.
        about: of the data set.
        categories: what annotations refer to.
    """

    def __init__(self, path: Path, about: Mapping[str, Any], categories: Sequence[Mapping[str, Any]]) -> None:
        self._images: list[str] = []
        self._between = "\n"
        self._file = path.open("w", encoding="utf-8")
        head = {"info": _info(about), "licenses": [], "categories": categories}
        self._file.write(f'{_line(head)[:-1]},"annotations":[')

    def __enter__(self) -> Records:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, fault: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Finish the file; a broken export's is left as it is, to be removed."""
        if kind is None:
            self._file.write('\n],"images":[\n' + ",\n".join(self._images) + "\n]}\n")
        self._file.close()

    def image(self, record: Mapping[str, Any]) -> None:
        """Add a picture; the few bytes are kept until the end."""
        self._images.append(_line(record))

    def annotation(self, record: Mapping[str, Any]) -> None:
        """Add an annotation."""
        self._file.write(self._between + _line(record))
        self._between = ",\n"


def category(organ_class: OrganClass) -> dict[str, Any]:
    """A class as COCO's files tell it."""
    return {"id": int(organ_class), "name": organ_class.name.lower(), "supercategory": "sweet pepper"}


def panoptic_category(organ_class: OrganClass) -> dict[str, Any]:
    """A class as COCO's panoptic files tell it; the background is no thing that could be counted."""
    is_thing = int(organ_class != OrganClass.BACKGROUND)
    return {**category(organ_class), "isthing": is_thing, "color": list(CLASS_COLOURS[organ_class])}


def _info(about: Mapping[str, Any]) -> dict[str, Any]:
    """Whence the data set comes; no date, so that the same frames make the same bytes."""
    name = about["recipe"].get("name", "")
    kept = {key: about[key] for key in ("quality", "recipe_sha256", "version") if key in about}
    return {"description": f"pepperscene data set {name}".rstrip(), **kept}


def _line(record: Mapping[str, Any]) -> str:
    return json.dumps(record, separators=(",", ":"), allow_nan=False)
