"""What a harvest robot would want to know of every fruit in a picture, as JSON tells it.

Instances are told as the values of the instance image: the index of the organ plus 1. Lengths are metres,
places in the picture continuous pixel coordinates; both are rounded far below what can be seen of them.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pepperscene.camera import Camera
from pepperscene.classes import Instance
from pepperscene.truth.cut_point import Approach, FruitStalk
from pepperscene.truth.encodings import encode_rle, mask_box, touches_border


def organ_graph(
    lines: Iterable[Sequence[int]], instances: Sequence[Instance], pixels: NDArray[np.integer[Any]]
) -> dict[str, list[Any]]:
    """Nodes and edges as JSON tells them; an edge goes from what grows to what it grows on.

    Args:
        lines: for each fruit its index, that of what it grows on, and so on down to the main stem's organ.
        instances: of the scene.
        pixels: how many each value of the instance image has.
    """
    told = list(lines)
    nodes = sorted({index for line in told for index in line})
    edges = sorted({(child, parent) for line in told for child, parent in pairwise(line)})
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


FORMAT: Final = "pepperscene harvest 1"

FloatArray = NDArray[np.float64]

_NEAR: Final = 3.0
"""Chosen: radii of the stalk that a surface lies before its centreline at most, where that counts as seen. A
tube seen at 20 degrees to its axis shows its skin so far in front."""
_CORNERS: Final = np.array([[x, y, z] for z in (-0.5, 0.5) for y in (-0.5, 0.5) for x in (-0.5, 0.5)])


@dataclass(frozen=True, eq=False)
class FruitTruth:
    """A fruit of a scene, in world metres; the same in all its views.

    Attributes:
        instance: its index.
        about: the organ, as the scene's instances tell it.
        pose: `(4, 4)` fruit to world: from where it hangs, x to its upper side, y right, z along its axis.
        low, high: `(3,)` the box that holds it, in those axes.
        measures: `ripeness`, `ripeness_spread`, `length_m`, `diameter_m`.
        line: indices of the organs from it down to the main stem, itself first.
        stalk: that it is harvested with, or None.
        approach: to it, or None.
    """

    instance: int
    about: Instance
    pose: FloatArray
    low: FloatArray
    high: FloatArray
    measures: dict[str, float]
    line: tuple[int, ...]
    stalk: FruitStalk | None
    approach: Approach | None


@dataclass(frozen=True, eq=False)
class AmodalMask:
    """The pixels that a fruit would have if nothing stood before it.

    Attributes:
        corner: column and row of the first pixel of `mask` in the picture.
        mask: `(h, w)` of a part of the picture that holds them all.
    """

    corner: tuple[int, int]
    mask: NDArray[np.bool_]

    def of(self, image: NDArray[Any]) -> NDArray[Any]:
        """The part of a picture that the mask tells of."""
        (x, y), (height, width) = self.corner, self.mask.shape
        return image[y : y + height, x : x + width]


@dataclass(frozen=True, eq=False)
class LabelView:
    """What is seen.

    Attributes:
        camera: that looks.
        instance: `(h, w)` the instance image.
        distance: `(h, w)` metres along the rays through the pixels' centres.
        pixels: how many each value of the instance image has.
    """

    camera: Camera
    instance: NDArray[np.uint16]
    distance: NDArray[np.float32]
    pixels: NDArray[np.intp] = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "pixels", np.bincount(self.instance.ravel()))

    @property
    def rotation(self) -> FloatArray:
        """`(3, 3)` world to camera."""
        return self.camera.pose[:3, :3].T

    def points(self, world: FloatArray) -> FloatArray:
        """`(n, 3)` world points in camera metres."""
        return (world - self.camera.pose[:3, 3]) @ self.camera.pose[:3, :3]


def harvest_truth(
    found: Sequence[tuple[FruitTruth, AmodalMask]], picture: LabelView, instances: Sequence[Instance]
) -> dict[str, Any]:
    """The output `harvest` of a picture.

    Args:
        found: its fruit, and the pixels that each would have.
        picture: what is seen.
        instances: of the scene.
    """
    # All places at once: a camera projects many points in the time of one.
    points = [_points(fruit) for fruit, _ in found]
    places = picture.camera.project(np.concatenate([*points, np.empty((0, 3))]))
    ends = np.cumsum([len(one) for one in points])
    return {
        "format": FORMAT,
        "fruit": [
            _fruit(fruit, amodal, picture, places[end - len(one) : end])
            for (fruit, amodal), one, end in zip(found, points, ends, strict=True)
        ],
        "graph": organ_graph((fruit.line for fruit, _ in found), instances, picture.pixels),
    }


def _points(fruit: FruitTruth) -> FloatArray:
    """`(n, 3)` world points whose places in the picture are told: corners of the box, attachment and cut."""
    centre = fruit.pose[:3, 3] + fruit.pose[:3, :3] @ (0.5 * (fruit.low + fruit.high))
    corners = centre + (_CORNERS * (fruit.high - fruit.low)) @ fruit.pose[:3, :3].T
    return corners if fruit.stalk is None else np.vstack([corners, fruit.stalk.attachment, fruit.stalk.cut])


def _fruit(fruit: FruitTruth, amodal: AmodalMask, picture: LabelView, places: FloatArray) -> dict[str, Any]:
    """What is told of one fruit, of whose `_points` these are the places in the picture."""
    stalk, approach = fruit.stalk, fruit.approach
    return {
        "instance": fruit.instance + 1,
        "plant": fruit.about.plant,
        "phytomer": fruit.about.phytomer,
        "kind": fruit.about.kind,
        **{name: _rounded(value) for name, value in fruit.measures.items()},
        "pose": _pose(fruit, picture),
        **_seen(fruit, amodal, picture),
        "box_3d": _box_3d(fruit, picture, places[: len(_CORNERS)]),
        "peduncle": None if stalk is None else _stalk(stalk, picture, places[len(_CORNERS) :]),
        "approach": None if approach is None else _approach(approach, picture),
    }


def _seen(fruit: FruitTruth, amodal: AmodalMask, picture: LabelView) -> dict[str, Any]:
    """Masks and boxes: what is seen of it, what would be, and what stands before it."""
    shown = amodal.of(picture.instance)
    visible = shown == fruit.instance + 1
    whole = mask_box(amodal.mask, amodal.corner)
    if whole is None:
        raise ValueError("a fruit without any pixel is not in the picture")
    count, seen = int(amodal.mask.sum()), int(visible.sum())
    box = mask_box(visible, amodal.corner)
    before = np.bincount(shown[amodal.mask & ~visible])
    others = np.flatnonzero(before)
    # Most pixels first; the lower number where two have as many.
    others = others[np.argsort(-before[others], kind="stable")]
    return {
        "box": None if box is None else list(box),
        "amodal_box": list(whole),
        "visible_pixels": seen,
        "amodal_pixels": count,
        "visible_fraction": _rounded(seen / count),
        "truncated": touches_border(whole, picture.instance.shape),
        "occluders": [{"instance": int(one), "pixels": int(before[one])} for one in others if one > 0],
        "amodal": encode_rle(amodal.mask, picture.instance.shape, amodal.corner),
    }


def _pose(fruit: FruitTruth, picture: LabelView) -> list[list[float]]:
    """`(4, 4)` fruit to camera."""
    pose = np.eye(4)
    pose[:3, :3] = picture.rotation @ fruit.pose[:3, :3]
    pose[:3, 3] = picture.points(fruit.pose[:3, 3])
    return _lists(pose, 9)


def _box_3d(fruit: FruitTruth, picture: LabelView, corners: FloatArray) -> dict[str, Any]:
    """The box that holds the fruit, with edges along its own axes."""
    turn, foot = fruit.pose[:3, :3], fruit.pose[:3, 3]
    return {
        "centre": _lists(picture.points(foot + turn @ (0.5 * (fruit.low + fruit.high)))),
        "size": _lists(fruit.high - fruit.low),
        "rotation": _lists(picture.rotation @ turn, 9),
        # A corner behind the camera is nowhere in the picture.
        "corners_px": [_lists(corner, 3) if np.isfinite(corner).all() else None for corner in corners],
    }


def _stalk(stalk: FruitStalk, picture: LabelView, places: FloatArray) -> dict[str, Any]:
    """The fruit's stalk; its attachment and its cut lie at these places in the picture."""
    # At the joint, the body that bears the stalk shows as well.
    joint, cut = (
        _point(point, place, own, stalk.radius_m, picture)
        for point, place, own in zip(
            (stalk.attachment, stalk.cut),
            places,
            ((stalk.instance, stalk.bearer), (stalk.instance,)),
            strict=True,
        )
    )
    return {
        "instance": stalk.instance + 1,
        "length_m": _rounded(stalk.length_m),
        "radius_m": _rounded(stalk.radius_m),
        "curve_m": _lists(picture.points(stalk.curve)),
        "attachment": joint,
        "cut": {**cut, "tangent": _lists(picture.rotation @ stalk.tangent, 9)},
    }


def _point(
    point: FloatArray, place: FloatArray, own: Sequence[int], radius_m: float, picture: LabelView
) -> dict[str, Any]:
    """A point of a stalk's centreline; seen where its pixel shows the skin right in front of it."""
    # Comparisons with nan are false.
    inside = bool((place >= 0.0).all() and (place < [picture.camera.width, picture.camera.height]).all())
    return {
        "camera_m": _lists(picture.points(point)),
        "world_m": _lists(point),
        "px": _lists(place, 3) if inside else None,
        "visible": inside and _shown(point, place, own, radius_m, picture),
    }


def _shown(
    point: FloatArray, place: FloatArray, own: Sequence[int], radius_m: float, picture: LabelView
) -> bool:
    """Whether the first surface behind the pixel that a point falls into is its own, and near it."""
    row, column = int(place[1]), int(place[0])
    away = float(picture.distance[row, column]) - float(np.linalg.norm(picture.points(point)))
    return int(picture.instance[row, column]) - 1 in own and abs(away) <= _NEAR * radius_m


def _approach(approach: Approach, picture: LabelView) -> dict[str, Any]:
    return {
        "camera": _lists(picture.rotation @ approach.direction, 9),
        "world": _lists(approach.direction, 9),
        "azimuth_rad": _rounded(approach.azimuth(picture.camera.pose)),
        "stem_camera_m": _lists(picture.points(approach.stem)),
        "stem_world_m": _lists(approach.stem),
    }


def _rounded(value: float, digits: int = 6) -> float:
    """To a micrometre, as a rule; no negative zero."""
    return round(float(value), digits) + 0.0


def _lists(values: ArrayLike, digits: int = 6) -> list[Any]:
    """An array as lists of rounded numbers."""
    return list((np.round(np.asarray(values, dtype=float), digits) + 0.0).tolist())
