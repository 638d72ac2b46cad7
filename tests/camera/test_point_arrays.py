"""Points and poses of other shapes are understood or rejected, never read as other points."""

from __future__ import annotations

import numpy as np
import pytest

import pepperscene as ps
from pepperscene.camera import Camera, load_lens, load_sensor, look_at
from pepperscene.errors import ArgumentError
from pepperscene.geometry import sphere
from pepperscene.truth.fruit_visibility import FruitVisibility

BOX = ps.BoxWorkspace((-1.0, -1.0, -1.0), (1.0, 1.0, 1.0))
BALL = ps.SphereWorkspace((0.0, 0.0, 0.0), 1.0)
REACH = ps.ReachTest(BOX, sphere((0.0, 5.0, 0.0), 0.1))
POSES = np.stack([look_at(point, (0.0, 5.0, 0.5)) for point in ((0, 0, 0.5), (0, 0, 3.0), (0.5, 0, 0.5))])
FOUR_BY_FOUR = np.ones((4, 4))


def no_views() -> FruitVisibility:
    none, rows = np.zeros(0, np.intp), np.zeros(0)
    seen = np.zeros((0, 8), np.uint8)
    return FruitVisibility(POSES, np.arange(1), none, none, none, rows, rows, rows, rows, rows, rows, seen)


def test_reach_of_poses_is_that_of_their_positions():
    expected = [True, False, True]
    assert REACH(POSES).tolist() == expected
    assert REACH(POSES[:, :3, 3]).tolist() == expected
    assert REACH(POSES[0]).tolist() == [True]
    assert REACH(POSES[1, :3, 3]).tolist() == [False]
    assert REACH([]).shape == REACH(np.zeros((0, 4, 4))).shape == REACH(np.zeros((0, 3))).shape == (0,)


def camera() -> Camera:
    return Camera(load_lens("realsense_d435_infrared"), load_sensor("realsense_d435_infrared"))


@pytest.mark.parametrize(
    "call",
    [
        pytest.param(lambda: REACH(np.ones((3, 2))), id="reach-2d"),
        pytest.param(lambda: REACH(np.ones((3, 3, 4))), id="reach-3x4"),
        pytest.param(lambda: REACH(np.ones(12)), id="reach-flat"),
        pytest.param(lambda: REACH([["a", "b", "c"]]), id="reach-text"),
        pytest.param(lambda: BOX.contains(POSES), id="box"),
        pytest.param(lambda: BALL.contains(POSES[:, :3]), id="ball"),
        pytest.param(lambda: ps.FunctionWorkspace(lambda p: p[:, 0] < 0, BOX).contains(POSES), id="function"),
        pytest.param(lambda: ps.random_poses(REACH, POSES, 2, np.random.default_rng(0)), id="random-targets"),
        pytest.param(lambda: ps.random_poses(REACH, [], 2, np.random.default_rng(0)), id="random-no-target"),
        pytest.param(lambda: ps.lattice_poses(REACH, FOUR_BY_FOUR[:3], 0.5), id="lattice-targets"),
        pytest.param(lambda: camera().project(POSES), id="project-poses"),
        pytest.param(lambda: camera().project(np.ones((3, 4))), id="project-homogeneous"),
        pytest.param(lambda: ps.view_coverage(no_views(), POSES), id="coverage-poses"),
        pytest.param(lambda: ps.greedy_views(no_views(), 1, taken=[0.7]), id="taken-fraction"),
    ],
)
def test_other_shapes_are_rejected(call):
    with pytest.raises(ArgumentError, match=r"must (have the shape|be numbers|be at least one)"):
        call()


@pytest.mark.parametrize(
    "call",
    [
        lambda: look_at(POSES[0, :3], (0.0, 1.0, 0.0)),
        lambda: look_at(np.zeros((1, 3)), (0.0, 1.0, 0.0)),
        lambda: look_at((0.0, 0.0), (0.0, 1.0)),
        lambda: sphere((0, 0, 0), 0.1).moved(np.eye(3), np.zeros((1, 3))),
        lambda: sphere((0, 0, 0), 0.1).moved(np.eye(4), np.zeros(3)),
    ],
)
def test_arguments_of_one_point_have_three_coordinates(call):
    with pytest.raises(ValueError, match=r"three coordinates|rotation must be \(3, 3\)"):
        call()
