"""The cameras of a recipe's frames: their poses, the cameras of a rig, and the stereo partner."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from pepperscene.dataset.recipe.frame_setups import FrameSetup, FrameSetups
from pepperscene.dataset.recipe.plan import FrameSpec, Stream, random_generator
from pepperscene.dataset.recipe.recipe import Recipe
from pepperscene.dataset.recipe.views_tables import FunctionViews, RandomViews, Views
from pepperscene.dataset.views.fixed_views import View, fixed_view
from pepperscene.errors import InputError
from pepperscene.frame import DEPTH_CAMERA_OUTPUTS, STEREO_OUTPUTS

if TYPE_CHECKING:
    from pepperscene.camera import Camera, DepthCamera
    from pepperscene.dataset.views.free_space import FreeSpace
    from pepperscene.render.visibility import PointTest
    from pepperscene.scene import Greenhouse, Scene, ViewFrustums


class CameraViews:
    """The cameras of all frames of a recipe.

    Args:
        setups: of its frames.
        greenhouse: of a frame, by its setup; arcs lean with its row.
    """

    def __init__(self, setups: FrameSetups, greenhouse: Callable[[FrameSetup], Greenhouse]) -> None:
        self._setups, self._greenhouse = setups, greenhouse
        self._plan = setups.resolved.recipe.plan
        # The last views that depend on a scene: of the scene with this key, by moment and table.
        self._of_scene: tuple[object, dict[tuple[int, Views], View], FreeSpace | None] = (None, {}, None)

    @property
    def depends_on_scene(self) -> bool:
        """Whether views depend on the plants, so that no part of a scene can be left out before."""
        return isinstance(self._setups.resolved.recipe.views, RandomViews | FunctionViews)

    def camera(self, spec: FrameSpec, scene: Scene | None = None, visible: PointTest | None = None) -> Camera:
        """The camera of a frame at its pose.

        Args:
            spec: the frame.
            scene: of the frame; needed if views depend on the scene.
            visible: tests whether points of that scene are visible; needed for random views.
        """
        setup = self._setups.at(spec)
        view = self._view(spec, setup, scene, visible)
        camera = setup.camera
        if spec.camera:
            extrinsics = self._setups.resolved.recipe.rig[spec.camera - 1].extrinsics
            view, camera = _view_of_rig(view, extrinsics), _with_flash_of_rig(camera, extrinsics)
        camera = camera.at_pose(view.pose)
        return camera if view.motion is None else replace(camera, motion=view.motion)

    def others(
        self,
        spec: FrameSpec,
        outputs: Iterable[str],
        scene: Scene | None = None,
        visible: PointTest | None = None,
    ) -> dict[str, Camera]:
        """The further cameras that outputs of a frame need, by purpose.

        "flow" is the camera of the next step, missing at the last one; "stereo" is the partner, which
        looks in the same direction from one baseline further right, at the same time and by the same flash.
        Raises `InputError` if the recipe has no partner that an output needs.
        """
        names, recipe = set(outputs), self._setups.at(spec).recipe
        check_further_cameras(recipe, names)
        cameras = {}
        if "flow" in names and spec.step + 1 < self._plan.frames:
            next_spec = self._plan.frame(spec.index + self._plan.cameras)
            cameras["flow"] = self.camera(next_spec, scene, visible)
        if names & STEREO_OUTPUTS:
            assert recipe.camera.baseline_mm is not None  # checked above
            cameras["stereo"] = _stereo_partner(
                self.camera(spec, scene, visible), recipe.camera.baseline_mm / 1e3
            )
        return cameras

    def depth_camera(
        self, spec: FrameSpec, scene: Scene | None = None, visible: PointTest | None = None
    ) -> DepthCamera | None:
        """The depth camera of a frame at its pose, or None; arguments as of `camera`.

        It moves with the main camera, also in frames of other cameras of a rig.
        """
        setup = self._setups.at(spec)
        table, depth_camera = setup.recipe.depth_camera, setup.depth_camera
        if table is None or depth_camera is None:
            return None
        view = _view_of_rig(self._view(spec, setup, scene, visible), table.extrinsics)
        left = depth_camera.left.at_pose(view.pose)
        return depth_camera.with_left(left if view.motion is None else replace(left, motion=view.motion))

    def frustums(self, specs: Iterable[FrameSpec]) -> ViewFrustums:
        """The view frustums of all cameras of some frames, partners included."""
        from pepperscene.scene import ViewFrustums, view_frustums

        # Cameras that differ in their poses only are handled together.
        groups: dict[tuple[str, int, int], list[Camera]] = {}
        for spec in specs:
            setup = self._setups.at(spec)
            baseline_mm = setup.recipe.camera.baseline_mm
            cameras = [self.camera(spec)]
            if baseline_mm is not None:
                cameras.append(_stereo_partner(cameras[0], baseline_mm / 1e3))
            cameras = [self._longest_exposure(spec, camera) for camera in cameras]
            depth_camera = self.depth_camera(spec)
            if depth_camera is not None:
                cameras += depth_camera.longest_exposed()
            for number, camera in enumerate(cameras):
                key = (setup.optics, number, spec.camera)
                groups.setdefault(key, []).extend(_along_motion(camera))
        parts = [
            view_frustums(cameras[0], [camera.pose for camera in cameras]) for cameras in groups.values()
        ]
        if len(parts) == 1:
            return parts[0]
        return ViewFrustums(
            np.concatenate([part.normals for part in parts]),
            np.concatenate([part.offsets for part in parts]),
            np.concatenate([part.positions for part in parts]),
        )

    def _longest_exposure(self, spec: FrameSpec, camera: Camera) -> Camera:
        """The camera with the longest exposure that it can have in a frame."""
        control = self._setups.at(spec).recipe.exposure_control
        return camera if control is None else replace(camera, exposure_s=control.exposure_us[1] / 1e6)

    def _view(
        self, spec: FrameSpec, setup: FrameSetup, scene: Scene | None, visible: PointTest | None
    ) -> View:
        table, frames, where = setup.recipe.views, self._plan.frames, setup.recipe.name
        if not isinstance(table, RandomViews | FunctionViews):
            return fixed_view(table, spec.step, frames, self._greenhouse(setup), where)
        if scene is None:
            raise ValueError(f"views of the kind {table.kind} need a scene")
        key = (spec.scene, setup.plants)
        if self._of_scene[0] != key:
            self._of_scene = (key, {}, None)
        views = self._of_scene[1]
        # Twins can differ in their views.
        if (spec.moment, table) not in views:
            if isinstance(table, FunctionViews):
                from pepperscene.dataset.views.user_function import function_poses

                self._setups.resolved.check_code()
                rng = random_generator(setup.recipe.seed, Stream.VIEW, spec.scene, 0)
                poses = function_poses(table, scene, rng, frames)
                first = spec.moment - spec.step
                views |= {(first + step, table): View(pose) for step, pose in enumerate(poses)}
            else:
                views[spec.moment, table] = self._random_view(spec, setup, table, scene, visible)
        return views[spec.moment, table]

    def _random_view(
        self, spec: FrameSpec, setup: FrameSetup, table: RandomViews, scene: Scene, visible: PointTest | None
    ) -> View:
        from pepperscene.dataset.views.free_space import FreeSpace
        from pepperscene.dataset.views.random_views import random_view, random_view_settings

        if visible is None:
            raise ValueError("random views need a test of visibility")
        key, views, space = self._of_scene
        if space is None:
            space = FreeSpace(scene.mesh)
            self._of_scene = (key, views, space)
        # Twins and the cameras of a rig share the view of the first.
        camera = self._setups.at(self._plan.first_of_moment(spec)).camera
        rng = random_generator(setup.recipe.seed, Stream.VIEW, spec.moment)
        where = f"{self._setups.resolved.recipe.name}, frame {spec.index}"
        settings = random_view_settings(table)
        return View(random_view(settings, scene, camera, rng, visible, space, where).pose)


def check_further_cameras(recipe: Recipe, outputs: Iterable[str]) -> None:
    """Raise `InputError` if a recipe has no stereo partner or depth camera, and outputs need it."""
    needed = (
        ("camera.baseline_mm", recipe.camera.baseline_mm, STEREO_OUTPUTS),
        ("depth_camera", recipe.depth_camera, DEPTH_CAMERA_OUTPUTS),
    )
    for key, value, names in needed:
        if value is None and (missing := names.intersection(outputs)):
            raise InputError(recipe.name, f"is required for the output {min(missing)}", key=key)


def _along_motion(camera: Camera) -> list[Camera]:
    """The camera at its pose, and if it moves, at the beginning and the end of the exposure too."""
    if camera.motion is None:
        return [camera]
    half_s = (camera.exposure_s + camera.height * camera.sensor.line_time_s) / 2
    poses = [camera.motion.pose_at(camera.pose, t) for t in (-half_s, 0.0, half_s)]
    return [camera.at_pose(pose) for pose in poses]


def _stereo_partner(camera: Camera, baseline_m: float) -> Camera:
    """The second camera; both use one flash, which stays at the first."""
    pose = camera.pose.copy()
    pose[:3, 3] += baseline_m * pose[:3, 0]
    partner = camera.at_pose(pose)
    if camera.motion is not None:
        partner = replace(partner, motion=camera.motion.at_offset(pose[:3, 3] - camera.pose[:3, 3]))
    if camera.flash is None:
        return partner
    right, down, forward = camera.flash.offset_m
    return replace(partner, flash=replace(camera.flash, offset_m=(right - baseline_m, down, forward)))


def _view_of_rig(view: View, extrinsics: NDArray[np.float64]) -> View:
    """The view of a camera on a rig; it moves and turns with the main camera."""
    pose = view.pose @ extrinsics
    if view.motion is None:
        return View(pose)
    return View(pose, view.motion.at_offset(pose[:3, 3] - view.pose[:3, 3]))


def _with_flash_of_rig(camera: Camera, extrinsics: NDArray[np.float64]) -> Camera:
    """A camera on a rig; all cameras use one flash, which stays at the main camera."""
    if camera.flash is None:
        return camera
    turn = extrinsics[:3, :3].T
    right, down, forward = (float(x) for x in turn @ (np.asarray(camera.flash.offset_m) - extrinsics[:3, 3]))
    flash = replace(camera.flash, offset_m=(right, down, forward))
    is_turned = not np.allclose(turn, np.eye(3), atol=1e-12)
    return replace(camera, flash=replace(flash, rotation=turn) if is_turned else flash)
