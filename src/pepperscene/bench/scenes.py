"""The benchmark scenes, fixed here so that figures of different days can be compared."""

from __future__ import annotations

import dataclasses
import hashlib
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
from pydantic import BaseModel

from pepperscene.building.scenes.frame_renderer import FrameRenderer
from pepperscene.camera import Camera, pedestal
from pepperscene.errors import ArgumentError
from pepperscene.frame import Frame
from pepperscene.recipe.recipe import Recipe
from pepperscene.recipe.resolve.load import load_recipe
from pepperscene.render import Quality, Renderer
from pepperscene.scene import Scene
from pepperscene.version import __version__

_ONE_SCENE: Final = {"plan.sets": 1, "plan.rotations": 1, "plan.frames": 250, "plan.select": [0]}
_MAX_SIDE_PX: Final = 8192
"""Chosen: an image twice as large hardly fits into memory."""

_SIZE: Final = re.compile(r"([1-9]\d{0,4})x([1-9]\d{0,4})", re.ASCII)

TRACED: Final = ("electrons",)
"""The timed output: light, up to the sensor's electrons. Developing and labels cost the same everywhere."""


@dataclass(frozen=True)
class BenchScene:
    """A scene and a view of it.

    Attributes:
        name: on the command line and in file names.
        recipe: name of a shipped recipe.
        index: of the frame whose error is measured; its neighbours on the camera path are timed.
        description: one line for tables and pages.
        changes: changed values of the recipe, as for `--set`.
    """

    name: str
    recipe: str
    index: int
    description: str
    changes: Mapping[str, Any] = field(default_factory=dict)

    def load(self) -> Recipe:
        """The recipe with the changes."""
        return load_recipe(self.recipe, dict(self.changes))


SCENES: Final[Mapping[str, BenchScene]] = {
    scene.name: scene
    for scene in (
        BenchScene("flash", "barth2018", 125, "the thirteen plants of Barth et al. 2018 under the flash"),
        BenchScene(
            "daylight",
            "greenhouse",
            125,
            "seventeen plants and the rows beyond them, by daylight alone",
            _ONE_SCENE,
        ),
        BenchScene(
            "nir",
            "barth2018",
            125,
            "the same plants in near-infrared light of 850 nm, with a monochrome sensor",
            {
                "camera.sensor": "onsemi_mt9v024_mono",
                "camera.flash": "led_nir_850nm",
                "camera.filter": "bandpass_850nm",
                "camera.lens": "lensagon_cmfa0420nd",  # chosen: its iris is open, for the weaker light
                "camera.exposure_us": 50.0,  # chosen: a mean code of 76, and no pixel is saturated
            },
        ),
        BenchScene(
            "near",
            "barth2018",
            155,
            "three plants, a fruit and a stem close to the lens, the rest out of focus",
            {
                **_ONE_SCENE,
                "row.plants_front": 3,
                "row.plants_back": 0,
                "views.distance_mm": 210.0,  # chosen: half of the paper's; a fruit fills a tenth
                "views.pitch_deg": 0.0,  # chosen: fruit are in the centre
                "camera.lens": "lensagon_cmfa0420nd",  # chosen: open, for a shallow depth of field
                "camera.focus_mm": 140.0,  # chosen: on the nearest fruit
                "camera.exposure_us": 14.0,  # chosen: 50 us times (210 mm / 400 mm)^2, as the flash is nearer
            },
        ),
    )
}


def select_scenes(names: str) -> tuple[BenchScene, ...]:
    """The scenes of a comma-separated list, in the order of `SCENES`.

    Raises:
        InputError: a name is unknown, or the list is empty.
    """
    selected = [name.strip() for name in names.split(",") if name.strip()]
    unknown = [name for name in selected if name not in SCENES]
    if unknown or not selected:
        problem = f"unknown scene {unknown[0]!r}" if unknown else "names no scene"
        raise ArgumentError("scene", f"{problem}; allowed are {', '.join(SCENES)}")
    return tuple(scene for name, scene in SCENES.items() if name in selected)


def parse_size(text: str) -> tuple[int, int]:
    """Width and height of a text "WxH".

    Raises:
        InputError: the text has another form, or a side is too large.
    """
    match = _SIZE.fullmatch(text.strip())
    size = (int(match[1]), int(match[2])) if match else (0, 0)
    if not 1 <= min(size) <= max(size) <= _MAX_SIDE_PX:
        raise ArgumentError("size", f"{text!r} must be WIDTHxHEIGHT, each 1 to {_MAX_SIDE_PX} pixels")
    return size


def resize_camera(camera: Camera, size: Sequence[int] | None) -> Camera:
    """The camera with another number of pixels, the same width of view and the same exposure.

    Pixels become larger or smaller. So that a photosite still collects the same fraction of its full well,
    the lens transmits less for larger pixels, and the sensor's gain rises for smaller ones: both keep the
    depth of field, the mixture of lights and the brightness of the image. None keeps the camera's size.
    """
    if size is None or tuple(size) == (camera.width, camera.height):
        return camera
    columns, rows = (int(length) for length in size)
    scale = camera.width / columns
    sensor = dataclasses.replace(
        camera.sensor,
        columns=columns,
        rows=rows,
        pitch_m=camera.sensor.pitch_m * scale,
        gain=camera.sensor.gain * max(1.0, scale**-2),
        reduction=None,
    )
    lens = dataclasses.replace(camera.lens, transmittance=camera.lens.transmittance / max(1.0, scale**2))
    # The noise of unlit pixels changes with the gain; what is added to it must not.
    developing = dataclasses.replace(camera.developing, pedestal=pedestal(camera))
    return dataclasses.replace(camera, sensor=sensor, lens=lens, developing=developing)


@dataclass(frozen=True, eq=False)
class BenchSubject:
    """A loaded benchmark scene with its cameras and renderers."""

    name: str  # of the benchmark scene
    full_scene: Scene  # with everything in it
    scene: Scene  # as builds render it, without what the frames cannot see
    camera: Camera  # of the frame whose error is measured
    path: tuple[Camera, ...]  # neighbouring cameras on the path, in the order of frames
    full_renderer: Renderer  # of the full scene
    renderer: Renderer  # of the culled scene

    def render(
        self, quality: str | Quality, seed: int, camera: Camera | None = None, *, full: bool = False
    ) -> Frame:
        """Render the light of a view, by default of the frame whose error is measured."""
        renderer = self.full_renderer if full else self.renderer
        return renderer.render(camera or self.camera, TRACED, quality, seed)

    def digest(self) -> str:
        """SHA-256 of everything that the converged image depends on: version, full scene and camera."""
        sha256 = hashlib.sha256(__version__.encode())
        _update_digest(sha256, self.full_scene)
        _update_digest(sha256, self.camera)
        return sha256.hexdigest()


def load_subject(bench_scene: BenchScene, size: tuple[int, int] | None, frames: int) -> BenchSubject:
    """Build a benchmark scene and its renderers; `frames` cameras on the path are timed.

    Raises:
        SetupError: the machine cannot render.
    """
    recipe = bench_scene.load()
    frame_renderer, plan = FrameRenderer(recipe), recipe.plan
    frame = plan.frame(bench_scene.index)
    full_scene, scene = FrameRenderer(recipe, culled=False).scene(frame), frame_renderer.scene(frame)
    # Neighbours on the path, in the order of a build; they share the scene.
    first = bench_scene.index - bench_scene.index % plan.frames
    steps = [(frame.step + 1 + number) % plan.frames for number in range(frames)]
    return BenchSubject(
        bench_scene.name,
        full_scene,
        scene,
        resize_camera(frame_renderer.camera(frame), size),
        tuple(resize_camera(frame_renderer.camera(plan.frame(first + step)), size) for step in steps),
        Renderer(full_scene),
        Renderer(scene),
    )


def _update_digest(sha256: Any, value: Any) -> None:
    """Add nested frozen data to a digest: data classes, models, tuples, dictionaries, arrays and scalars."""
    sha256.update(type(value).__name__.encode())
    if isinstance(value, np.ndarray):
        sha256.update(f"{value.dtype}{value.shape}".encode())
        sha256.update(np.ascontiguousarray(value).data)
    elif dataclasses.is_dataclass(value) and not isinstance(value, type):
        for entry in dataclasses.fields(value):
            sha256.update(entry.name.encode())
            _update_digest(sha256, getattr(value, entry.name))
    elif isinstance(value, dict):
        for key, item in value.items():
            _update_digest(sha256, key)
            _update_digest(sha256, item)
    elif isinstance(value, tuple | list):
        for item in value:
            _update_digest(sha256, item)
    elif isinstance(value, BaseModel):
        sha256.update(value.model_dump_json().encode())
    elif value is None or isinstance(value, str | int | float | bool | np.generic):
        sha256.update(repr(value).encode())
    else:
        raise ValueError(f"{type(value).__name__} cannot be hashed: it is not plain data")
