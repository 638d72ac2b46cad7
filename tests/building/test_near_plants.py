"""Plants of far rows that a camera shows from near are grown in full, with instances and harvest truth."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import pepperscene as ps
from pepperscene.building.scenes import scene_builder
from pepperscene.building.scenes.frame_renderer import FrameRenderer
from pepperscene.building.scenes.scene_builder import SceneBuilder
from pepperscene.camera import Camera, Motion, load_lens, load_sensor, look_at
from pepperscene.classes import IGNORE_CLASS, Instance, OrganClass
from pepperscene.cultivar import load_cultivar
from pepperscene.geometry import sphere
from pepperscene.recipe.views.near_plants import CoarsePlants, near_views
from pepperscene.scene import FarRow
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


def check_near(frames):
    """No frame shows a coarse plant from near, and near fruit have harvest truth."""
    for frame in frames:
        assert coarse_pixels(frame) == 0
        assert near_fruit(frame) <= fruit_with_truth(frame)


def frames_of(recipe, changes, indices, outputs=LABELS):
    recipe = ps.load_recipe(recipe, changes)
    renderer = FrameRenderer(recipe, allow_code=True)
    return renderer, [renderer.render(recipe.plan.frame(index), outputs) for index in indices]


@pytest.fixture(scope="module")
def random_frames():
    return frames_of("greenhouse", SMALL | {"views": RANDOM}, range(2))


@pytest.mark.long
def test_random_views_show_no_coarse_plant_from_near(random_frames):
    renderer, frames = random_frames
    assert len(renderer.scene(renderer.recipe.plan.frame(0), traced=False).skeleton.plants) > 3
    check_near(frames)
    assert all((frame["distance"] < NEAR_M).mean() > 0.1 for frame in frames)
    assert any(value for frame in frames for value in near_fruit(frame))
    own = renderer.recipe.row.plants_front + renderer.recipe.row.plants_back
    fruit = [one for frame in frames for one in frame["harvest"]["fruit"] if one["plant"] >= own]
    assert fruit
    for one in fruit:
        assert one["amodal_pixels"] >= one["visible_pixels"]
        assert one["length_m"] > 0.01
        assert one["peduncle"]["cut"]["world_m"]
    # A frame depends on its index alone.
    alone = FrameRenderer(renderer.recipe).render(renderer.recipe.plan.frame(1), LABELS)
    for name in ("instance", "distance"):
        np.testing.assert_array_equal(alone[name], frames[1][name])


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


FUNCTION = """
import numpy as np
from pepperscene import look_at
def poses(scene, rng):
    x = rng.uniform(-0.6, 0.6, 2)
    eyes, targets = [(x[0], -0.9, 1.4), (x[1], 0.3, 1.2)], [(x[0], 0.0, 1.3), (-0.6, 0.0, 1.2)]
    return np.array([look_at(eye, target) for eye, target in zip(eyes, targets)])
"""


@pytest.fixture
def one_plant(tmp_path):
    """Changes of a recipe by the kind of its views, with a single plant of its own."""
    (tmp_path / "robot.csv").write_text(
        "x_mm, y_mm, z_mm, yaw_deg, pitch_deg\n-400, -500, 1300, 40, 0\n500, -550, 1400, -30, 5\n"
    )
    (tmp_path / "views.py").write_text(FUNCTION)
    arcs = {"azimuth_deg": [-50, 50], "height_mm": 1300, "pitch_deg": 0}
    views = {
        "poses": {"file": str(tmp_path / "robot.csv")},
        "function": {"file": str(tmp_path / "views.py")},
        "path": {
            "points_mm": [[-500, -500, 1300], [500, -500, 1300]], "speed_mm_s": 300, "azimuth_deg": 20,
        },
        "grid": {"x_mm": [-400, 400], "distance_mm": [600], "height_mm": [1300]},
        "arc": {"distance_mm": 600, "azimuth_deg": [-60, 60], "height_mm": [1300, 1500]},
        "protocol": {"distance_mm": [500], **arcs},
    }  # fmt: skip
    return lambda kind: (
        SMALL | {"row.plants_front": 1, "row.plants_back": 0, "views": {"kind": kind, **views[kind]}}
    )


@pytest.mark.parametrize(
    "kind",
    [
        "function",
        *(pytest.param(k, marks=pytest.mark.long) for k in ("poses", "path", "grid", "arc", "protocol")),
    ],
)
def test_views_of_every_kind_show_no_coarse_plant_from_near(kind, one_plant):
    renderer, frames = frames_of("greenhouse", one_plant(kind), range(2))
    check_near(frames)
    assert len(renderer.scene(renderer.recipe.plan.frame(0), traced=False).skeleton.plants) > 1


@pytest.mark.long
@pytest.mark.parametrize("name", RECIPES)
def test_shipped_recipes_show_no_coarse_plant_from_near(name):
    recipe = ps.load_recipe(name)
    if recipe.stand is not None:
        pytest.skip("a stand has no rows")
    changes = {key: value for key, value in SMALL.items() if not key.startswith("greenhouse")}
    if name == "barth2018_robot":
        del changes["plan.frames"]  # its views are as many as its protocol has
    if recipe.greenhouse is not None:
        changes["greenhouse.far_reach_mm"] = 900
    if name == "line_scanner":
        changes |= {"camera.width": 32, "camera.height": 24}
    check_near(frames_of(name, changes, [0, 1])[1])


@pytest.mark.long
def test_labels_of_far_rows_change_nothing_else(one_plant):
    # The rolling shutter of a moving camera, and geometry that is culled.
    outputs = ["class", "distance", "instance", "harvest"]
    expected, *others = (
        frames_of("greenhouse", one_plant("path") | {"greenhouse.far_rows_as": value}, [1], outputs)[1][0]
        for value in ("labels", "ignore", "background")
    )
    items = expected.metadata["instances"]
    own = [int(value) for value, item in items.items() if item["plant"] == 0]
    is_own = np.isin(expected["instance"], own)
    near_far = np.isin(expected["class"], range(1, 8)) & ~is_own & (expected["distance"] < NEAR_M)
    near_far &= expected["class"] != OrganClass.WIRE
    assert near_far.any()
    # Fruit that are no organs in the labels have no truth.
    truth = {fruit["instance"] for fruit in expected["harvest"]["fruit"] if fruit["plant"] == 0}
    assert truth < fruit_with_truth(expected)
    for frame, class_id in zip(others, (IGNORE_CLASS, 0), strict=True):
        np.testing.assert_array_equal(frame["distance"], expected["distance"])
        assert set(frame["class"][near_far]) == {class_id}
        np.testing.assert_array_equal(frame["class"][is_own], expected["class"][is_own])
        assert fruit_with_truth(frame) == truth


def test_all_cameras_of_a_frame_count():
    # The main camera and the first of the rig look away; partner and rig stand where the plants are seen.
    changes = SMALL | {"row.plants_front": 1, "row.plants_back": 0, "plan.frames": 1}
    changes["views"] = {"kind": "grid", "x_mm": [0], "distance_mm": [1500], "height_mm": [1300]}
    changes |= {"greenhouse.aisle_mm": 3000, "cultivar": "kaite_february"}

    def numbers(more):
        recipe = ps.load_recipe("greenhouse", changes | more)
        scene = FrameRenderer(recipe).scene(recipe.plan.frame(0), traced=False)
        instances = (scene.mesh.instances[index] for index in scene.skeleton.of_form("internode"))
        return {item.plant for item in instances if item.plant >= 1}

    assert numbers({}) < numbers({"rig": [{"name": "near", "position_mm": [0, 0, 1000]}]})
    with_partner = numbers({"camera.baseline_mm": 900, "views.distance_mm": [900]})
    assert with_partner > numbers({"views.distance_mm": [900]})


@pytest.mark.long
@pytest.mark.parametrize("name", ["randomised", "ripe"])
def test_two_hundred_random_views_show_no_coarse_plant_from_near(name):
    size = {"camera.width": 200, "camera.height": 150}
    ripe = {
        "plan": {"sets": 5, "rotations": 1, "frames": 20},
        "views": {
            "kind": "random", "target": "ripe fruit", "distance_mm": [250, 600], "elevation_deg": [-30, 20],
            "azimuth_deg": [-50, 50], "offset": [0, 0.5], "least_visibility": 0.4,
        },
    }  # fmt: skip
    recipe, changes = ("randomised", size) if name == "randomised" else ("greenhouse", size | ripe)
    check_near(frames_of(recipe, changes, range(100))[1])


@pytest.mark.long
def test_later_random_views_show_no_coarse_plant_from_near(monkeypatch):
    # The first view alone decides, and the plants that others would come near to stay coarse.
    monkeypatch.setattr(scene_builder, "DECISIVE_VIEWS", 1)
    views = RANDOM | {"distance_mm": [300, 600], "azimuth_deg": [-30, 30]}
    del views["volume_mm"]
    changes = SMALL | {"row.plants_front": 1, "row.plants_back": 0, "plan.frames": 4, "views": views}
    renderer, frames = frames_of("greenhouse", changes, range(4), ["instance", "distance"])
    for index, frame in enumerate(frames):
        instances = renderer.scene(renderer.recipe.plan.frame(index), traced=False).mesh.instances
        coarse = [number for number, item in enumerate(instances, 1) if item.far_row >= 0 and not item.full]
        assert coarse
        assert not (np.isin(frame["instance"], coarse) & (frame["distance"] < NEAR_M)).any()


@pytest.fixture(scope="module")
def builder():
    changes = {
        "cultivar": "kaite_february",
        "row.plants_front": 2,
        "row.plants_back": 1,
        "greenhouse.far_rows": 1,
        "greenhouse.far_reach_mm": 700,
    }
    recipe = ps.load_recipe("greenhouse", changes)
    return SceneBuilder(recipe, load_cultivar(recipe.cultivar))


def test_full_plants_change_nothing_but_themselves(builder):
    built = builder.scene(0, 0)
    chosen = [int(built.far_rows[0].plants[1]), int(built.far_rows[2].plants[0])]
    full = builder.with_full_plants(built, chosen)
    for name in ("vertices", "faces", "face_instance"):
        count = built.begin[0] if name == "vertices" else built.begin[1]
        np.testing.assert_array_equal(getattr(full.mesh, name)[:count], getattr(built.mesh, name)[:count])
    assert full.mesh.instances[: built.begin[2]] == built.mesh.instances[: built.begin[2]]

    def points(mesh, plant):
        owner = np.array([item.plant for item in mesh.instances])[mesh.face_instance]
        return mesh.vertices[np.unique(mesh.faces[owner == plant])]

    for row in built.far_rows:
        for plant in row.plants.tolist():
            before, after = points(built.mesh, plant), points(full.mesh, plant)
            if plant in chosen:
                assert len(after) > 3 * len(before)
                # Roots and tips are where they were.
                assert abs(before[:, 2].min() - after[:, 2].min()) < 0.02
            else:
                np.testing.assert_array_equal(before, after)
    assert {item.plant for item in full.mesh.instances if item.full} == set(chosen)
    assert len(full.skeleton.plants) == len(built.skeleton.plants) + 2
    assert any(item.kind == "twine" and item.full for item in full.mesh.instances)
    assert builder.with_full_plants(built, ()) is built


def ball_plants(distance_m):
    """One plant, a ball with a radius of 10 cm, whose surface is as far along y from the origin."""
    ball = replace(sphere((0, 0, 0), 0.1), instances=(Instance(OrganClass.PEPPER, "fruit"),))
    row = FarRow(0, np.array([7]), np.array([0]), np.array([0.3]), np.array([[0.0, distance_m + 0.1, 1.0]]))
    return CoarsePlants([ball], [row])


def camera_at(target=(0.0, 1.0, 1.0)):
    camera = Camera(load_lens("lensagon_cmfa0420nd"), load_sensor("ueye_ui5250re"))
    return camera.at_pose(look_at((0.0, 0.0, 1.0), target))


@pytest.mark.parametrize(("distance_m", "expected"), [(0.99, (7,)), (1.01, ())])
def test_near_is_nearer_than_a_metre(distance_m, expected):
    assert ball_plants(distance_m).shown_near(near_views([camera_at()])) == expected


def test_only_what_is_in_view_is_near():
    behind, aside = camera_at((0.0, -1.0, 1.0)), camera_at((1.0, 0.0, 1.0))
    assert ball_plants(0.3).shown_near(near_views([behind, aside])) == ()
    assert ball_plants(0.3).shown_near(near_views([behind, camera_at()])) == (7,)


def test_a_moving_camera_comes_near():
    camera = replace(camera_at(), exposure_s=0.1)
    still = ball_plants(1.2).shown_near(near_views([camera]))
    moving = replace(camera, motion=Motion(np.array([0.0, 6.0, 0.0]), np.zeros(3)))
    assert (still, ball_plants(1.2).shown_near(near_views([moving]))) == ((), (7,))
