"""The visibility of fruit against label images of a complete row.

The observer samples the fruit's surface without an image; label images trace a ray through each pixel's
centre. Visible pixels differ by less than 1 % of those that a fruit would have alone. Pixels at outlines are
counted whole, so images with finer pixels are the reference, and fruit of few pixels are left out.
"""

from dataclasses import replace

import numpy as np
import pytest

from pepperscene.building.scenes.frame_renderer import FrameRenderer
from pepperscene.camera import Camera
from pepperscene.recipe.resolve.load import load_recipe
from pepperscene.recipe.views.workspace import BoxWorkspace, ReachTest, random_poses
from pepperscene.render import Renderer
from pepperscene.render.viewpoints import FruitObserver

POSES = 50
LEAST_PIXELS = 1000
SAMPLES = 32768
FINER = 2  # pixels of the images along a side of a pixel of the camera


def with_finer_pixels(camera: Camera) -> Camera:
    """The camera with the same field of view and `FINER` times as many columns and rows."""
    lens = replace(camera.lens, focal_length_m=FINER * camera.lens.focal_length_m)
    columns, rows = FINER * camera.width, FINER * camera.height
    sensor = replace(camera.sensor, columns=columns, rows=rows)
    return replace(camera, lens=lens, sensor=sensor, focus_m=None)


@pytest.fixture(scope="module")
def errors():
    """Differences of visible pixels over those of the fruit alone, by pose and fruit; and the fruit."""
    recipe = load_recipe("barth2018")
    frames, spec = FrameRenderer(recipe, culled=False), recipe.plan.frame(0)
    scene, camera = frames.scene(spec, traced=False), frames.camera(spec)
    observer, renderer = FruitObserver(scene, SAMPLES), Renderer(scene)
    reach = ReachTest(BoxWorkspace((-0.8, -0.6, 0.7), (0.8, -0.25, 2.2)), scene.mesh, 0.03)
    poses = random_poses(reach, observer.points.skin_centres, POSES, np.random.default_rng(7))
    seen = observer.observe(camera, poses)
    found = {}
    for row, (pose, fruit) in enumerate(zip(seen.pose_index, seen.fruit_index, strict=True)):
        found[int(pose), int(seen.fruit[fruit])] = seen.visible_pixels[row]
    finer, area = with_finer_pixels(camera), FINER**2
    differences, fruit_seen = [], set()
    for number, pose in enumerate(poses):
        for fruit in renderer.render(finer.at_pose(pose), ["harvest"])["harvest"]["fruit"]:
            fruit_seen.add(fruit["instance"])
            pixels = found.get((number, fruit["instance"] - 1), 0.0)
            if fruit["amodal_pixels"] >= area * LEAST_PIXELS:
                differences.append((area * pixels - fruit["visible_pixels"]) / fruit["amodal_pixels"])
    return np.array(differences), fruit_seen


@pytest.mark.long
def test_visible_pixels_are_those_of_label_images(errors):
    differences, fruit_seen = errors
    assert len(fruit_seen) >= 180
    assert len(differences) >= 200
    assert np.abs(differences).max() < 0.01
    assert np.sqrt(np.mean(differences**2)) < 0.003
    assert np.abs(differences.mean()) < 0.0005
