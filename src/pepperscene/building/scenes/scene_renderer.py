"""What a renderer of a scene does, for the code that makes frames with it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, Literal, Protocol

from pepperscene.frame import Frame

if TYPE_CHECKING:
    from pepperscene.camera import Camera, Partners
    from pepperscene.camera.image.auto_exposure import ChosenExposure, ExposureControl
    from pepperscene.render import Quality
    from pepperscene.scene import Scene, Sky


class SceneRenderer(Protocol):
    """Renders views of one scene."""

    def render(
        self,
        camera: Camera,
        outputs: Sequence[str] = ...,
        quality: str | Quality = ...,
        seed: int = ...,
        *,
        partners: Partners = ...,
        sky: Sky | Literal["scene"] | None = ...,
        exposure_control: ExposureControl | ChosenExposure | None = ...,
    ) -> Frame:
        """Render one view; see `Renderer.render`."""

    def meter(
        self, camera: Camera, control: ExposureControl, seed: int, sky: Sky | None, quality: str | Quality
    ) -> ChosenExposure:
        """Choose the exposure of a view."""

    def visible_points(
        self, camera: Camera, points: Any, normals: Any = ..., *, alone: int | None = ...
    ) -> Any:
        """Whether points can be seen; see `PointTest`."""


RendererFactory = Callable[["Scene"], SceneRenderer]
