"""The bench's own scenes, told here once for all: figures of different days can be compared."""

from __future__ import annotations

import dataclasses
import hashlib
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Final, Protocol

import numpy as np
from numpy.typing import NDArray

from pepperscene.camera import Camera
from pepperscene.dataset import FrameRenderer
from pepperscene.errors import ArgumentError
from pepperscene.frame import Frame
from pepperscene.render import Quality
from pepperscene.scene import Scene
from pepperscene.version import __version__

if TYPE_CHECKING:
    from pepperscene.dataset import Recipe


_ONE_SCENE: Final = {"plan.sets": 1, "plan.rotations": 1, "plan.frames": 250, "plan.select": [0]}
_LARGEST: Final = 8192
"""Chosen: pixels along a side; a picture twice as large hardly fits into memory."""

_SIZE: Final = re.compile(r"([1-9]\d{0,4})x([1-9]\d{0,4})", re.ASCII)


@dataclass(frozen=True)
class BenchScene:
    """What is rendered, and from where.

    Attributes:
        name: on the command line and in file names.
        recipe: of the shipped ones.
        index: of the frame whose error is measured; those beside it on the camera's path are timed as well.
        meaning: one line for tables and pages.
        changes: of single values, as `--set` takes them.
    """

    name: str
    recipe: str
    index: int
    meaning: str
    changes: Mapping[str, Any] = field(default_factory=dict)

    def load(self) -> Recipe:
        """The recipe with the changes."""
        from pepperscene.dataset import load_recipe

        return load_recipe(self.recipe, dict(self.changes))


SCENES: Final[Mapping[str, BenchScene]] = {
    scene.name: scene
    for scene in (
        BenchScene(
            "near",
            "barth2018",
            155,
            "three plants, a fruit and a stem before the lens, the rest out of focus",
            {
                **_ONE_SCENE,
                "row.plants_front": 3,
                "row.plants_back": 0,
                "path.distance_mm": 210.0,  # chosen: half of the paper's; a fruit fills a tenth of it
                "path.pitch_deg": 0.0,  # chosen: fruit hang in the middle
                "camera.focus_mm": 140.0,  # chosen: on the nearest fruit
                "camera.exposure_us": 14.0,  # chosen: 50 us times (210 mm / 400 mm)^2, as the flash is nearer
            },
        ),
        BenchScene("standard", "barth2018", 125, "the thirteen plants of Barth et al. 2018 under the flash"),
        BenchScene(
            "dense", "greenhouse", 125, "seventeen plants and the rows beyond them, by daylight", _ONE_SCENE
        ),
    )
}


def scenes_named(names: str) -> tuple[BenchScene, ...]:
    """The scenes of a list with commas, in the order of `SCENES`.

    Raises:
        InputError: a name is unknown, or there is none.
    """
    wanted = [name.strip() for name in names.split(",") if name.strip()]
    unknown = [name for name in wanted if name not in SCENES]
    if unknown or not wanted:
        told = f"unknown scene {unknown[0]!r}" if unknown else "no scene is named"
        raise ArgumentError("scene", f"{told}; allowed are {', '.join(SCENES)}")
    return tuple(scene for name, scene in SCENES.items() if name in wanted)


def size_of(text: str) -> tuple[int, int]:
    """Width and height out of "WxH".

    Raises:
        InputError: not of that form, or too large.
    """
    found = _SIZE.fullmatch(text.strip())
    size = (int(found[1]), int(found[2])) if found else (0, 0)
    if not 1 <= min(size) <= max(size) <= _LARGEST:
        raise ArgumentError("size", f"{text!r} must be WIDTHxHEIGHT, each 1 to {_LARGEST} pixels")
    return size


def resized(camera: Camera, size: Sequence[int] | None) -> Camera:
    """The camera with another number of pixels across the same width of the scene, exposed alike.

    Pixels become larger or smaller. So that a photosite still gathers the same share of its well, a lens with
    larger pixels lets less light through, and a sensor with smaller ones amplifies more: both leave the
    depth of field, the mixture of lights and the picture's brightness as they are.

    Args:
        camera: as the recipe says.
        size: width and height, or None for the camera's own.
    """
    if size is None or tuple(size) == (camera.width, camera.height):
        return camera
    columns, rows = (int(one) for one in size)
    wider = camera.width / columns
    sensor = dataclasses.replace(
        camera.sensor,
        columns=columns,
        rows=rows,
        pitch_m=camera.sensor.pitch_m * wider,
        gain=camera.sensor.gain * max(1.0, wider**-2),
    )
    lens = dataclasses.replace(camera.lens, transmittance=camera.lens.transmittance / max(1.0, wider**2))
    return dataclasses.replace(camera, sensor=sensor, lens=lens)


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
class BenchSubject:
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


def bench_subject(
    bench_scene: BenchScene,
    size: tuple[int, int] | None,
    frames: int,
    factory: RendererFactory | None = None,
) -> BenchSubject:
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
    stage, plan, make = FrameRenderer(recipe), recipe.plan, factory or _renderer
    shot = plan.frame(bench_scene.index)
    whole, scene = FrameRenderer(recipe, culled=False).scene(shot), stage.scene(shot)
    # Neighbours on the path, as a build goes through them; they stay in the same scene.
    first = bench_scene.index - bench_scene.index % plan.frames
    steps = [(shot.step + 1 + number) % plan.frames for number in range(frames)]
    cameras = [resized(stage.camera(plan.frame(first + step)), size) for step in steps]
    return BenchSubject(
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
