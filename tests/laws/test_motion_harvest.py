"""The harvest truth of a camera that moves while its rows are read out."""

from dataclasses import replace

import numpy as np
import pytest
from test_harvest import DISTORTION

from pepperscene.building.scenes.frame_renderer import FrameRenderer
from pepperscene.camera import Motion
from pepperscene.recipe.resolve.load import load_recipe
from pepperscene.render import Renderer
from pepperscene.truth.encodings import decode_rle

OUTPUTS = ("instance", "distance", "harvest")


@pytest.fixture(scope="module")
def row():
    """A renderer of five plants, a camera with a rolling shutter that moves, and its frame."""
    recipe = load_recipe("barth2018", {"row.plants_front": 3, "row.plants_back": 2})
    frames, spec = FrameRenderer(recipe), recipe.plan.frame(125)
    scene, camera = frames.scene(spec, traced=False), frames.camera(spec)
    lens = replace(camera.lens, focal_length_m=0.5 * camera.lens.focal_length_m, distortion=DISTORTION)
    sensor = replace(camera.sensor, columns=400, rows=300, line_time_s=1e-4)
    camera = replace(camera, lens=lens, sensor=sensor, motion=Motion((0.8, 0.5, -0.4), (0.5, -0.8, 1.0)))
    renderer = Renderer(scene)
    return renderer, camera, renderer.render(camera, OUTPUTS)


def test_every_visible_fruit_has_its_truth(row):
    renderer, _, frame = row
    skeleton = renderer.scene.skeleton
    in_image = {int(value) for value in np.unique(frame["instance"]) if value}
    fruit = {index + 1 for index in skeleton.of_form("fruit")} & in_image
    listed = {entry["instance"] for entry in frame["harvest"]["fruit"] if entry["visible_pixels"]}
    assert len(fruit) > 5
    assert listed == fruit


def test_fruit_that_only_the_first_or_last_rows_see_have_their_truth(row):
    # Moving down by 30 cm during the readout, the camera sees as much more above and below.
    renderer, camera, _ = row
    fruit = {index + 1 for index in renderer.scene.skeleton.of_form("fruit")}
    moving = replace(camera, motion=Motion(10.0 * camera.pose[:3, 1]))
    frame = renderer.render(moving, OUTPUTS)
    shown = fruit & {*np.unique(frame["instance"]).tolist()}
    assert {e["instance"] for e in frame["harvest"]["fruit"] if e["visible_pixels"]} == shown
    at_rest = renderer.render(replace(camera, motion=None), ["instance"])["instance"]
    assert len(shown - {*np.unique(at_rest).tolist()}) > 3


def test_rows_of_amodal_masks_are_those_of_still_cameras(row):
    renderer, camera, frame = row
    entries = {entry["instance"]: entry for entry in frame["harvest"]["fruit"]}
    checked = 0
    for v in (20, 149, 280):
        still = replace(camera, pose=camera.label_poses(v + 0.5), motion=None)
        others = {e["instance"]: e for e in renderer.render(still, OUTPUTS)["harvest"]["fruit"]}
        for instance in entries.keys() | others.keys():
            rows = [
                decode_rle(found[instance]["amodal"])[v] if instance in found else np.zeros(400, bool)
                for found in (entries, others)
            ]
            assert (rows[0] != rows[1]).sum() <= 1
            checked += rows[1].sum() > 5
    assert checked > 5


def test_points_of_stalks_are_projected_and_seen_in_their_rows(row):
    _, camera, frame = row
    seen = 0
    for entry in frame["harvest"]["fruit"]:
        for name in ("attachment", "cut"):
            point = None if entry["peduncle"] is None else entry["peduncle"][name]
            if point is None or point["px"] is None:
                continue
            assert camera.project(point["world_m"])[0] == pytest.approx(point["px"], abs=0.01)
            # In front of the point from its row's pose is the stalk itself, or something clearly nearer.
            u, v = point["px"]
            centre = camera.label_poses(np.floor(v) + 0.5)[:3, 3]
            gap = np.linalg.norm(np.array(point["world_m"]) - centre) - frame["distance"][int(v), int(u)]
            if point["visible"]:
                assert abs(gap) <= 3.1 * entry["peduncle"]["radius_m"]
                seen += 1
            on_stalk = frame["instance"][int(v), int(u)] == entry["peduncle"]["instance"]
            if on_stalk and abs(gap) < entry["peduncle"]["radius_m"]:
                assert point["visible"]
    assert seen >= 3
