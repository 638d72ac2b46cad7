"""The output `harvest`: ground truth of each fruit in an image."""

from __future__ import annotations

from functools import cached_property
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.camera import Camera
from pepperscene.errors import ArgumentError
from pepperscene.geometry.fruit.fruits import fruit_frames
from pepperscene.geometry.spine import spines
from pepperscene.grammar import Organ
from pepperscene.render.aov.isolated import IsolatedOrgan, IsolatedOrgans
from pepperscene.render.kernel.camera import CameraRays
from pepperscene.scene import Scene, Skeleton
from pepperscene.truth.cut_point import FruitStalk, blossom_end, fruit_stalk, tool_approach
from pepperscene.truth.harvest import FruitTruth, LabelView, harvest_truth

_STALK_STEPS: Final = 32  # chosen: pieces of a stalk's centreline, within micrometres of the curve


class SceneHarvest:
    """The fruit of a scene, each isolated, and their truth.

    Args:
        scene: with the skeleton of its plants.
        organs: of the scene.

    Raises:
        ArgumentError: the scene has no skeleton, or its mesh was edited since it was assembled.
    """

    def __init__(self, scene: Scene, organs: IsolatedOrgans) -> None:
        if scene.skeleton is None:
            raise ArgumentError(
                "outputs", "harvest needs a scene that was assembled with its plants' skeleton"
            )
        scene.skeleton.check_mesh(scene.mesh)
        self._mesh, self._skeleton, self._organs = scene.mesh, scene.skeleton, organs
        self._truths: dict[int, FruitTruth] = {}
        self._stem_axes: dict[int, NDArray[np.float64]] = {}

    def truth(
        self,
        camera: Camera,
        rays: CameraRays,
        distance: NDArray[np.float32],
        instance: NDArray[np.uint16],
    ) -> dict[str, Any]:
        """Compute the output `harvest` from a camera's rays, and its images of distances and instances."""
        near = [index for index, in_view in zip(self._fruit, self._in_view(camera), strict=True) if in_view]
        fruit = []
        for index, amodal in self._organs.amodal_masks(near, camera, rays, instance):
            fruit.append((self._truth_of(index), amodal))
        view = LabelView(camera, instance, distance)
        return harvest_truth(fruit, view, self._mesh.instances)

    def truths(self) -> list[FruitTruth]:
        """The truth of all fruit, in view or not, by ascending index."""
        return [self._truth_of(index) for index in self._fruit]

    def _truth_of(self, index: int) -> FruitTruth:
        # The truth of a fruit is the same in all views.
        if index not in self._truths:
            self._truths[index] = self._fruit_truth(index)
        return self._truths[index]

    @cached_property
    def _fruit(self) -> dict[int, IsolatedOrgan]:
        """The scene's fruit by index."""
        return self._organs.of(self._skeleton.of_form("fruit"))

    @cached_property
    def _bounding_spheres(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """`(n, 3)` centres and `(n,)` radii of the fruit's bounding spheres, metres."""
        bounds = np.array([organ.mesh.bounds for organ in self._fruit.values()], float).reshape(-1, 2, 3)
        return bounds.mean(axis=1), 0.5 * np.linalg.norm(bounds[:, 1] - bounds[:, 0], axis=1)

    def _in_view(self, camera: Camera) -> NDArray[np.bool_]:
        """`(n,)` whether a fruit's bounding sphere reaches into the field of view.

        Of 196 fruit of a row 35 do; not projecting the others saves 21 of 58 ms.
        """
        centres, radii = self._bounding_spheres
        x, y, z = ((centres - camera.pose[:3, 3]) @ camera.pose[:3, :3]).T
        if camera.motion is not None and camera.rows_move:
            # In camera axes, a centre moves at most this much from the middle row to the first or last.
            speed, time = float(np.linalg.norm(camera.motion.velocity_m_s)), 0.5 * camera.shutter.readout_s
            farthest = np.linalg.norm([x, y, z], axis=0) + speed * time
            radii = radii + (speed + camera.motion.angular_speed_rad_s * farthest) * time
        borders = np.concatenate(camera.border_slopes())
        inside = z > -radii
        # The image is between the extreme slopes of its borders.
        for along, axis in ((x, 0), (y, 1)):
            border = borders[:, axis]
            for side, limit in ((1.0, border.max()), (-1.0, -border.min())):
                inside &= side * along - limit * z <= radii * np.hypot(1.0, limit)
        return inside

    def _fruit_truth(self, index: int) -> FruitTruth:
        organ, instance = self._skeleton.organ(index), self._mesh.instances[index]
        frames = fruit_frames([organ])
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = frames.axes[0].T, frames.foot[0]
        mesh = self._fruit[index].mesh
        local = (mesh.vertices - frames.foot[0]) @ frames.axes[0].T
        end = frames.foot[0] + pose[:3, :3] @ blossom_end(local, mesh.faces, mesh.uv[:, 1])
        low, high = local.min(axis=0), local.max(axis=0)
        centre = frames.foot[0] + pose[:3, :3] @ (0.5 * (low + high))
        ancestors = organ_ancestors(self._skeleton, index)
        names = ("ripeness", "ripeness_spread", "length_m", "diameter_m")
        measures = {name: float(organ.measures.get(name, 0.0)) for name in names}
        stalk = find_fruit_stalk(self._skeleton, ancestors)
        approach = tool_approach(centre, self._stem_axis(self._skeleton.plant_index(index)))
        return FruitTruth(index, instance, pose, low, high, measures, end, ancestors, stalk, approach)

    def _stem_axis(self, plant: int) -> NDArray[np.float64]:
        """`(k, 3)` axis of the main stem of a plant, by its position in the skeleton."""
        if plant not in self._stem_axes:
            parts = self._skeleton.of_form("internode", "node", plant=plant)
            self._stem_axes[plant] = np.concatenate([self._skeleton.organ(part).curve for part in parts])
        return self._stem_axes[plant]


def organ_ancestors(skeleton: Skeleton, index: int) -> tuple[int, ...]:
    """Indices of an organ, its parent and so on, down to the first organ of the main stem."""
    line = []
    while index >= 0:
        line.append(index)
        index = -1 if _organ_form(skeleton, index) in ("internode", "node") else skeleton.organ(index).parent
    return tuple(line)


def _organ_form(skeleton: Skeleton, index: int) -> str | None:
    kind = skeleton.kind(index)
    return None if kind is None else kind.form


def find_fruit_stalk(skeleton: Skeleton, ancestors: tuple[int, ...]) -> FruitStalk | None:
    """The stalk of a fruit, directly above it or above its calyx; None if it has none."""
    forms = [_organ_form(skeleton, index) for index in ancestors]
    position = next((step for step in range(1, len(forms)) if forms[step] != "calyx"), len(forms))
    if position == len(forms) or forms[position] != "peduncle":
        return None
    organ = skeleton.organ(ancestors[position])
    # The same curve that the stalk's mesh is built around.
    smooth = spines([organ.curve], [organ.up], _STALK_STEPS).points[0]
    parent = ancestors[position + 1] if position + 1 < len(ancestors) else -1
    return fruit_stalk(
        smooth,
        float(organ.measures["radius_m"]),
        _tube_shape(skeleton.organ(parent)) if parent >= 0 else None,
        instance=ancestors[position],
        parent_instance=parent,
        on_stalk=parent >= 0 and forms[position + 1] == "peduncle",
    )


def _tube_shape(organ: Organ) -> tuple[NDArray[np.float64], float, float]:
    """Centreline of a tube and its radii at both ends; a node counts with its largest radius."""
    radius = float(organ.measures.get("radius_m", 0.0))
    return organ.curve, radius, float(organ.measures.get("radius_tip_m", radius))
