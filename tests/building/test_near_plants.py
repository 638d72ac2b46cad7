"""Plants of far rows that a camera shows from near: grown in full, with instances and harvest truth."""

from __future__ import annotations

import numpy as np
import pytest

import pepperscene as ps
from pepperscene.building.scenes.frame_renderer import FrameRenderer
from pepperscene.classes import IGNORE_CLASS, OrganClass
from pepperscene.shipped import shipped_folder

pytestmark = pytest.mark.slow

NEAR_M = 1.0

RECIPES = sorted(path.stem for path in shipped_folder("recipes").glob("*.toml") if path.stem != "demo")

LABELS = ["instance", "class", "distance", "harvest"]

SMALL = {
    "plan.sets": 1,
    "plan.rotations": 1,
    "plan.frames": 2,
    "plan.select": None,
    "row.plants_front": 2,
    "row.plants_back": 1,
    "camera.width": 96,
    "camera.height": 72,
    "greenhouse.far_rows": 1,
    "greenhouse.far_reach_mm": 900,
}

# In the aisle and in the rows across it.
RANDOM = {
    "kind": "random",
    "target": "fruit",
    "distance_mm": [300, 900],
    "volume_mm": [[-800, 800], [-1500, 0], [700, 2300]],
    "clearance_mm": 30,
    "least_visibility": 0.1,
}


def coarse_pixels(frame):
    """Number of pixels of coarse plants nearer than a metre."""
    far = [int(value) for value, item in frame.metadata["instances"].items() if item.get("far")]
    return int((np.isin(frame["instance"], far) & (frame["distance"] < NEAR_M)).sum())


def near_fruit(frame):
    """Values of the fruit that have a pixel nearer than a metre."""
    items = frame.metadata["instances"]
    values = np.unique(frame["instance"][frame["distance"] < NEAR_M]).tolist()
    return {value for value in values if value and items[str(value)]["kind"] == "fruit"}


def fruit_with_truth(frame):
    return {fruit["instance"] for fruit in frame["harvest"]["fruit"]}


def frames_of(recipe, changes, indices, outputs=LABELS):
    recipe = ps.load_recipe(recipe, changes)
    renderer = FrameRenderer(recipe, allow_code=True)
    return renderer, [renderer.render(recipe.plan.frame(index), outputs) for index in indices]


@pytest.fixture(scope="module")
def random_frames():
    return frames_of("greenhouse", SMALL | {"views": RANDOM, "plan.frames": 4}, range(4))


def test_random_views_show_no_coarse_plant_from_near(random_frames):
    renderer, frames = random_frames
    assert len(renderer.scene(renderer.recipe.plan.frame(0), traced=False).skeleton.plants) > 3
    for frame in frames:
        assert (frame["distance"] < NEAR_M).mean() > 0.1
        assert coarse_pixels(frame) == 0
        assert near_fruit(frame) <= fruit_with_truth(frame)
    assert any(value for frame in frames for value in near_fruit(frame))


def test_fruit_of_near_far_plants_have_all_truth(random_frames):
    renderer, frames = random_frames
    own = renderer.recipe.row.plants_front + renderer.recipe.row.plants_back
    fruit = [one for frame in frames for one in frame["harvest"]["fruit"] if one["plant"] >= own]
    assert fruit
    for one in fruit:
        assert one["amodal_pixels"] >= one["visible_pixels"]
        assert one["length_m"] > 0.01
        assert one["peduncle"]["cut"]["world_m"]


def test_organs_of_near_far_plants_have_the_poses_of_their_triangles(random_frames):
    renderer, _ = random_frames
    scene = renderer.scene(renderer.recipe.plan.frame(0), traced=False)
    own = renderer.recipe.row.plants_front + renderer.recipe.row.plants_back
    full = [index for index in scene.skeleton.of_form("fruit") if scene.mesh.instances[index].plant >= own]
    assert full
    for index in full:
        points = scene.mesh.vertices[scene.mesh.faces[scene.mesh.face_runs.rows(index)]].reshape(-1, 3)
        organ = scene.skeleton.organ(index)
        # A fruit is around its axis.
        middle = organ.curve.mean(axis=0)
        assert np.linalg.norm(middle - 0.5 * (points.min(axis=0) + points.max(axis=0))) < 0.03
        parent = scene.mesh.instances[index].parent
        assert organ.parent == parent
        assert scene.mesh.instances[parent].plant == scene.mesh.instances[index].plant


def test_a_frame_depends_on_its_index_alone(random_frames):
    renderer, frames = random_frames
    again = FrameRenderer(renderer.recipe)
    for index in (3, 0):
        frame = again.render(renderer.recipe.plan.frame(index), LABELS)
        for name in ("instance", "distance"):
            np.testing.assert_array_equal(frame[name], frames[index][name])


POSES = "x_mm, y_mm, z_mm, yaw_deg, pitch_deg\n-400, -500, 1300, 40, 0\n500, -550, 1400, -30, 5\n"

FUNCTION = """
import numpy as np
from pepperscene import look_at
def poses(scene, rng):
    x = rng.uniform(-0.6, 0.6, 2)
    eyes, targets = [(x[0], -0.9, 1.4), (x[1], 0.3, 1.2)], [(x[0], 0.0, 1.3), (-0.6, 0.0, 1.2)]
    return np.array([look_at(eye, target) for eye, target in zip(eyes, targets)])
"""


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    folder = tmp_path_factory.mktemp("views")
    (folder / "robot.csv").write_text(POSES, encoding="utf-8")
    (folder / "views.py").write_text(FUNCTION, encoding="utf-8")
    return folder


def views_of_kind(kind, files):
    return {
        "poses": {"kind": "poses", "file": str(files / "robot.csv")},
        "function": {"kind": "function", "file": str(files / "views.py")},
        "path": {
            "kind": "path",
            "points_mm": [[-500, -500, 1300], [500, -500, 1300]],
            "speed_mm_s": 300,
            "azimuth_deg": 20,
        },
        "grid": {"kind": "grid", "x_mm": [-400, 400], "distance_mm": [600], "height_mm": [1300]},
        "arc": {"kind": "arc", "distance_mm": 600, "azimuth_deg": [-60, 60], "height_mm": [1300, 1500]},
        "protocol": {
            "kind": "protocol",
            "distance_mm": [500],
            "azimuth_deg": [-50, 50],
            "height_mm": 1300,
            "pitch_deg": 0,
        },
    }[kind]


@pytest.mark.parametrize(
    "kind",
    [
        "poses",
        "function",
        "path",
        "grid",
        *(pytest.param(k, marks=pytest.mark.long) for k in ("arc", "protocol")),
    ],
)
def test_views_of_every_kind_show_no_coarse_plant_from_near(kind, files):
    changes = SMALL | {"row.plants_front": 1, "row.plants_back": 0, "views": views_of_kind(kind, files)}
    renderer, frames = frames_of("greenhouse", changes, range(2))
    for frame in frames:
        assert coarse_pixels(frame) == 0
        assert near_fruit(frame) <= fruit_with_truth(frame)
    assert len(renderer.scene(renderer.recipe.plan.frame(0), traced=False).skeleton.plants) > 1


@pytest.mark.parametrize(
    "name",
    [n if n in ("season", "barth2018_robot") else pytest.param(n, marks=pytest.mark.long) for n in RECIPES],
)
def test_shipped_recipes_show_no_coarse_plant_from_near(name):
    changes = {key: value for key, value in SMALL.items() if not key.startswith("greenhouse")}
    if name == "barth2018_robot":
        del changes["plan.frames"]  # its views are as many as its protocol has
    if ps.load_recipe(name).greenhouse is not None:
        changes["greenhouse.far_reach_mm"] = 900
    if name == "line_scanner":
        changes |= {"camera.width": 32, "camera.height": 24}
    _, frames = frames_of(name, changes, [0, 1])
    for frame in frames:
        assert coarse_pixels(frame) == 0
        assert near_fruit(frame) <= fruit_with_truth(frame)


@pytest.mark.parametrize("labelled_as", ["ignore", "background"])
def test_labels_of_far_rows_change_nothing_else(labelled_as, files):
    # The rolling shutter of a moving camera, and geometry that is culled.
    changes = SMALL | {"row.plants_back": 0, "views": views_of_kind("path", files)}
    outputs = ["class", "distance", "instance", "harvest"]
    (_, (expected,)), (_, (frame,)) = (
        frames_of("greenhouse", changes | {"greenhouse.far_rows_as": value}, [1], outputs)
        for value in ("labels", labelled_as)
    )
    np.testing.assert_array_equal(frame["distance"], expected["distance"])
    items = expected.metadata["instances"]
    own = [int(value) for value, item in items.items() if 0 <= item["plant"] < 2]
    is_own = np.isin(expected["instance"], own)
    near_far = np.isin(expected["class"], range(1, 8)) & ~is_own & (expected["distance"] < NEAR_M)
    near_far &= expected["class"] != OrganClass.WIRE
    assert near_far.any()
    assert set(frame["class"][near_far]) == {IGNORE_CLASS if labelled_as == "ignore" else 0}
    np.testing.assert_array_equal(frame["class"][is_own], expected["class"][is_own])
    # Fruit that are no organs in the labels have no truth.
    truth = {fruit["instance"] for fruit in expected["harvest"]["fruit"] if fruit["plant"] < 2}
    assert fruit_with_truth(frame) == truth < fruit_with_truth(expected)


def test_all_cameras_of_a_frame_count(files):
    # The main camera and the first of the rig look away; partner and rig stand where the plants are seen.
    changes = SMALL | {"row.plants_front": 1, "row.plants_back": 0, "plan.frames": 1}
    changes["views"] = {"kind": "grid", "x_mm": [0], "distance_mm": [1500], "height_mm": [1300]}
    changes["greenhouse.aisle_mm"] = 3000

    def numbers(more):
        recipe = ps.load_recipe("greenhouse", changes | more)
        renderer = FrameRenderer(recipe)
        scene = renderer.scene(recipe.plan.frame(0), traced=False)
        instances = (scene.mesh.instances[index] for index in scene.skeleton.of_form("internode"))
        return {item.plant for item in instances if item.plant >= 1}

    alone = numbers({})
    with_rig = numbers({"rig": [{"name": "near", "position_mm": [0, 0, 1000]}]})
    with_partner = numbers({"camera.baseline_mm": 900, "views.distance_mm": [900]})
    assert alone < with_rig
    assert with_partner > numbers({"views.distance_mm": [900]})


def test_frames_without_near_plants_are_as_before():
    """A scene whose far rows are more than a metre from every lens has no full plant."""
    recipe = ps.load_recipe(
        "multispectral", {"row.plants_front": 9, "row.plants_back": 0, "greenhouse.far_rows": 1}
    )
    scene = FrameRenderer(recipe, culled=False).scene(recipe.plan.frame(1), traced=False)
    assert len(scene.skeleton.plants) == 9


@pytest.mark.long
@pytest.mark.parametrize("name", ["randomised", "ripe"])
def test_two_hundred_random_views_show_no_coarse_plant_from_near(name):
    size = {"camera.width": 200, "camera.height": 150}
    ripe = {
        "plan": {"sets": 5, "rotations": 1, "frames": 20},
        "views": {
            "kind": "random",
            "target": "ripe fruit",
            "distance_mm": [250, 600],
            "elevation_deg": [-30, 20],
            "azimuth_deg": [-50, 50],
            "offset": [0, 0.5],
            "least_visibility": 0.4,
        },
    }
    recipe = ps.load_recipe(*(("randomised", size) if name == "randomised" else ("greenhouse", size | ripe)))
    renderer = FrameRenderer(recipe)
    for index in range(100):
        frame = renderer.render(recipe.plan.frame(index), LABELS)
        assert coarse_pixels(frame) == 0
        assert near_fruit(frame) <= fruit_with_truth(frame)
