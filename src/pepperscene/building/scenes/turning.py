"""Scenes of a plant on a turntable: what stays with the camera goes round the plant, in the plant's axes."""

from __future__ import annotations

import math
from collections.abc import Hashable
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from pepperscene.building.scenes.scene_builder import BuiltScene, SceneBuilder
from pepperscene.recipe.plan import FrameSpec
from pepperscene.recipe.resolve.frame_setups import FrameSetup

if TYPE_CHECKING:
    from pepperscene.camera import Lamp
    from pepperscene.scene import Sky


def turn_of(spec: FrameSpec, setup: FrameSetup) -> float:
    """Angle in radians by which a frame's plant has turned, counter-clockwise; 0 without a turntable."""
    return 0.0 if setup.recipe.stand is None else setup.recipe.stand.turned(spec.step)


def turn_metadata(spec: FrameSpec, setup: FrameSetup) -> dict[str, Any]:
    """JSON-ready `turntable` of a frame with a turntable; empty without one."""
    stand = setup.recipe.stand
    if stand is None or not stand.turn_rad:
        return {}
    return {"turntable": {"turn_deg": round(math.degrees(stand.turned(spec.step)) % 360.0, 9)}}


def sky_at(sky: Sky | None, turn_rad: float) -> Sky | None:
    """A sky in the axes of a plant that has turned."""
    if sky is None or not turn_rad:
        return sky
    from pepperscene.scene import turned_sky

    return turned_sky(sky, -turn_rad)


def lamps_at(lamps: tuple[Lamp, ...], turn_rad: float) -> tuple[Lamp, ...]:
    """Lamps of the room in the axes of a plant that has turned."""
    if not lamps or not turn_rad:
        return lamps
    from pepperscene.scene import rotation_about_z

    return tuple(lamp.moved(rotation_about_z(-turn_rad), [0.0, 0.0, 0.0]) for lamp in lamps)


class TurntableScenes:
    """The scenes of a builder at each turn; one with a turntable is held, so that all views share it."""

    def __init__(self) -> None:
        self._held: tuple[Hashable, BuiltScene] | None = None

    def scene(self, spec: FrameSpec, setup: FrameSetup, builder: SceneBuilder) -> BuiltScene:
        """The scene of a frame."""
        stand, key = setup.recipe.stand, (setup.plants, spec.set, spec.rotation)
        if stand is None or not stand.turn_rad:
            return builder.scene(spec.set, spec.rotation)
        if self._held is None or self._held[0] != key:
            self._held = None
            self._held = key, builder.scene(spec.set, spec.rotation)
        from pepperscene.scene import turned_parts

        built = self._held[1]
        return replace(built, mesh=turned_parts(built.mesh, built.staying, -stand.turned(spec.step)))
