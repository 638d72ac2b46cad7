"""A scene in the renderers' hands, and the cameras that are timed before it."""

from __future__ import annotations

import dataclasses
import hashlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Final, Protocol

import numpy as np
from numpy.typing import NDArray

from pepperscene.bench.scenes import BenchScene, resized
from pepperscene.camera import Camera
from pepperscene.dataset import Stage
from pepperscene.frame import Frame
from pepperscene.render import Quality
from pepperscene.scene import Scene
from pepperscene.version import __version__

TRACED: Final = ("electrons",)
"""What is timed: light, as far as the sensor's wells. Developing and labels are the same for all settings."""


class BenchRenderer(Protocol):
    """What renders the views of one scene."""

    def render(
        self,
        camera: Camera,
        outputs: Sequence[str] = ...,
        quality: str | Quality = ...,
        seed: int = ...,
    ) -> Frame:
        """One view."""


RendererFactory = Callable[[Scene], BenchRenderer]


@dataclass(frozen=True, eq=False)
class Subject:
    """What is measured.

    Attributes:
        name: of the bench's scene.
        whole: all that stands there.
        scene: without what the frames cannot tell, as they are built.
        camera: of the frame whose error is measured.
        path: cameras beside it on the path, in the order of frames.
        whole_renderer: holds the whole scene.
        renderer: holds what frames are built from.
    """

    name: str
    whole: Scene
    scene: Scene
    camera: Camera
    path: tuple[Camera, ...]
    whole_renderer: BenchRenderer
    renderer: BenchRenderer

    def truth(self, quality: str | Quality, seed: int) -> NDArray[Any]:
        """`(h, w, c)` expected electrons of the whole scene, of the frame whose error is measured."""
        return self.frame(quality, seed, whole=True)["electrons"]

    def frame(
        self, quality: str | Quality, seed: int, camera: Camera | None = None, *, whole: bool = False
    ) -> Frame:
        """A view, light alone; by default that whose error is measured."""
        renderer = self.whole_renderer if whole else self.renderer
        return renderer.render(camera or self.camera, TRACED, quality, seed)

    def digest(self) -> str:
        """SHA-256 over all that decides the true picture: version, whole scene and camera."""
        found = hashlib.sha256(__version__.encode())
        _feed(found, self.whole)
        _feed(found, self.camera)
        return found.hexdigest()


def subject(
    bench_scene: BenchScene,
    size: tuple[int, int] | None,
    frames: int,
    factory: RendererFactory | None = None,
) -> Subject:
    """A bench scene made ready.

    Args:
        bench_scene: which.
        size: of the picture, or None for the camera's own.
        frames: how many cameras of the path are to be timed.
        factory: makes the renderer; None for the render room's.

    Raises:
        SetupError: the machine cannot render.
    """
    recipe = bench_scene.load()
    stage, plan, make = Stage(recipe), recipe.plan, factory or _renderer
    shot = plan.shot(bench_scene.index)
    whole, scene = Stage(recipe, culled=False).scene(shot), stage.scene(shot)
    # Neighbours on the path, as a build goes through them; they stay in the same scene.
    first = bench_scene.index - bench_scene.index % plan.frames
    steps = [(shot.step + 1 + number) % plan.frames for number in range(frames)]
    cameras = [resized(stage.camera(plan.shot(first + step)), size) for step in steps]
    return Subject(
        bench_scene.name,
        whole,
        scene,
        resized(stage.camera(shot), size),
        tuple(cameras),
        make(whole),
        make(scene),
    )


def _renderer(scene: Scene) -> BenchRenderer:
    from pepperscene.render import Renderer

    return Renderer(scene)


def _feed(found: Any, thing: Any) -> None:
    """Feed a digest with frozen data, all the way down: data classes, tuples, tables, arrays and scalars."""
    found.update(type(thing).__name__.encode())
    if isinstance(thing, np.ndarray):
        found.update(f"{thing.dtype}{thing.shape}".encode())
        found.update(np.ascontiguousarray(thing).data)
    elif dataclasses.is_dataclass(thing) and not isinstance(thing, type):
        for one in dataclasses.fields(thing):
            found.update(one.name.encode())
            _feed(found, getattr(thing, one.name))
    elif isinstance(thing, dict):
        for key, value in thing.items():
            _feed(found, key)
            _feed(found, value)
    elif isinstance(thing, tuple | list):
        for value in thing:
            _feed(found, value)
    elif thing is None or isinstance(thing, str | int | float | bool | np.generic):
        found.update(repr(thing).encode())
    else:
        raise ValueError(f"{type(thing).__name__} is not plain data")
