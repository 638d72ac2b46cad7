"""The cameras of a recipe: along the path past the row, and the stereo partner."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from pepperscene.dataset.recipe.recipe import Recipe
from pepperscene.errors import InputError
from pepperscene.frame import STEREO_OUTPUTS

if TYPE_CHECKING:
    from pepperscene.camera import Camera
    from pepperscene.scene import Greenhouse, ViewFrustums


class Viewpoints:
    """The cameras at all steps of a recipe's path.

    Args:
        recipe: with path and baseline.
        camera: the recipe's camera, without a pose.
        greenhouse: the path leans with its row.
    """

    def __init__(self, recipe: Recipe, camera: Camera, greenhouse: Greenhouse) -> None:
        self._recipe, self._camera, self._greenhouse = recipe, camera, greenhouse
        self._baseline_m = (recipe.camera.baseline_mm or 0.0) / 1e3

    def camera(self, step: int) -> Camera:
        """The camera at a step of the path."""
        return self._camera.at_pose(self._poses[step])

    def others(self, step: int, outputs: Iterable[str]) -> dict[str, Camera]:
        """The further cameras that outputs of a step need, by purpose.

        "flow" is the camera of the next step, missing at the end of the path; "stereo" is the partner, which
        looks in the same direction from one baseline further right, at the same time and by the same flash.
        Raises `InputError` if the recipe has no partner that an output needs.
        """
        names = set(outputs)
        check_partner(self._recipe, names)
        cameras = {}
        if "flow" in names and step + 1 < len(self._poses):
            cameras["flow"] = self.camera(step + 1)
        if names & STEREO_OUTPUTS:
            cameras["stereo"] = self._partner.at_pose(self._partner_poses[step])
        return cameras

    @cached_property
    def frustums(self) -> ViewFrustums:
        """The view frustums of all cameras, partners included."""
        from pepperscene.scene import ViewFrustums, view_frustums

        path = view_frustums(self._camera, self._poses)
        if self._recipe.camera.baseline_mm is None:
            return path
        partners = view_frustums(self._partner, self._partner_poses)
        return ViewFrustums(
            np.concatenate([path.normals, partners.normals]),
            np.concatenate([path.offsets, partners.offsets]),
            np.concatenate([path.positions, partners.positions]),
        )

    @cached_property
    def _partner(self) -> Camera:
        """The second camera; the flash, of which there is one for both, stays at the first."""
        flash = self._camera.flash
        if flash is None:
            return self._camera
        right, down, forward = flash.offset_m
        return replace(self._camera, flash=replace(flash, offset_m=(right - self._baseline_m, down, forward)))

    @cached_property
    def _partner_poses(self) -> NDArray[np.float64]:
        """`(p, 4, 4)` poses of the partner."""
        poses = self._poses.copy()
        poses[:, :3, 3] += self._baseline_m * poses[:, :3, 0]
        return poses

    @cached_property
    def _poses(self) -> NDArray[np.float64]:
        """`(p, 4, 4)` poses along the path, which leans with the row."""
        from pepperscene.camera import arc_path

        path = self._recipe.path
        first, last = (float(angle) for angle in np.radians(path.azimuth_deg))
        poses = arc_path(
            self._recipe.plan.frames,
            path.distance_mm / 1e3,
            (first, last),
            (path.height_mm[0] / 1e3, path.height_mm[1] / 1e3),
            float(np.radians(path.pitch_deg)),
        )
        # Keep the distance from the row, wherever the row leans at the camera's height.
        poses[:, 1, 3] -= [self._greenhouse.lean_offset_m(float(height)) for height in poses[:, 2, 3]]
        return poses


def check_partner(recipe: Recipe, outputs: Iterable[str]) -> None:
    """Raise `InputError` if a recipe has no stereo partner, and outputs need it."""
    partnered = sorted(STEREO_OUTPUTS.intersection(outputs))
    if partnered and recipe.camera.baseline_mm is None:
        problem = f"is required for the output {partnered[0]}"
        raise InputError(recipe.name, problem, key="camera.baseline_mm")
