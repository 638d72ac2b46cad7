"""Where a recipe's pictures are taken from: the camera's path past the row, and the partner beside it."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from pepperscene.dataset.recipe.equipment import load_camera
from pepperscene.dataset.recipe.recipe import Recipe
from pepperscene.errors import InputError
from pepperscene.frame import PARTNERED

if TYPE_CHECKING:
    from pepperscene.camera import Camera
    from pepperscene.scene import Greenhouse, ViewFrustums


class Viewpoints:
    """The cameras of all steps along a recipe's path.

    Args:
        recipe: with path and camera.
        house: the greenhouse, whose row the path leans with.

    Raises:
        InputError: a part of the camera is not found or not valid.
    """

    def __init__(self, recipe: Recipe, house: Greenhouse) -> None:
        self._recipe, self._house = recipe, house
        self.equipment = load_camera(recipe)
        """The camera, at no place yet."""

    def camera(self, step: int) -> Camera:
        """The camera at its place on the path."""
        return self.equipment.at_pose(self._poses[step])

    def others(self, step: int, outputs: Iterable[str]) -> dict[str, Camera]:
        """The cameras that outputs of a step need besides its own, by what for.

        "flow" is the camera of the next step, not there at the path's end; "stereo" the partner, which looks
        the same way from the baseline's length to the right, at the same time and so by the same flash.

        Raises:
            InputError: an output needs a stereo partner, and the recipe has none.
        """
        wanted = set(outputs)
        check_partner(self._recipe, wanted)
        found = {}
        if "flow" in wanted and step + 1 < len(self._poses):
            found["flow"] = self.camera(step + 1)
        if wanted & PARTNERED:
            found["stereo"] = self._partner.at_pose(self._beside[step])
        return found

    @cached_property
    def sight(self) -> ViewFrustums:
        """Where all of them look, partners included."""
        from pepperscene.scene import ViewFrustums, view_frustums

        own = view_frustums(self.equipment, self._poses)
        if self._recipe.camera.baseline_mm is None:
            return own
        beside = view_frustums(self._partner, self._beside)
        return ViewFrustums(
            np.concatenate([own.normals, beside.normals]),
            np.concatenate([own.offsets, beside.offsets]),
            np.concatenate([own.places, beside.places]),
        )

    @cached_property
    def _partner(self) -> Camera:
        """The camera that stands beside; the one flash of the two stays where it is."""
        flash = self.equipment.flash
        if flash is None:
            return self.equipment
        right, down, forward = flash.offset_m
        return replace(
            self.equipment, flash=replace(flash, offset_m=(right - self._baseline_m, down, forward))
        )

    @cached_property
    def _beside(self) -> NDArray[np.float64]:
        """`(p, 4, 4)` the partner's poses."""
        poses = self._poses.copy()
        poses[:, :3, 3] += self._baseline_m * poses[:, :3, 0]
        return poses

    @property
    def _baseline_m(self) -> float:
        return (self._recipe.camera.baseline_mm or 0.0) / 1e3

    @cached_property
    def _poses(self) -> NDArray[np.float64]:
        """`(p, 4, 4)` the path, which leans with the row."""
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
        # The arc keeps its distance from the row, wherever the row has leant to at that height.
        poses[:, 1, 3] -= [self._house.away(float(height)) for height in poses[:, 2, 3]]
        return poses


def check_partner(recipe: Recipe, outputs: Iterable[str]) -> None:
    """Whether a recipe has the stereo partner that outputs need.

    Raises:
        InputError: it has none.
    """
    needing = sorted(PARTNERED.intersection(outputs))
    if needing and recipe.camera.baseline_mm is None:
        wanted = f"must be told in millimetres for the output {needing[0]}"
        raise InputError(recipe.name, wanted, key="camera.baseline_mm")
