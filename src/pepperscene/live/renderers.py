"""What the views of a living scene are made with: renderers of its states, a camera, a pose and a seed."""

from __future__ import annotations

import copy
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from pepperscene.building.scenes.frame_renderer import AssembledScene, FrameRenderer
from pepperscene.building.scenes.scene_builder import NearScene
from pepperscene.building.scenes.turning import turn_of
from pepperscene.camera import Camera
from pepperscene.live.state import SceneState
from pepperscene.materials import Surface
from pepperscene.recipe.plan import FrameSpec, view_seed
from pepperscene.recipe.resolve.load_camera import surface_range
from pepperscene.recipe.views.fixed_views import View
from pepperscene.render import Renderer
from pepperscene.scene import Scene

if TYPE_CHECKING:
    from pepperscene.scene import Sky


@dataclass(frozen=True, eq=False)
class StateRenderer:
    """A renderer, its scene, and what that was made of: the turn of the plant, a state, and wavelengths.

    The state of the scene that builds render is None; the wavelengths, the first and the last, are None for
    those of the recipe.
    """

    assembled: AssembledScene
    renderer: Renderer
    turn_rad: float
    state: SceneState | None = None
    wavelengths: tuple[float, float] | None = None


class StateRenderers:
    """Makes renderers of a frame's scene, edited or as a build has it.

    Args:
        frames: of the recipe.
        spec: the frame. On a turntable, lamps and what else stays in the room are where they are in this
            frame, unless another one is given.
        near: the objects of its scene.
    """

    def __init__(self, frames: FrameRenderer, spec: FrameSpec, near: NearScene) -> None:
        self._frames, self._spec, self._near = frames, spec, near
        self._held: dict[bool, StateRenderer] = {}
        self._of_frames: dict[bool, StateRenderer] = {}
        self._optics: dict[tuple[float, float] | None, tuple[dict[str, Surface], Sky | None]] = {}

    def copy(self) -> StateRenderers:
        """Another one that holds the same for now."""
        other = copy.copy(self)
        other._held, other._of_frames = dict(self._held), dict(self._of_frames)
        other._optics = dict(self._optics)
        return other

    def turn(self, spec: FrameSpec) -> float:
        """Angle in radians by which a frame's plant has turned since the own frame."""
        return self._turn(spec) - self._turn(self._spec)

    def _turn(self, spec: FrameSpec) -> float:
        return turn_of(spec, self._frames.setups.at(spec))

    def of_frames(self, spec: FrameSpec | None = None, *, traced: bool) -> StateRenderer:
        """That of the scene that a build renders, with surfaces and light if it is `traced`."""
        spec = spec or self._spec
        held, turn_rad = self._of_frames.get(True) or self._of_frames.get(traced), self._turn(spec)
        if held is None or held.turn_rad != turn_rad:
            self._of_frames = {}
            near = self._frames.grow(spec) if self.turn(spec) else self._near
            assembled = self._frames.finish(spec, near, self._surfaces(None) if traced else None)
            held = StateRenderer(assembled, Renderer(assembled.scene), turn_rad)
            self._of_frames = {traced: held}
        return held

    def of(
        self,
        state: SceneState,
        camera: Camera | None = None,
        spec: FrameSpec | None = None,
        *,
        traced: bool = False,
    ) -> StateRenderer:
        """That of a state; if light is `traced`, for a camera, by default those of the recipe."""
        spec, nm = spec or self._spec, None
        turn_rad = self._turn(spec)
        if traced and camera is not None:
            nm = surface_range([camera.sensor])
        held = self._held.get(traced)
        if held is not None and (held.state, held.wavelengths, held.turn_rad) == (state, nm, turn_rad):
            return held
        # Release what is replaced before making the new one.
        self._held.pop(traced, None)
        shown = state.turned(self._near.built.staying, -self.turn(spec))
        scene, triangles = Scene(shown.mesh, skeleton=state.skeleton), len(shown.mesh.faces)
        if traced:
            surfaces, sky = self._surfaces(nm)
            named = {**surfaces, **state.materials}
            scene = replace(scene, surfaces=tuple(named[name] for name in state.surfaces), sky=sky)
            scene = replace(scene, lamps=self._frames.lamps(spec))
        statistics = {
            "contacts": asdict(self._near.built.contacts),
            "geometry": {"triangles": triangles, "of": triangles},
        }
        renderer, assembled = Renderer(scene, shown.geometry), AssembledScene(scene, statistics)
        held = self._held[traced] = StateRenderer(assembled, renderer, turn_rad, state, nm)
        return held

    def _surfaces(self, nm: tuple[float, float] | None) -> tuple[dict[str, Surface], Sky | None]:
        """The surfaces by name and the sky, for the recipe's cameras or another range of wavelengths."""
        if nm not in self._optics:
            self._optics[nm] = self._frames.optics(self._spec, nm)
        return self._optics[nm]


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
    """The views of a frame's scene, whose renderers views need that depend on it."""

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
        if not self._frames.views.depends_on_scene:
            return self._frames.views.view(spec)
        held = self._renderers.of_frames(traced=False)
        return self._frames.views.view(spec, held.assembled.scene, held.renderer.visible_points)
