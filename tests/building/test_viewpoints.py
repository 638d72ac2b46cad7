"""Viewpoint planning: workspaces, poses in them, tables, and planners compared with an exhaustive search."""

from __future__ import annotations

import numpy as np
import pytest
from pyarrow import parquet
from scipy.stats import kstest

import pepperscene as ps
from pepperscene.building.viewpoints.recipe_visibility import ViewpointOptions, recipe_visibility
from pepperscene.building.viewpoints.table import COLUMNS, METADATA_KEY, write_visibility
from pepperscene.errors import ArgumentError
from pepperscene.geometry import sphere
from pepperscene.recipe.resolve.load import resolve_recipe

CHANGES = {
    "cultivar": "kaite_february",
    "row": {"plants_front": 1, "plants_back": 0},
    "plan": {"sets": 2, "rotations": 1, "frames": 6, "select": [1, 2]},
}
AISLE = ps.BoxWorkspace((-0.4, -0.6, 0.6), (0.4, -0.25, 1.6))
EVERYWHERE = ps.BoxWorkspace((-10.0, -10.0, -10.0), (10.0, 10.0, 10.0))


@pytest.fixture(scope="module")
def resolved():
    return resolve_recipe("barth2018", CHANGES)


@pytest.fixture(scope="module")
def scene(resolved):
    return ps.FrameRenderer(resolved, culled=False).scene(resolved.recipe.plan.frame(1), traced=False)


@pytest.fixture(scope="module")
def observer(scene):
    return ps.FruitObserver(scene, 256)


@pytest.fixture(scope="module")
def camera(resolved):
    return resolved.camera


@pytest.mark.parametrize(
    ("workspace", "volume"),
    [(ps.BoxWorkspace((0, 0, 1), (1, 2, 4)), 6.0), (ps.SphereWorkspace((1, 2, 3), 0.5), np.pi / 6)],
)
def test_a_workspace_contains_its_volume(workspace, volume):
    low, high = workspace.bounds_m
    points = low + np.random.default_rng(0).random((20000, 3)) * (high - low)
    assert workspace.contains(points).mean() * np.prod(high - low) == pytest.approx(volume, rel=0.02)
    assert not workspace.contains(np.array([low - 0.01, high + 0.01])).any()


def test_a_function_restricts_a_box():
    box = ps.BoxWorkspace((0, 0, 0), (1, 1, 1))
    half = ps.FunctionWorkspace(lambda points: points[:, 0] < 0.5, box)
    points = np.array([[0.2, 0.5, 0.5], [0.8, 0.5, 0.5], [0.2, 1.5, 0.5]])
    assert half.contains(points).tolist() == [True, False, False]
    with pytest.raises(ArgumentError, match=r"function: must return 3 Booleans, not float64"):
        ps.FunctionWorkspace(lambda points: points[:, 0], box).contains(points)


def test_reachable_positions_are_away_from_surfaces_and_outside_of_them():
    body = sphere((0.0, 0.0, 1.0), 0.5)
    reach = ps.ReachTest(EVERYWHERE, body, 0.1)
    distance = np.array([0.0, 0.3, 0.45, 0.55, 0.58, 0.62, 2.0])
    points = np.array([0.0, 0.0, 1.0]) + distance[:, None] * [0.6, 0.8, 0.0]
    np.testing.assert_array_equal(reach(points), distance > 0.6)
    assert not reach([[3.0, 0.0, -0.1]])


@pytest.mark.long
def test_random_poses_are_uniform_reachable_and_face_the_nearest_target():
    targets = np.array([[-0.5, 1.0, 1.0], [0.5, 1.0, 1.2]])
    reach = ps.ReachTest(ps.SphereWorkspace((0, 0, 1), 0.5), sphere((0.0, 5.0, 1.0), 0.1))
    poses = ps.random_poses(reach, targets, 800, np.random.default_rng(4))
    positions = poses[:, :3, 3]
    assert reach(positions).all()
    # In a ball, the cube of the relative radius is uniform.
    assert kstest((np.linalg.norm(positions - [0, 0, 1], axis=1) / 0.5) ** 3, "uniform").pvalue > 0.01
    nearest = targets[np.linalg.norm(positions[:, None] - targets, axis=2).argmin(axis=1)]
    forward = (nearest - positions) / np.linalg.norm(nearest - positions, axis=1, keepdims=True)
    np.testing.assert_allclose(poses[:, :3, 2], forward, atol=1e-12)
    np.testing.assert_allclose(poses[:, 2, 0], 0.0, atol=1e-12)  # level rows
    same = ps.random_poses(reach, targets, 800, np.random.default_rng(4))
    np.testing.assert_array_equal(poses, same)


def test_lattice_poses_have_their_spacing():
    reach = ps.ReachTest(ps.BoxWorkspace((0, 0, 1), (0.5, 0.2, 1.2)), sphere((0.0, 5.0, 1.0), 0.1))
    positions = ps.lattice_poses(reach, [[0.2, 3.0, 1.0]], 0.1)[:, :3, 3]
    assert len(positions) == 6 * 3 * 3
    for axis, expected in enumerate((np.arange(6) / 10, np.arange(3) / 10, 1 + np.arange(3) / 10)):
        np.testing.assert_allclose(np.unique(positions[:, axis].round(9)), expected)


def test_unreachable_workspaces_are_rejected():
    inside = ps.ReachTest(ps.BoxWorkspace((-0.1, -0.1, 0.9), (0.1, 0.1, 1.1)), sphere((0.0, 0.0, 1.0), 0.5))
    target = [[2.0, 0.0, 1.0]]
    with pytest.raises(ArgumentError, match="random: finds 0 reachable positions of 3 in 150 attempts"):
        ps.random_poses(inside, target, 3, np.random.default_rng(0))
    with pytest.raises(ArgumentError, match=r"spacing: of 0\.1 m gives no reachable position among 27"):
        ps.lattice_poses(inside, target, 0.1)
    with pytest.raises(ArgumentError, match="gives more than 100,000 positions"):
        ps.lattice_poses(inside, target, 1e-4)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: ps.BoxWorkspace((0, 0, 1), (0, 0, 0)), "box: must have finite limits, the lower ones first"),
        (lambda: ps.SphereWorkspace((0, 0, 1), 0.0), "sphere: must have a finite centre and a radius"),
        (lambda: ps.ReachTest(EVERYWHERE, sphere((0, 0, 1), 0.1), -1.0), "clearance: must be a finite dist"),
        (lambda: ViewpointOptions(random=5, spacing_m=0.1), "spacing: cannot be combined with random"),
        (lambda: ViewpointOptions(views=-1), "views: must be at least 0, not -1"),
    ],
)
def test_invalid_options_are_rejected(make, message):
    with pytest.raises(ArgumentError, match=message):
        make()


def test_no_planner_is_better_than_the_oracle_for_the_first_view(scene, observer, camera):
    reach = ps.ReachTest(AISLE, scene.mesh, 0.03)
    poses = ps.random_poses(reach, observer.points.skin_centres, 40, np.random.default_rng(2))
    arc = poses[[5, 1, 7, 3]]
    found = ps.compare_planners(observer, camera, poses, arc, np.random.default_rng(3), draws=20)
    assert found.random.shape == (20, 4)
    assert np.all(found.random[:, 0] <= found.oracle[0])
    assert found.arc[0] <= found.oracle[0]
    for coverage in (*found.random, found.arc, found.oracle):
        assert np.all(np.diff(coverage) >= 0.0)
        assert coverage[-1] <= found.most
    # The arc's poses are among the candidates, whose coverage is known.
    seen = observer.observe(camera, poses)
    np.testing.assert_allclose(found.arc, ps.view_coverage(seen, [5, 1, 7, 3]))
    np.testing.assert_allclose(found.oracle, ps.view_coverage(seen, found.views.poses))
    with pytest.raises(ArgumentError, match="arc: must have from 1 to 3 poses, not 4"):
        ps.compare_planners(observer, camera, poses[:3], arc, np.random.default_rng(3))


def test_a_table_has_what_cameras_see(resolved, tmp_path, camera, observer):
    poses = [ps.look_at([x, -0.5, 1.3], [0.0, 0.0, 1.2]) for x in (-0.2, 0.0, 3.0)]
    ps.write_poses(tmp_path / "robot.csv", ps.PoseList(np.array(poses), names=("a", "b", "c")), "csv")
    options = ViewpointOptions(tmp_path / "robot.csv", workspace=AISLE, views=2, samples=256)
    path = tmp_path / "deep" / "table.parquet"
    (scene,) = scenes = list(recipe_visibility(resolved, options))
    assert write_visibility(path, resolved, options, scenes) == len(scene.visibility)
    table = parquet.read_table(path)
    assert table.column_names == list(COLUMNS)
    assert b'"samples": 256' in table.schema.metadata[METADATA_KEY]
    rows = table.to_pylist()
    expected = observer.observe(camera, poses, occluders=True)
    assert [row["pose"] for row in rows] == expected.pose_index.tolist()
    assert [row["instance"] - 1 for row in rows] == expected.fruit[expected.fruit_index].tolist()
    assert {row["name"] for row in rows} <= {"a", "b", "c"}
    assert {(row["pose"], row["reachable"]) for row in rows} <= {(0, True), (1, True), (2, False)}
    for number, row in enumerate(rows):
        assert row["visible_fraction"] == expected.visible_fraction[number]
        assert sum(row["occluder_fractions"]) + row["visible_fraction"] == pytest.approx(1.0)
        classes = [scene.instances[one - 1].class_id for one in row["occluder_instances"]]
        assert row["occluder_classes"] == classes
        assert (row["peduncle_visible_fraction"] is None) == np.isnan(
            expected.peduncle_visible_fraction[number]
        )
    # One best pose for each fruit that is seen, and two poses with a rank at most.
    best = [row["instance"] for row in rows if row["best"]]
    assert sorted(best) == sorted(
        {row["instance"] for row in rows if row["surface_fraction"] and row["reachable"]}
    )
    assert {row["view"] for row in rows} <= {1, 2, None}


def test_frames_are_observed_by_their_own_cameras(resolved):
    options = ViewpointOptions(samples=64, occluders=False)
    first, second = recipe_visibility(resolved, options, [1, 2, 8])
    assert (first.frames, second.frames) == ((1, 2), (8,))
    frames = ps.FrameRenderer(resolved)
    for scene in (first, second):
        expected = [frames.camera(resolved.recipe.plan.frame(index)).pose for index in scene.frames]
        np.testing.assert_array_equal(scene.visibility.poses, expected)
        assert scene.visibility.occluders is None
    with pytest.raises(ArgumentError, match="views: needs frames of one scene and camera, not of 2"):
        list(recipe_visibility(resolved, ViewpointOptions(views=1), [1, 8]))


def test_random_views_of_a_recipe_are_observed():
    views = {"kind": "random", "target": "fruit", "distance_mm": [250, 400]}
    resolved = resolve_recipe("barth2018", {**CHANGES, "views": views})
    (scene,) = recipe_visibility(resolved, ViewpointOptions(samples=64), [0, 1])
    # Each looks at a fruit.
    assert set(scene.visibility.pose_index) == {0, 1}
    assert scene.visibility.visible_fraction.max() > 0.0
