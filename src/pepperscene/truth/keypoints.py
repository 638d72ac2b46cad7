"""Keypoints of fruit: the points that a robot needs, in the order of all formats."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

KEYPOINTS: Final = ("cut", "stalk", "blossom_end")
"""The cut point of the stalk, where the stalk joins the fruit, and the end opposite the stalk."""

SKELETON: Final = ((1, 2), (2, 3))
"""Pairs of keypoints that a line joins, counted from 1: along the stalk, and along the fruit."""

FLIP_INDICES: Final = (0, 1, 2)
"""The keypoint that each becomes in a mirrored image: itself, as none is of one side."""

Keypoint = tuple[float, float, int]
"""Column and row in continuous pixel coordinates, and COCO's visibility: 2 if visible, 1 if hidden, 0 with
coordinates of 0 if it is outside the image or unknown."""


def fruit_keypoints(fruit: Mapping[str, Any]) -> tuple[Keypoint, ...]:
    """The `KEYPOINTS` of a fruit from its entry in the harvest truth, which may be empty.

    A fruit without a stalk has no cut point. Data sets built before the ends of fruit were recorded have the
    cut point only.
    """
    points = ((fruit.get("peduncle") or {}).get("cut"), fruit.get("stalk_end"), fruit.get("blossom_end"))
    return tuple(_keypoint(point) for point in points)


def _keypoint(point: Mapping[str, Any] | None) -> Keypoint:
    if point is None or point["px"] is None:
        return 0.0, 0.0, 0
    x, y = point["px"]
    return x, y, 2 if point["visible"] else 1
