"""A benchmark subject without plants, and a renderer with a known error and run time."""

from __future__ import annotations

import numpy as np
import pytest

from pepperscene.bench import measure, scenes
from pepperscene.bench.scenes import BenchSubject, resize_camera
from pepperscene.dataset import FrameRenderer, load_recipe
from pepperscene.frame import Frame
from pepperscene.geometry import rectangle
from pepperscene.materials import lambertian_surface
from pepperscene.render import QUALITIES
from pepperscene.scene import assemble_scene


class NoisyRenderer:
    """Renders a constant with noise that falls with the root of the samples; its clock advances with them."""

    level_e, noise_e = 2_000.0, 200.0

    def __init__(self, scene):
        self.scene = scene
        self.now = 0.0
        self.calls = []

    def render(self, camera, outputs=(), quality="standard", seed=0):
        quality = QUALITIES[quality] if isinstance(quality, str) else quality
        self.calls.append((camera, quality, seed))
        self.now += 0.01 * quality.samples
        shape = (camera.height, camera.width, camera.sensor.channels)
        noise = np.random.default_rng(seed).normal(size=shape) * self.noise_e / np.sqrt(quality.samples)
        image = (self.level_e + noise).astype(np.float32)
        return Frame({"electrons": image}, {"variant": "noisy", "sampling": {"samples_per_pixel": 1.0}})


@pytest.fixture(scope="session")
def full_camera():
    """The camera of the scene `flash`."""
    recipe = load_recipe("barth2018")
    return FrameRenderer(recipe).camera(recipe.plan.frame(125))


@pytest.fixture(scope="session")
def camera(full_camera):
    """The camera of the scene `flash`, with few pixels."""
    return resize_camera(full_camera, (24, 18))


@pytest.fixture(scope="session")
def wall():
    """A scene of two triangles."""
    return assemble_scene(
        rectangle((0, 0, 1), (1, 0, 0), (0, 0, 1)), {"leaf": lambertian_surface("leaf", 0.5)}
    )


@pytest.fixture
def subject(camera, wall):
    path = tuple(camera.at_pose(camera.pose) for _ in range(3))
    renderer = NoisyRenderer(wall)
    return BenchSubject("test", wall, wall, camera, path, renderer, renderer)


@pytest.fixture
def simulated_clock(subject, monkeypatch):
    """Times are those of the subject's renderer."""
    monkeypatch.setattr(measure, "perf_counter", lambda: subject.renderer.now)


@pytest.fixture
def noisy_scenes(monkeypatch, wall):
    """All scenes are the wall, rendered with noise."""
    monkeypatch.setattr(FrameRenderer, "scene", lambda *_args, **_kwargs: wall)
    monkeypatch.setattr(scenes, "Renderer", NoisyRenderer)
