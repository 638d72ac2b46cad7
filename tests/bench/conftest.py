"""A subject without plants, and a renderer whose error and run time follow a law that is known."""

from __future__ import annotations

import numpy as np
import pytest

from pepperscene.bench.scenes import BenchSubject, resized
from pepperscene.dataset import FrameRenderer, load_recipe
from pepperscene.frame import Frame
from pepperscene.geometry import rectangle
from pepperscene.materials import lambertian_surface
from pepperscene.render import QUALITIES
from pepperscene.scene import assemble_scene

SIZE = (24, 18)
LEVEL_E = 2_000.0
NOISE_E = 200.0


class Noisy:
    """Light with independent noise that falls with the root of the samples; the clock goes with them."""

    level, noise = LEVEL_E, NOISE_E

    def __init__(self, scene):
        self.scene = scene
        self.now = 0.0
        self.asked = []

    def clock(self):
        return self.now

    def render(self, camera, outputs=(), quality="standard", seed=0):
        quality = QUALITIES[quality] if isinstance(quality, str) else quality
        self.asked.append((camera, quality, seed))
        self.now += 0.01 * quality.samples
        shape = (camera.height, camera.width, camera.sensor.channels)
        noise = np.random.default_rng(seed).normal(size=shape) * NOISE_E / np.sqrt(quality.samples)
        image = (LEVEL_E + noise).astype(np.float32)
        return Frame({"electrons": image}, {"variant": "made up", "sampling": {"samples_per_pixel": 1.0}})


@pytest.fixture(scope="session")
def camera():
    """Of the standard scene, with few pixels."""
    recipe = load_recipe("barth2018")
    return resized(FrameRenderer(recipe).camera(recipe.plan.frame(125)), SIZE)


@pytest.fixture(scope="session")
def wall():
    """A scene of two triangles."""
    return assemble_scene(
        rectangle((0, 0, 1), (1, 0, 0), (0, 0, 1)), {"leaf": lambertian_surface("leaf", 0.5)}
    )


@pytest.fixture
def subject(camera, wall):
    path = tuple(camera.at_pose(camera.pose) for _ in range(3))
    noisy = Noisy(wall)
    return BenchSubject("made", wall, wall, camera, path, noisy, noisy)


@pytest.fixture
def no_plants(monkeypatch, wall):
    """Stages without plants."""
    monkeypatch.setattr(FrameRenderer, "scene", lambda *_args, **_kwargs: wall)


@pytest.fixture
def noisy_renderer():
    """Makes the renderer of a scene."""
    return Noisy
