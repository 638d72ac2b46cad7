"""A benchmark subject without plants, for a renderer with a known error and run time."""

from __future__ import annotations

import pytest
from noisy_renderer import NoisyRenderer

from pepperscene.bench import measure, scenes
from pepperscene.bench.scenes import BenchSubject, resize_camera
from pepperscene.building.scenes.frame_renderer import FrameRenderer
from pepperscene.geometry import rectangle
from pepperscene.materials import lambertian_surface
from pepperscene.recipe.resolve.load import load_recipe
from pepperscene.scene import assemble_scene


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
