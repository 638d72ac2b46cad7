"""The triangles of a living scene as other functions take them: measures of visibility and reach."""

from __future__ import annotations

from pepperscene.live.scene import LiveScene
from pepperscene.scene import Scene


def whole_scene(live: LiveScene) -> Scene:
    """The geometry and the skeleton of a living scene as it is now, without surfaces and light."""
    return live._renderers.of(live._state).assembled.scene
