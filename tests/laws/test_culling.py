"""Culling changes no labels and no visible light: complete scenes against culled ones."""

from dataclasses import replace

import numpy as np
import pytest

from pepperscene.building.scenes.frame_renderer import FrameRenderer
from pepperscene.camera import develop
from pepperscene.recipe.resolve.load import load_recipe
from pepperscene.render import Renderer

FEW = {"row.plants_front": 2, "row.plants_back": 1, "cultivar": "kaite_february"}
LABELS = ("class", "instance", "distance", "normal")


def with_larger_pixels(camera, binning):
    sensor = camera.sensor
    shape = {"columns": sensor.columns // binning, "rows": sensor.rows // binning}
    return replace(camera, sensor=replace(sensor, **shape, binning=sensor.binning * binning))


def compare(recipe, index, binning, quality="reference", seeds=(1, 2)):
    """Frames and triangle counts of both scenes; mean squared and mean difference in codes.

    Both are traced with the same random numbers. The remaining noise is independent between two seeds, so the
    mean product of their differences is the true mean squared difference.
    """
    frame_renderer, spec = FrameRenderer(recipe), recipe.plan.frame(index)
    camera = with_larger_pixels(frame_renderer.camera(spec), binning)
    codes, frames, triangles = [], [], []
    for frame_renderer.culled in (False, True):
        scene = frame_renderer.scene(spec)
        renderer = Renderer(scene)
        triangles.append(len(scene.mesh.faces))
        rendered = [renderer.render(camera, ("electrons", *LABELS), quality, seed) for seed in seeds]
        codes.append([develop(frame["electrons"], camera).astype(float) for frame in rendered])
        frames.append(rendered[0])
    first, second = (culled - complete for complete, culled in zip(*codes, strict=True))
    return frames, triangles, float(np.mean(first * second)), float(np.mean((first + second) / 2.0))


def assert_same_labels(frames, ties=0):
    """Labels are the same, but for a few pixels where a ray hits two organs at the same distance."""
    complete, culled = frames
    same_distance = complete["distance"] == culled["distance"]
    for name in LABELS:
        differs = np.any(np.atleast_3d(complete[name] != culled[name]), axis=-1)
        assert differs.sum() <= ties, name
        assert same_distance[differs].all(), name


@pytest.mark.parametrize(
    ("name", "changes", "index", "max_fraction"),
    [
        ("barth2018", {}, 20, 0.75),
        pytest.param("barth2018", {"daylight.illuminance_lx": 0}, 70, 0.75, marks=pytest.mark.long),
        pytest.param("demo", {"views.pitch_deg": 0}, 2290, 0.75, marks=pytest.mark.long),
        ("greenhouse", {"greenhouse.far_rows": 1, "greenhouse.far_reach_mm": 1000}, 4, 1.0),
    ],
)
def test_culled_scene_looks_the_same(name, changes, index, max_fraction):
    recipe = load_recipe(name, {**FEW, **changes})
    frames, (complete, culled), squared, mean = compare(recipe, index, binning=20)
    assert_same_labels(frames)
    assert frames[0]["instance"].max() > 0
    assert culled <= max_fraction * complete
    assert squared < 0.15**2
    assert abs(mean) < 0.1


def test_all_frames_of_a_scene_share_one_mesh():
    recipe = load_recipe("barth2018", FEW)
    first, *others = (
        FrameRenderer(recipe).scene(recipe.plan.frame(index), traced=traced).mesh
        for index, traced in ((3, False), (3, True), (249, False))
    )
    for mesh in others:
        np.testing.assert_array_equal(mesh.vertices, first.vertices)
        np.testing.assert_array_equal(mesh.faces, first.faces)


@pytest.mark.long
@pytest.mark.parametrize("index", [20, 125, 240])
def test_culled_standard_scene_looks_the_same(index):
    # Labels pixel by pixel at 800x600; light with larger pixels, which have less noise.
    recipe = load_recipe("barth2018")
    frames, (complete, culled), _, _ = compare(recipe, index, 1, "draft", (1, 1))
    assert_same_labels(frames, ties=1)
    assert culled < 0.6 * complete
    _, _, squared, mean = compare(recipe, index, 4)
    assert squared < 0.1**2
    assert abs(mean) < 0.05
