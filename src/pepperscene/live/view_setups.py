"""What the views of a living scene are made with: a frame's camera and light, a pose and a seed."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from pepperscene.building.scenes.frame_renderer import FrameRenderer
from pepperscene.camera import Camera
from pepperscene.live.renderers import StateRenderers
from pepperscene.recipe.plan import FrameSpec, view_seed
from pepperscene.recipe.views.fixed_views import View


@dataclass(frozen=True, eq=False)
class ViewSetup:
    """What one view is made with.

    Attributes:
        spec: the frame whose camera and light it has.
        view: of the main camera; None for the frame's own.
        camera: in place of the frame's, at its pose; None for the frame's.
        seed: of light and noise; None for the frame's.
    """

    spec: FrameSpec
    view: View | None = None
    camera: Camera | None = None
    seed: int | None = None

    @property
    def is_frame(self) -> bool:
        """Whether it is a frame of the data set."""
        return self.view is None and self.camera is None


class ViewSetups:
    """The views of a frame's scene.

    Args:
        frames: of the recipe.
        spec: the frame.
        renderers: of its scene, for views that depend on it.
    """

    def __init__(self, frames: FrameRenderer, spec: FrameSpec, renderers: StateRenderers) -> None:
        self._frames, self._spec, self._renderers = frames, spec, renderers

    def at(
        self, pose: NDArray[np.float64] | None, camera: Camera | None, number: int, *, edited: bool
    ) -> ViewSetup:
        """How the view with a number is made.

        Args:
            pose: `(4, 4)` of its camera; None for that of the frame.
            camera: in place of the frame's.
            number: decides its seed, unless it is at a pose of the data set.
            edited: whether the scene was.
        """
        seed = view_seed(self._frames.recipe.seed, self._spec.index, number)
        if camera is not None:
            own = self.camera(ViewSetup(self._spec)).pose if pose is None else pose
            return ViewSetup(self._spec, None, camera.at_pose(own), None if pose is None else seed)
        key = None if pose is None else np.ascontiguousarray(pose, float).tobytes()
        spec = self._spec if key is None else self._frames_by_pose.get(key)
        if spec is not None:
            # Views that depend on plants are those of the scene before edits.
            depends = edited and self._frames.views.depends_on_scene
            return ViewSetup(spec, self._own_view(spec) if depends else None)
        main = np.asarray(pose)
        if self._spec.camera:
            # The pose is that of this camera of the rig, which moves with the first.
            rig = self._frames.recipe.rig
            main = main @ np.linalg.inv(rig[self._spec.camera - 1].extrinsics)
        return ViewSetup(self._spec, View(main), None, seed)

    def camera(self, setup: ViewSetup) -> Camera:
        """The camera of a view."""
        view = setup.view or self._own_view(setup.spec)
        return setup.camera or self._frames.views.camera(setup.spec, view)

    @cached_property
    def _frames_by_pose(self) -> dict[bytes, FrameSpec]:
        """The frames of this scene, of the same twin and camera of a rig, by the bytes of their poses."""
        own, views = self._spec, self._frames.views
        specs = [] if views.depends_on_scene else self._frames.frames_of_scene(own)
        alike = [one for one in specs if (one.twin, one.camera) == (own.twin, own.camera)]
        # Of equal poses, the own one counts.
        return {self.camera(ViewSetup(spec)).pose.tobytes(): spec for spec in (*alike, own)}

    def _own_view(self, spec: FrameSpec) -> View:
        """The view of a frame."""
        if not self._frames.views.depends_on_scene:
            return self._frames.views.view(spec)
        held = self._renderers.of_frames(traced=False)
        return self._frames.views.view(spec, held.assembled.scene, held.renderer.visible_points)
