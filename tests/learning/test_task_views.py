"""Next best view: conditions of the task, planners against an exhaustive search, bad planners."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest
from commands import run

import pepperscene as ps
from pepperscene.errors import ArgumentError, InputError
from pepperscene.frame import Frame
from pepperscene.learning.tasks import view_task
from pepperscene.learning.tasks.view_planners import (
    VOXEL_M,
    PlanningState,
    VoxelMap,
    VoxelPlanner,
    arc_planner,
    random_planner,
)
from pepperscene.learning.tasks.view_scenes import ViewTask, covered_fraction, view_scenes
from pepperscene.learning.tasks.view_task import ORACLE
from pepperscene.recipe.resolve.load import resolve_recipe

SMALL = {
    "cultivar": "kaite_february", "row": {"plants_front": 1, "plants_back": 0},
    "plan": {"sets": 1, "rotations": 1, "frames": 2}, "camera.width": 200, "camera.height": 150,
}  # fmt: skip
TASK = ViewTask(ps.BoxWorkspace((-0.4, -0.7, 0.5), (0.4, -0.3, 1.6)), candidates=12, views=4, samples=128)
FRUIT = 2


@pytest.fixture(scope="module")
def scene():
    (only,) = view_scenes(resolve_recipe("barth2018", SMALL), TASK)
    return only


@pytest.fixture(scope="module")
def plan(scene):
    """Function that plans views of the scene, which is grown once, by planners."""

    def plan_scene(**planners):
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(view_task, "view_scenes", lambda *_: iter([scene]))
            return view_task.plan_views(resolve_recipe("barth2018", SMALL), planners, TASK)

    return plan_scene


@pytest.fixture(scope="module")
def planned(plan):
    return plan(arc=arc_planner, random=random_planner, voxels=VoxelPlanner())


def camera(width=80, height=60):
    sensor = ps.load_sensor("realsense_d435_colour").with_size(width, height)
    return ps.Camera(ps.load_lens("realsense_d435_colour"), sensor)


def state_of(candidates, taken, frames=None, views=3, arc=(0, 1, 2)):
    box = ps.BoxWorkspace((-0.4, -0.2, 0.8), (0.4, 0.2, 1.2))
    return PlanningState(
        np.array(candidates), camera(), box, tuple(taken), views, arc, np.random.default_rng(0),
        lambda number: frames[number],
    )  # fmt: skip


def wall(camera, pose, y, classes=FRUIT):
    """Labels of a wall across the row, at one y."""
    rays = camera.pixel_directions() @ pose[:3, :3].T
    along = (y - pose[1, 3]) / rays[..., 1]
    depth = along * (rays @ pose[:3, 2])
    return Frame({"depth_z": depth.astype(np.float32), "class": np.full(depth.shape, classes, np.uint8)}, {})


def test_planners_start_alike_and_the_arc_is_taken_from_one_end(scene, planned):
    views, most = planned
    for result in views.values():
        assert result.views[0][0] == scene.start
        assert result.coverage.shape == (1, TASK.views)
        assert (np.diff(result.coverage) >= 0).all()
        assert result.coverage[0, 0] == views[ORACLE].coverage[0, 0]
        assert result.coverage[0, -1] <= most[0]
    rest = [number for number in scene.arc if number != scene.start]
    assert list(views["arc"].views[0][1:]) == rest[: TASK.views - 1]
    for name in ("random", "voxels"):
        assert len(set(views[name].views[0])) == TASK.views


def test_the_oracle_takes_the_best_second_view_and_is_near_the_best_set(scene, planned):
    coverage = planned[0][ORACLE].coverage[0]
    seen, fruit = scene.visibility, scene.fruit
    points = np.zeros((len(scene.candidates), len(seen.fruit), TASK.samples), bool)
    points[seen.pose_index, seen.fruit_index] = np.unpackbits(seen.seen, axis=1)
    best = max(points[[scene.start, other]].any(axis=0)[fruit].mean() for other in range(len(points)))
    assert coverage[1] == pytest.approx(best)
    assert covered_fraction(scene, [scene.start])[0] == pytest.approx(points[scene.start][fruit].mean())
    # Nemhauser, Wolsey & Fisher 1978, of what the start does not see.
    sets = combinations(range(len(scene.candidates)), TASK.views - 1)
    best = max(points[[scene.start, *some]].any(axis=0)[fruit].mean() for some in sets)
    assert coverage[-1] - coverage[0] >= (1 - 1 / np.e) * (best - coverage[0])


def test_only_fruit_opposite_the_workspace_counts(scene):
    from pepperscene.render.viewpoints import FruitObserver

    centres = FruitObserver(scene.scene, 64).points.skin_centres
    inside = TASK.target.contains(centres)
    np.testing.assert_array_equal(scene.fruit, np.flatnonzero(inside))
    assert 0 < inside.sum() < len(inside)


def test_candidates_are_reachable_and_face_the_target_without_knowledge_of_fruit(scene):
    positions = scene.candidates[:, :3, 3]
    reach = ps.ReachTest(TASK.box, scene.scene.mesh, TASK.clearance_m)
    assert reach(positions).all()
    assert len(positions) == len(scene.arc) + TASK.candidates
    # Each axis passes through the target box.
    steps = np.linspace(0, 2, 400)
    for pose in scene.candidates[len(scene.arc) :]:
        assert TASK.target.contains(pose[:3, 3] + steps[:, None] * pose[:3, 2]).any()
    (again,) = view_scenes(resolve_recipe("barth2018", SMALL), TASK)
    np.testing.assert_array_equal(again.candidates, scene.candidates)


def test_observations_are_label_frames_of_the_candidate(scene):
    frame = scene.observe(scene.start)
    expected = ps.Renderer(scene.scene).render(
        scene.camera.at_pose(scene.candidates[scene.start]), ("class", "depth_z")
    )
    np.testing.assert_array_equal(frame["class"], expected["class"])
    np.testing.assert_array_equal(frame["depth_z"], expected["depth_z"])


def test_a_map_has_free_voxels_before_a_wall_and_unknown_ones_behind_it():
    pose = ps.look_at((0.0, -0.6, 1.0), (0.0, 0.0, 1.0))
    state = state_of([pose], [0], [wall(camera(), pose, 0.011)])
    voxels = VoxelMap(*state.target.bounds_m)
    voxels.add(state)
    middle = np.abs(voxels.centres[:, [0, 2]] - [0, 1]).max(axis=1) < 0.1
    y = voxels.centres[:, 1]
    assert voxels.occupied.reshape(-1)[middle & (np.abs(y - 0.01) < 1e-6)].all()
    assert voxels.fruit.reshape(-1)[middle & (np.abs(y - 0.01) < 1e-6)].all()
    assert voxels.free.reshape(-1)[middle & (y < 0)].all()
    assert not (voxels.free | voxels.occupied).reshape(-1)[y > 0.011 + VOXEL_M].any()


def test_the_voxel_planner_looks_behind_the_fruit_that_it_has_seen():
    front = ps.look_at((0.0, -0.6, 1.0), (0.0, 0.0, 1.0))
    again = ps.look_at((0.05, -0.6, 1.0), (0.0, 0.0, 1.0))
    behind = ps.look_at((0.0, 0.7, 1.0), (0.0, 0.0, 1.0))
    state = state_of([front, again, behind], [0], [wall(camera(), front, 0.011)])
    assert VoxelPlanner()(state) == 2


@pytest.mark.parametrize("number", [lambda state: len(state.candidates), lambda state: 0.5, lambda state: -1])
def test_bad_planners_give_one_sentence(plan, number):
    with pytest.raises(InputError, match=r"mine: must return the number of a candidate, from 0 to \d+, not"):
        plan(mine=number)


def test_bad_conditions_are_rejected():
    for message, conditions in (
        ("views: must be at least 2, not 1", {"views": 1}),
        ("candidates: must be at least 1, not 0", {"candidates": 0}),
        ("box: must be in the aisle", {"box": ps.BoxWorkspace((0, -1, 1), (1, 1, 2))}),
        ("samples: must be a multiple of 64", {"samples": 5}),
    ):
        with pytest.raises(ArgumentError, match=message):
            ViewTask(**conditions)


def test_the_command_scores_a_function_of_the_user(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "own_planner.py").write_text(
        "def farthest(state):\n"
        "    place = state.candidates[:, :3, 3]\n"
        "    seen = place[list(state.taken)]\n"
        "    return int(abs(place[:, None] - seen).sum(axis=2).min(axis=1).argmax())\n"
    )
    done = run(
        "task", "next_best_view", "barth2018", "--method", "own_planner:farthest", "--allow-code",
        "--baseline", "arc", "--views", "3", "--candidates", "8", "--box", "-400,400,-700,-300,500,1600",
        "--set", "cultivar=kaite_february", "--set", "row={plants_front=1, plants_back=0}",
        "--set", "plan={sets=1, rotations=1, frames=2}",
        "--set", "camera.width=120", "--set", "camera.height=90",
    )  # fmt: skip
    assert done.exit_code == 0, done.output
    rows = {
        line.split()[0]: [float(cell) for cell in line.split()[1:]] for line in done.stdout.splitlines()[2:5]
    }
    assert set(rows) == {"arc", "own_planner:farthest", "oracle"}
    # The first view is the same, and the oracle's second is the best.
    assert len({row[0] for row in rows.values()}) == 1
    assert max(row[1] for row in rows.values()) == rows["oracle"][1]
