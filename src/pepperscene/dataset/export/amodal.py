"""What the harvest truth adds to the fruit of a COCO file: the whole fruit's mask, and where to cut."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

from pepperscene.dataset.export.libraries import library
from pepperscene.dataset.export.segments import as_text
from pepperscene.dataset.export.source import Source

_CENTRE: Final = 0.5
"""Here the first pixel's centre is at .5, in COCO's keypoints at 0."""

_KNOWN: Final = ("ripeness", "length_m", "diameter_m", "visible_fraction", "truncated")


def fruit_of(source: Source) -> dict[int, dict[str, Any]]:
    """By instance: `attributes` of a fruit, and the harvest truth's `cut` point or None.

    The attribute `amodal` holds `segmentation`, `area` and `bbox` of all that the picture would show of the
    fruit if nothing hid it.
    """
    return {fruit["instance"]: _told(fruit) for fruit in source.image("harvest")["fruit"]}


def keypoint(cut: Mapping[str, Any] | None) -> dict[str, Any]:
    """COCO's `keypoints` of a cut: x, y, and 2 where it is seen, 1 where hidden, 0 outside the picture."""
    if cut is None or cut["px"] is None:
        return {"keypoints": [0, 0, 0], "num_keypoints": 0}
    x, y = (round(value - _CENTRE, 2) for value in cut["px"])
    return {"keypoints": [x, y, 2 if cut["visible"] else 1], "num_keypoints": 1}


def _told(fruit: Mapping[str, Any]) -> dict[str, Any]:
    coder = library("pycocotools.mask")
    size = fruit["amodal"]["size"]
    mask = coder.frPyObjects(dict(fruit["amodal"]), *size)
    amodal = {
        "segmentation": as_text(mask),
        "area": int(coder.area(mask)),
        "bbox": [int(value) for value in coder.toBbox(mask)],
    }
    known = {key: fruit[key] for key in _KNOWN if key in fruit}
    return {"attributes": {**known, "amodal": amodal}, "cut": (fruit.get("peduncle") or {}).get("cut")}
