"""The cameras of a recipe's frames: their poses, the cameras of a rig, and the stereo partner."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from pepperscene.camera.lamps.lamp import lamps_seen_from
from pepperscene.errors import InputError
from pepperscene.outputs import DEPTH_CAMERA_OUTPUTS, STEREO_OUTPUTS
from pepperscene.recipe.plan import FrameSpec, Stream, random_generator
from pepperscene.recipe.recipe import Recipe
from pepperscene.recipe.resolve.frame_setups import FrameSetup, FrameSetups
from pepperscene.recipe.resolve.load_camera import white_reference
from pepperscene.recipe.views.fixed_views import View, fixed_view
from pepperscene.recipe.views_tables import FunctionViews, RandomViews, Views
from pepperscene.scene import Greenhouse

if TYPE_CHECKING:
    from pepperscene.camera import Camera, DepthCamera, Partners
    from pepperscene.recipe.views.free_space import FreeSpace
    from pepperscene.recipe.views.near_plants import CoarsePlants, NearViews
    from pepperscene.recipe.views.random_views import RandomView
    from pepperscene.render.visibility import PointTest
    from pepperscene.scene import Scene, ViewFrustums


DrawnViews = Mapping[tuple[int, Views], "View | RandomView"]
"""Views that depend on a scene, by moment and table."""


@dataclass(eq=False)
class _SceneViews:
    """The views of a scene that depend on it."""

    drawn: dict[tuple[int, Views], View | RandomView] = field(default_factory=dict)  # so far
    earlier: DrawnViews = field(default_factory=dict)  # before its near plants were grown in full
    coarse: CoarsePlants | None = None  # plants that no view may show from near
    space: FreeSpace | None = None  # None until it is needed


class CameraViews:
    """The cameras of all frames of a recipe.

    Args:
        setups: of its frames.
    """

    def __init__(self, setups: FrameSetups) -> None:
        self._setups = setups
        self._plan = setups.resolved.recipe.plan
        self._of_scene: WeakKeyDictionary[Scene, _SceneViews] = WeakKeyDictionary()

    @property
    def depends_on_scene(self) -> bool:
        """Whether views depend on the plants, so that no part of a scene can be left out before."""
        return isinstance(self._setups.resolved.recipe.views, RandomViews | FunctionViews)

    @property
    def are_random(self) -> bool:
        """Whether views are random."""
        return isinstance(self._setups.resolved.recipe.views, RandomViews)

    def view(self, spec: FrameSpec, scene: Scene | None = None, visible: PointTest | None = None) -> View:
        """The view of a frame's main camera.

        Args:
            spec: the frame.
            scene: of the frame; needed if views depend on the scene.
            visible: tests whether points of that scene are visible; needed for random views.
        """
        setup = self._setups.at(spec)
        table, frames, where = setup.recipe.views, self._plan.frames, setup.recipe.name
        if not isinstance(table, RandomViews | FunctionViews):
            view = fixed_view(table, spec.step, frames, setup.recipe.greenhouse or Greenhouse(), where)
            stand = setup.recipe.stand
            return view if stand is None else view.turned(-stand.turned(spec.step))
        if scene is None:
            raise ValueError(f"views of the kind {table.kind} need a scene")
        of_scene, key = self._of_scene.setdefault(scene, _SceneViews()), (spec.moment, table)
        # Twins can differ in their views.
        if key not in of_scene.drawn:
            if isinstance(table, RandomViews):
                of_scene.drawn[key] = self._random_view(spec, setup, table, scene, visible, of_scene)
            elif key in of_scene.earlier:
                of_scene.drawn[key] = of_scene.earlier[key]
            else:
                from pepperscene.recipe.views.user_function import function_poses

                self._setups.resolved.check_code()
                rng = random_generator(setup.recipe.seed, Stream.VIEW, spec.scene, 0)
                poses = function_poses(table, scene, rng, frames)
                first = spec.moment - spec.step
                of_scene.drawn |= {(first + step, table): View(pose) for step, pose in enumerate(poses)}
        drawn = of_scene.drawn[key]
        return drawn if isinstance(drawn, View) else View(drawn.pose)

    def camera(self, spec: FrameSpec, view: View | None = None) -> Camera:
        """The camera of a frame, at its pose with a view of the main camera; None for the frame's own."""
        camera, view = self._setups.at(spec).camera, view or self.view(spec)
        if spec.camera:
            extrinsics = self._setups.resolved.recipe.rig[spec.camera - 1].extrinsics
            view, camera = _view_of_rig(view, extrinsics), _with_flash_of_rig(camera, extrinsics)
        camera = camera.at_pose(view.pose)
        return camera if view.motion is None else replace(camera, motion=view.motion)

    def target(self, spec: FrameSpec, scene: Scene) -> int | None:
        """Index among the scene's instances of what a random view looks at; None for a point or other views.

        The view must have been drawn: by `view` with the same scene.
        """
        key = spec.moment, self._setups.at(spec).recipe.views
        view = self._of_scene[scene].drawn.get(key) if scene in self._of_scene else None
        return None if view is None or isinstance(view, View) else view.target_instance

    def partners(self, spec: FrameSpec, outputs: Iterable[str], view: View | None = None) -> Partners:
        """The further devices that outputs of a frame need, but the camera of the next step; view: `camera`.

        The stereo partner looks in the same direction from one baseline further right, at the same time and
        by the same flash. Raises `InputError` if the recipe has no partner that an output needs.
        """
        from pepperscene.camera import Partners

        names, recipe = set(outputs), self._setups.at(spec).recipe
        check_further_cameras(recipe, names)
        partners = Partners()
        if names & STEREO_OUTPUTS and recipe.camera.baseline_m is not None:
            stereo = _stereo_partner(self.camera(spec, view), recipe.camera.baseline_m)
            partners = replace(partners, stereo=stereo)
        if names & DEPTH_CAMERA_OUTPUTS:
            partners = replace(partners, depth=self.depth_camera(spec, view))
        if "reflectance" in names:
            partners = replace(partners, white_reference=white_reference(recipe))
        return partners

    def depth_camera(self, spec: FrameSpec, view: View | None = None) -> DepthCamera | None:
        """The depth camera of a frame at its pose, or None; arguments as in `camera`.

        It moves with the main camera, also in frames of other cameras of a rig.
        """
        setup = self._setups.at(spec)
        table, depth_camera = setup.recipe.depth_camera, setup.depth_camera
        if table is None or depth_camera is None:
            return None
        view = _view_of_rig(view or self.view(spec), table.extrinsics)
        left = depth_camera.left.at_pose(view.pose)
        return depth_camera.with_left(left if view.motion is None else replace(left, motion=view.motion))

    def frustums(self, specs: Iterable[FrameSpec]) -> ViewFrustums:
        """The view frustums of all cameras of some frames, partners included."""
        from pepperscene.scene import ViewFrustums, view_frustums

        # Cameras that differ in their poses only are handled together.
        groups: dict[tuple[str, int, int], list[Camera]] = {}
        for spec in specs:
            optics = self._setups.at(spec).optics
            for number, camera in enumerate(self._all_cameras(spec, self.view(spec))):
                groups.setdefault((optics, number, spec.camera), []).extend(_along_motion(camera))
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

    def near_views(self, views: Iterable[tuple[FrameSpec, View]]) -> NearViews:
        """What all cameras of some frames with these views show from near, partners included."""
        from pepperscene.recipe.views.near_plants import near_views

        return near_views(camera for spec, view in views for camera in self._all_cameras(spec, view))

    def drawn(self, scene: Scene) -> DrawnViews:
        """The views of a scene that depend on it and are drawn so far."""
        return dict(self._of_scene[scene].drawn) if scene in self._of_scene else {}

    def continue_in(self, scene: Scene, earlier: DrawnViews, coarse: CoarsePlants) -> None:
        """Keep views in a scene whose near plants are grown in full.

        Args:
            scene: in which views of functions are the same as before, and random ones where they are still
                within their limits.
            earlier: views of the scene before.
            coarse: its other plants of far rows, which random views do not show from near.
        """
        self._of_scene[scene] = _SceneViews(earlier=earlier, coarse=coarse)

    def _all_cameras(self, spec: FrameSpec, view: View) -> list[Camera]:
        """All cameras of a frame with a view: its own, the partner, the imagers of the depth camera.

        They have the longest exposure that they can have.
        """
        recipe, cameras = self._setups.at(spec).recipe, [self.camera(spec, view)]
        if recipe.camera.baseline_m is not None:
            cameras.append(_stereo_partner(cameras[0], recipe.camera.baseline_m))
        if (control := recipe.exposure_control) is not None:
            cameras = [replace(camera, exposure_s=control.exposure_s[1]) for camera in cameras]
        if recipe.depth_camera is not None and (depth_camera := self.depth_camera(spec, view)) is not None:
            cameras += depth_camera.longest_exposed()
        return cameras

    def _random_view(
        self,
        spec: FrameSpec,
        setup: FrameSetup,
        table: RandomViews,
        scene: Scene,
        visible: PointTest | None,
        of_scene: _SceneViews,
    ) -> RandomView:
        from pepperscene.recipe.views.free_space import FreeSpace
        from pepperscene.recipe.views.random_views import RandomView, ViewSearch

        if visible is None:
            raise ValueError("random views need a test of visibility")
        if of_scene.space is None:
            of_scene.space = FreeSpace(scene.mesh)
        # Twins and the cameras of a rig share the view of the first.
        camera = self._setups.at(self._plan.first_of_moment(spec)).camera
        rng = random_generator(setup.recipe.seed, Stream.VIEW, spec.moment)
        where = f"{self._setups.resolved.recipe.name}, frame {spec.index}"
        earlier, coarse = of_scene.earlier.get((spec.moment, table)), of_scene.coarse
        return ViewSearch(table, scene, camera, of_scene.space, where).find(
            rng,
            visible,
            rejected=None if coarse is None else lambda pose: self._shows_coarse(spec, setup, pose, coarse),
            earlier=earlier if isinstance(earlier, RandomView) else None,
        )

    def _shows_coarse(
        self, spec: FrameSpec, setup: FrameSetup, pose: NDArray[np.float64], coarse: CoarsePlants
    ) -> bool:
        """Whether any camera of a moment shows a coarse plant from near, with the main camera at a pose."""
        from pepperscene.recipe.views.near_plants import near_views

        first = self._plan.first_of_moment(spec)
        step = self._plan.frames * self._plan.cameras
        indices = [
            first.index + twin * step + camera
            for twin in range(self._plan.twins)
            for camera in range(self._plan.cameras)
        ]
        cameras = [
            camera
            for one in map(self._plan.frame, indices)
            if self._setups.at(one).recipe.views == setup.recipe.views
            for camera in self._all_cameras(one, View(pose))
        ]
        return bool(coarse.shown_near(near_views(cameras)))


def check_further_cameras(recipe: Recipe, outputs: Iterable[str]) -> None:
    """Raise `InputError` if a recipe has no stereo partner or depth camera, and outputs need it."""
    needed = (
        ("camera.baseline_mm", recipe.camera.baseline_m, STEREO_OUTPUTS),
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
    if camera.lamps:
        shift = np.linalg.inv(camera.pose) @ pose
        partner = replace(partner, lamps=lamps_seen_from(camera.lamps, shift))
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
    camera = replace(camera, lamps=lamps_seen_from(camera.lamps, extrinsics)) if camera.lamps else camera
    if camera.flash is None:
        return camera
    turn = extrinsics[:3, :3].T
    right, down, forward = (float(x) for x in turn @ (np.asarray(camera.flash.offset_m) - extrinsics[:3, 3]))
    flash = replace(camera.flash, offset_m=(right, down, forward))
    is_turned = not np.allclose(turn, np.eye(3), atol=1e-12)
    return replace(camera, flash=replace(flash, rotation=turn) if is_turned else flash)
