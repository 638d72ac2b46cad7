"""The output `harvest`: what is known of every fruit in a picture."""

from __future__ import annotations

from functools import cached_property
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.camera import Camera
from pepperscene.errors import InputError
from pepperscene.geometry.fruit import frames
from pepperscene.geometry.spine import spines
from pepperscene.grammar import Organ
from pepperscene.render.amodal import Alone, alone, hit_pixels
from pepperscene.render.labels import Hits
from pepperscene.render.view import View
from pepperscene.scene import Scene, Skeleton
from pepperscene.truth.harvest import Amodal, Fruit, Picture, harvest_facts
from pepperscene.truth.harvest_approach import approach
from pepperscene.truth.harvest_stalk import FruitStalk, fruit_stalk

_STEPS: Final = 32
"""Chosen: pieces of a stalk's centreline; its corners then lie within micrometres of the curve."""


class Harvest:
    """The fruit of a scene, each ready to be looked at by itself.

    Args:
        scene: with the skeleton of its plants.

    Raises:
        InputError: nobody has told where the scene's organs are.
    """

    def __init__(self, scene: Scene) -> None:
        if scene.skeleton is None:
            raise InputError(
                "--outputs", "", None, "harvest needs a scene that was assembled with its plants' skeleton"
            )
        self._scene, self._bones = scene, scene.skeleton
        self._fruit: dict[int, Fruit] = {}

    def truth(self, camera: Camera, view: View, hits: Hits, instance: NDArray[np.uint16]) -> dict[str, Any]:
        """The output `harvest` of a view.

        Args:
            camera: that looks.
            view: its rays in the region of the scene.
            hits: behind its pixels.
            instance: `(h, w)` the instance image.
        """
        near = [index for index, here in zip(self._alone, self._in_view(camera), strict=True) if here]
        boxes = {index: box for index in near if (box := self._alone[index].box(camera)) is not None}
        masks = hit_pixels([(self._alone[index], box) for index, box in boxes.items()], view)
        found = []
        for (index, (x, y, *_)), mask in zip(boxes.items(), masks, strict=True):
            amodal = Amodal((x, y), mask)
            # Where rays of equal direction disagree at an outline, what is seen is there.
            mask |= amodal.of(instance) == index + 1
            if mask.any():
                found.append((self._known(index), amodal))
        picture = Picture(camera, instance, hits.distance)
        return harvest_facts(found, picture, self._scene.mesh.instances)

    # --- what is in view --------------------------------------------------------------------------------

    @cached_property
    def _alone(self) -> dict[int, Alone]:
        """The scene's fruit, by index."""
        return alone(self._scene.mesh, self._bones.of_form("fruit"))

    @cached_property
    def _balls(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """`(n, 3)` and `(n,)` metres: balls that hold the fruit."""
        bounds = np.array([one.mesh.bounds for one in self._alone.values()], dtype=float).reshape(-1, 2, 3)
        return bounds.mean(axis=1), 0.5 * np.linalg.norm(bounds[:, 1] - bounds[:, 0], axis=1)

    def _in_view(self, camera: Camera) -> NDArray[np.bool_]:
        """`(n,)` which fruit's balls reach into the field of view."""
        centres, radii = self._balls
        x, y, z = ((centres - camera.pose[:3, 3]) @ camera.pose[:3, :3]).T
        slopes = camera.ray_slopes()
        inside = z > -radii
        # The picture lies between the extreme slopes of its borders.
        for along, axis in ((x, 0), (y, 1)):
            border = np.concatenate([slopes[[0, -1], :, axis].ravel(), slopes[:, [0, -1], axis].ravel()])
            for side, limit in ((1.0, border.max()), (-1.0, -border.min())):
                inside &= side * along - limit * z <= radii * np.hypot(1.0, limit)
        return inside

    # --- what is known of a fruit, whatever looks at it ----------------------------------------------------

    def _known(self, index: int) -> Fruit:
        if index not in self._fruit:
            self._fruit[index] = self._made(index)
        return self._fruit[index]

    def _made(self, index: int) -> Fruit:
        organ, bones, about = self._bones.organ(index), self._bones, self._scene.mesh.instances[index]
        hung = frames([organ])
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = hung.axes[0].T, hung.foot[0]
        local = (self._alone[index].mesh.vertices - hung.foot[0]) @ hung.axes[0].T
        low, high = local.min(axis=0), local.max(axis=0)
        centre = hung.foot[0] + pose[:3, :3] @ (0.5 * (low + high))
        line = _line(bones, index)
        return Fruit(
            index,
            about,
            pose,
            low,
            high,
            {
                name: float(organ.measures.get(name, 0.0))
                for name in ("ripeness", "ripeness_spread", "length_m", "diameter_m")
            },
            line,
            _stalk(bones, line),
            approach(centre, self._stem(about.plant)),
        )

    def _stem(self, plant: int) -> NDArray[np.float64]:
        """`(k, 3)` axis of a plant's main stem."""
        if plant not in self._stems:
            parts = self._bones.of_form("internode", "node", plant=max(plant, 0))
            self._stems[plant] = np.concatenate([self._bones.organ(part).curve for part in parts])
        return self._stems[plant]

    @cached_property
    def _stems(self) -> dict[int, NDArray[np.float64]]:
        return {}


def _line(bones: Skeleton, index: int) -> tuple[int, ...]:
    """Indices from an organ down to the first of the main stem's."""
    found = [index]
    while not _is_stem(bones, found[-1]) and (parent := bones.organ(found[-1]).parent) >= 0:
        found.append(parent)
    return tuple(found)


def _is_stem(bones: Skeleton, index: int) -> bool:
    kind = bones.kind(index)
    return kind is not None and kind.form in ("internode", "node")


def _stalk(bones: Skeleton, line: tuple[int, ...]) -> FruitStalk | None:
    """The stalk that a fruit sits on, with or without a calyx in between; None for one that sits on none."""
    forms = [kind.form if (kind := bones.kind(index)) is not None else None for index in line]
    place = next((step for step in range(1, len(line)) if forms[step] != "calyx"), len(line))
    if place == len(line) or forms[place] != "peduncle":
        return None
    organ = bones.organ(line[place])
    # The very curve that the stalk's body is built around.
    smooth = spines([organ.curve], [organ.up], _STEPS).points[0]
    on = line[place + 1] if place + 1 < len(line) else -1
    return fruit_stalk(
        smooth,
        float(organ.measures["radius_m"]),
        _body(bones.organ(on)) if on >= 0 else None,
        instance=line[place],
        bearer_instance=on,
        on_stalk=on >= 0 and forms[place + 1] == "peduncle",
    )


def _body(organ: Organ) -> tuple[NDArray[np.float64], float, float]:
    """Centreline of a tube and its radii at both ends; a node is as wide as it is at its widest."""
    radius = float(organ.measures.get("radius_m", 0.0))
    return organ.curve, radius, float(organ.measures.get("radius_tip_m", radius))
