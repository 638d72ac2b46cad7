"""The organs, fruit and added objects of a living scene, as frozen objects and as tables."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from pepperscene.classes import Instance, OrganClass
from pepperscene.scene import Skeleton
from pepperscene.scene.placement import organ_poses
from pepperscene.truth.harvest import FruitTruth

if TYPE_CHECKING:
    import pyarrow

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class SceneOrgan:
    """An organ or an added object of a living scene; lengths are metres in world coordinates.

    Attributes:
        instance: its number in instance images.
        kind: of organ in the cultivar file ("lamina"), or of object.
        organ_class: its label.
        plant: number of the plant that it belongs to, -1 for none.
        phytomer: position along the main stem, -1 for none.
        parent: number of the instance that it grows on, 0 for none.
        pose: `(4, 4)` to world: from its base, x to its upper side, y to the right, z along it; of an object
            as it was given.
        length_m: from its base to its tip; nan of an object.
    """

    instance: int
    kind: str
    organ_class: OrganClass
    plant: int
    phytomer: int
    parent: int
    pose: FloatArray
    length_m: float


@dataclass(frozen=True, eq=False)
class SceneFruit:
    """A fruit of a living scene, as the output `harvest` has it, in world coordinates and metres.

    Attributes:
        instance: its number in instance images.
        kind: of organ in the cultivar file.
        plant: number of the plant that bears it.
        phytomer: position along the main stem.
        ripeness: 0 unripe to 1 ripe.
        pose: `(4, 4)` to world: from the stalk end, x to its upper side, y to the right, z along its axis.
        size_m: `(3,)` of its bounding box along these axes.
        length_m: without the bend.
        diameter_m: largest.
        blossom_end: `(3,)` the point opposite the stalk.
        stalk: number of the stalk that it is cut with, 0 for none.
        stalk_curve: `(k, 3)` centreline of the stalk, from where it emerges; empty for none.
        cut: `(3,)` the cut point on that line, or None.
        cut_tangent: `(3,)` unit tangent there, towards the fruit, or None.
        approach: `(3,)` horizontal unit vector of a tool's motion to the fruit, the stem behind it, or None.
        visible_fraction: of the pixels that it would have alone, in the last view; 0 of a fruit outside it,
            nan before the first view.
    """

    instance: int
    kind: str
    plant: int
    phytomer: int
    ripeness: float
    pose: FloatArray
    size_m: FloatArray
    length_m: float
    diameter_m: float
    blossom_end: FloatArray
    stalk: int
    stalk_curve: FloatArray
    cut: FloatArray | None
    cut_tangent: FloatArray | None
    approach: FloatArray | None
    visible_fraction: float


Item = TypeVar("Item", SceneOrgan, SceneFruit)


class SceneList(tuple[Item, ...]):
    """Organs or fruit of a living scene, in the order of their numbers."""

    __slots__ = ()

    def of(self, instance: int) -> Item:
        """The one with a number; raises `KeyError` if there is none."""
        for item in self:
            if item.instance == instance:
                return item
        raise KeyError(instance)

    def to_table(self) -> pyarrow.Table:
        """A table with a row for each, and the attributes as columns; arrays are lists, row by row."""
        import pyarrow

        names = [field.name for field in fields(self[0])] if self else []
        columns = {name: [_plain(getattr(item, name)) for item in self] for name in names}
        return pyarrow.table(columns)


def _plain(value: Any) -> Any:
    """An attribute as Arrow takes it."""
    if isinstance(value, np.ndarray):
        return value.ravel().tolist()
    return value.name.lower() if isinstance(value, OrganClass) else value


def scene_organs(
    skeleton: Skeleton,
    instances: tuple[Instance, ...],
    present: NDArray[np.bool_],
    objects: Mapping[int, FloatArray],
) -> SceneList[SceneOrgan]:
    """The organs that have triangles, and the added objects."""
    indices = [i for i in skeleton.instances() if i < len(present) and present[i] and skeleton.kind(i)]
    organs = [skeleton.organ(index) for index in indices]
    made = []
    for index, organ, pose in zip(indices, organs, organ_poses(organs), strict=True):
        length_m = float(np.linalg.norm(np.diff(organ.curve, axis=0), axis=1).sum())
        made.append(_organ(index, instances[index], pose, length_m))
    made += [_organ(index, instances[index], pose, np.nan) for index, pose in sorted(objects.items())]
    return SceneList(made)


def _organ(index: int, item: Instance, pose: FloatArray, length_m: float) -> SceneOrgan:
    own = (item.kind, item.organ_class, item.plant, item.phytomer, item.parent + 1)
    return SceneOrgan(index + 1, *own, pose, length_m)


def scene_fruit(truths: Iterable[FruitTruth], visible: Mapping[int, float] | None) -> SceneList[SceneFruit]:
    """The fruit of their truths.

    `visible` is the `visible_fraction` of the fruit in view by number in instance images; None before a view.
    """
    return SceneList([_fruit(truth, visible) for truth in truths])


def _fruit(truth: FruitTruth, visible: Mapping[int, float] | None) -> SceneFruit:
    stalk, number = truth.stalk, truth.index + 1
    return SceneFruit(
        instance=number,
        kind=truth.instance.kind,
        plant=truth.instance.plant,
        phytomer=truth.instance.phytomer,
        ripeness=truth.measures["ripeness"],
        pose=truth.pose,
        size_m=truth.high - truth.low,
        length_m=truth.measures["length_m"],
        diameter_m=truth.measures["diameter_m"],
        blossom_end=truth.blossom_end,
        stalk=0 if stalk is None else stalk.instance + 1,
        stalk_curve=np.zeros((0, 3)) if stalk is None else stalk.curve,
        cut=None if stalk is None else stalk.cut,
        cut_tangent=None if stalk is None else stalk.tangent,
        approach=None if truth.approach is None else truth.approach.direction,
        visible_fraction=np.nan if visible is None else visible.get(number, 0.0),
    )
