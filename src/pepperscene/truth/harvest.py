"""The harvest truth of an image: a harvest robot's description of each fruit, as a JSON-ready object.

Instances are given as values of the instance image: the index of the organ plus 1. Lengths are metres, image
positions are continuous pixel coordinates; both are rounded far below what is visible.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pepperscene.camera import Camera
from pepperscene.classes import Instance
from pepperscene.truth.amodal import AmodalMask, visibility_entry
from pepperscene.truth.cut_point import Approach, FruitStalk

FORMAT: Final = "pepperscene harvest 1"

FloatArray = NDArray[np.float64]

_VISIBLE_DEPTH: Final = 3.0
"""Largest distance, in radii of the stalk, between its centreline and the surface in front of it at which a
point counts as visible. Chosen: a tube seen at 20 degrees to its axis has its surface that far in front."""
_SKIN_DEPTH: Final = 0.05
"""Largest difference, over the fruit's diameter, between the distances of a point of its skin and of the
surface at its pixel's centre. Chosen: skin seen at 10 degrees by a pixel of half a millimetre spans 3 mm."""
_CORNERS: Final = np.array([[x, y, z] for z in (-0.5, 0.5) for y in (-0.5, 0.5) for x in (-0.5, 0.5)])


@dataclass(frozen=True, eq=False)
class FruitTruth:
    """A fruit of a scene in world metres, the same in all views.

    Attributes:
        index: index of its instance.
        instance: its entry in the scene's instances.
        pose: `(4, 4)` fruit to world: from its stalk end, x to its upper side, y right, z along its axis.
        low, high: `(3,)` its bounding box, in those axes.
        measures: `ripeness`, `ripeness_spread`, `length_m`, `diameter_m`.
        blossom_end: `(3,)` the point of its skin opposite the stalk, in world metres.
        lineage: indices of the organs from itself down to the main stem.
        stalk: the stalk that it is harvested with, or None.
        approach: the tool's approach to it, or None.
    """

    index: int
    instance: Instance
    pose: FloatArray
    low: FloatArray
    high: FloatArray
    measures: dict[str, float]
    blossom_end: FloatArray
    lineage: tuple[int, ...]
    stalk: FruitStalk | None
    approach: Approach | None


@dataclass(frozen=True, eq=False)
class LabelView:
    """The labels of an image."""

    camera: Camera  # the camera
    instance: NDArray[np.uint16]  # `(h, w)` the instance image
    distance: NDArray[np.float32]  # `(h, w)` metres along the rays through the pixel centres

    @property
    def rotation(self) -> FloatArray:
        """`(3, 3)` world to camera."""
        return self.camera.pose[:3, :3].T

    def points(self, world: FloatArray) -> FloatArray:
        """`(n, 3)` world points in camera metres."""
        return (world - self.camera.pose[:3, 3]) @ self.camera.pose[:3, :3]

    def distance_to(self, point: FloatArray, row: int) -> float:
        """Metres from the camera to a world point `(3,)` that is in this row of the image."""
        if self.camera.rows_move:
            return float(np.linalg.norm(point - self.camera.label_centres(row + 0.5)))
        return float(np.linalg.norm(self.points(point)))


def harvest_truth(
    fruit: Sequence[tuple[FruitTruth, AmodalMask]], view: LabelView, instances: Sequence[Instance]
) -> dict[str, Any]:
    """The output `harvest` of an image.

    Args:
        fruit: the fruit in view, and the pixels that each would have if nothing occluded it.
        view: the labels of the image.
        instances: of the scene.
    """
    # Project the points of all fruit in one call, which takes the time of one point.
    points = [_projected_points(organ) for organ, _ in fruit]
    pixels = view.camera.project(np.concatenate([*points, np.empty((0, 3))]))
    parts = np.split(pixels, np.cumsum([len(part) for part in points]))
    entries = [
        _fruit_entry(organ, mask, view, part) for (organ, mask), part in zip(fruit, parts, strict=False)
    ]
    graph = organ_graph((organ.lineage for organ, _ in fruit), instances, np.bincount(view.instance.ravel()))
    return {"format": FORMAT, "fruit": entries, "graph": graph}


def organ_graph(
    lineages: Iterable[Sequence[int]], instances: Sequence[Instance], pixels: NDArray[np.integer[Any]]
) -> dict[str, list[Any]]:
    """The organs from each fruit down to the main stem, in view or not; edges go from child to parent.

    Args:
        lineages: for each fruit its index, that of its parent, and so on down to the main stem.
        instances: of the scene.
        pixels: number of pixels of each value of the instance image.
    """
    lineages = list(lineages)
    nodes = sorted({index for lineage in lineages for index in lineage})
    edges = sorted({(child, parent) for lineage in lineages for child, parent in pairwise(lineage)})
    return {
        "nodes": [
            {
                "instance": index + 1,
                "kind": instances[index].kind,
                "class": int(instances[index].organ_class),
                "plant": instances[index].plant,
                "phytomer": instances[index].phytomer,
                "pixels": int(pixels[index + 1]) if index + 1 < len(pixels) else 0,
            }
            for index in nodes
        ],
        "edges": [[child + 1, parent + 1] for child, parent in edges],
    }


def _projected_points(fruit: FruitTruth) -> FloatArray:
    """`(n, 3)` world points whose pixel coordinates are given.

    Corners of the box, stalk end, blossom end, and if there is a stalk, its attachment and cut.
    """
    centre = fruit.pose[:3, 3] + fruit.pose[:3, :3] @ (0.5 * (fruit.low + fruit.high))
    corners = centre + (_CORNERS * (fruit.high - fruit.low)) @ fruit.pose[:3, :3].T
    points = np.vstack([corners, fruit.pose[:3, 3], fruit.blossom_end])
    return points if fruit.stalk is None else np.vstack([points, fruit.stalk.attachment, fruit.stalk.cut])


def _fruit_entry(fruit: FruitTruth, amodal: AmodalMask, view: LabelView, px: FloatArray) -> dict[str, Any]:
    """The entry of one fruit, with the pixel coordinates of its `_projected_points`."""
    stalk, approach = fruit.stalk, fruit.approach
    corners, (stalk_end, blossom_end), stalk_px = np.split(px, [len(_CORNERS), len(_CORNERS) + 2])
    skin_depth = _SKIN_DEPTH * fruit.measures["diameter_m"]
    # The end of the stalk covers the point where the two meet, and the calyx is around it.
    around = fruit.lineage[: fruit.lineage.index(stalk.instance) + 1] if stalk else fruit.lineage[:1]
    stalk_depth = _VISIBLE_DEPTH * stalk.radius_m if stalk else skin_depth
    return {
        "instance": fruit.index + 1,
        "plant": fruit.instance.plant,
        "phytomer": fruit.instance.phytomer,
        "kind": fruit.instance.kind,
        **{name: _rounded(value) for name, value in fruit.measures.items()},
        "pose": _camera_pose(fruit, view),
        **visibility_entry(fruit.index, amodal, view.instance),
        "box_3d": _box_3d(fruit, view, corners),
        "stalk_end": _point_entry(fruit.pose[:3, 3], stalk_end, around, stalk_depth, view),
        "blossom_end": _point_entry(fruit.blossom_end, blossom_end, (fruit.index,), skin_depth, view),
        "peduncle": None if stalk is None else _stalk_entry(stalk, view, *stalk_px),
        "approach": None if approach is None else _approach_entry(approach, view),
    }


def _camera_pose(fruit: FruitTruth, view: LabelView) -> list[list[float]]:
    """`(4, 4)` fruit to camera."""
    pose = np.eye(4)
    pose[:3, :3] = view.rotation @ fruit.pose[:3, :3]
    pose[:3, 3] = view.points(fruit.pose[:3, 3])
    return _lists(pose, 9)


def _box_3d(fruit: FruitTruth, view: LabelView, corners: FloatArray) -> dict[str, Any]:
    """The fruit's bounding box along its own axes."""
    rotation, origin = fruit.pose[:3, :3], fruit.pose[:3, 3]
    return {
        "centre": _lists(view.points(origin + rotation @ (0.5 * (fruit.low + fruit.high)))),
        "size": _lists(fruit.high - fruit.low),
        "rotation": _lists(view.rotation @ rotation, 9),
        # Corners behind the camera have no pixel coordinates.
        "corners_px": [_lists(corner, 3) if np.isfinite(corner).all() else None for corner in corners],
    }


def _stalk_entry(
    stalk: FruitStalk, view: LabelView, attachment: FloatArray, cut: FloatArray
) -> dict[str, Any]:
    """The fruit's stalk, with the pixel coordinates of its attachment and its cut."""
    # At the attachment, the stalk's parent may be in front of the centreline too.
    both, depth = (stalk.instance, stalk.parent), _VISIBLE_DEPTH * stalk.radius_m
    return {
        "instance": stalk.instance + 1,
        "length_m": _rounded(stalk.length_m),
        "radius_m": _rounded(stalk.radius_m),
        "curve_m": _lists(view.points(stalk.curve)),
        "attachment": _point_entry(stalk.attachment, attachment, both, depth, view),
        "cut": {
            **_point_entry(stalk.cut, cut, both[:1], depth, view),
            "tangent": _lists(view.rotation @ stalk.tangent, 9),
        },
    }


def _point_entry(
    point: FloatArray, px: FloatArray, organs: Sequence[int], depth_m: float, view: LabelView
) -> dict[str, Any]:
    """A point of a stalk or a fruit; visible if its pixel shows one of the organs within a depth of it."""
    # Comparisons with nan are false.
    size = np.array([view.camera.width, view.camera.height])
    inside = bool((px >= 0.0).all() and (px < size).all())
    visible = False
    if inside:
        row, column = int(px[1]), int(px[0])
        depth = float(view.distance[row, column]) - view.distance_to(point, row)
        visible = int(view.instance[row, column]) - 1 in organs and abs(depth) <= depth_m
    return {
        "camera_m": _lists(view.points(point)),
        "world_m": _lists(point),
        # Rounding must not move a point near the right or lower border out of the image.
        "px": _lists(np.minimum(px, size - 1e-3), 3) if inside else None,
        "visible": visible,
    }


def _approach_entry(approach: Approach, view: LabelView) -> dict[str, Any]:
    return {
        "camera": _lists(view.rotation @ approach.direction, 9),
        "world": _lists(approach.direction, 9),
        "azimuth_rad": _rounded(approach.azimuth(view.camera.pose)),
        "stem_camera_m": _lists(view.points(approach.stem)),
        "stem_world_m": _lists(approach.stem),
    }


def _rounded(value: float, digits: int = 6) -> float:
    """Rounded to a micrometre by default, without negative zero."""
    return round(float(value), digits) + 0.0


def _lists(values: ArrayLike, digits: int = 6) -> list[Any]:
    """An array as lists of rounded numbers."""
    return list((np.round(np.asarray(values, dtype=float), digits) + 0.0).tolist())
