"""Renderers of the states of a living scene; the last ones are held."""

from __future__ import annotations

import copy
from dataclasses import asdict, dataclass, replace
from typing import TYPE_CHECKING

from pepperscene.building.scenes.frame_renderer import AssembledScene, FrameRenderer
from pepperscene.building.scenes.scene_builder import NearScene
from pepperscene.building.scenes.turning import turn_of
from pepperscene.camera import Camera
from pepperscene.live.state import SceneState
from pepperscene.materials import Surface
from pepperscene.recipe.plan import FrameSpec
from pepperscene.recipe.resolve.load_camera import surface_range
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
