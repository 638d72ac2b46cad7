"""View planning on random sets of seen points, against an exhaustive search."""

from itertools import combinations

import numpy as np
import pytest

from pepperscene.errors import ArgumentError
from pepperscene.truth.fruit_visibility import FruitVisibility, Occluders
from pepperscene.truth.view_planning import exact_views, greedy_views, view_coverage

POSES, FRUIT, SAMPLES = 12, 4, 64


def visibility(points):
    """The visibility of `(poses, fruit, samples)` Boolean points; pairs without a seen point have no row."""
    pose, fruit = np.nonzero(points.any(axis=2))
    seen = points[pose, fruit]
    fraction = seen.mean(axis=1)
    return FruitVisibility(
        poses=np.tile(np.eye(4), (len(points), 1, 1)),
        fruit=np.arange(points.shape[1]) + 10,
        peduncle=np.full(points.shape[1], -1),
        pose_index=pose,
        fruit_index=fruit,
        visible_fraction=fraction,
        facing_fraction=fraction,
        surface_fraction=fraction,
        visible_pixels=fraction,
        peduncle_visible_fraction=np.full(len(pose), np.nan),
        cut_visible_fraction=np.full(len(pose), np.nan),
        seen=np.packbits(seen, axis=1),
        occluders=Occluders(np.arange(len(pose)), np.arange(len(pose)), fraction),
    )


@pytest.fixture(params=range(3))
def points(request):
    """Seen points; each pose sees a piece of some of the fruit."""
    rng = np.random.default_rng(request.param)
    start, length = rng.integers(0, SAMPLES, (2, POSES, FRUIT, 1))
    in_piece = (np.arange(SAMPLES) - start) % SAMPLES < length // 2
    return in_piece & (rng.random((POSES, FRUIT, 1)) < 0.6)


def union(points, poses):
    return points[list(poses)].any(axis=0).mean()


@pytest.mark.parametrize("count", [1, 2, 4])
def test_exact_views_are_those_of_an_exhaustive_search(points, count):
    best = max(union(points, chosen) for chosen in combinations(range(POSES), count))
    found = exact_views(visibility(points), count)
    assert len(found.poses) == count
    assert found.coverage[-1] == pytest.approx(best)
    assert union(points, found.poses) == pytest.approx(best)


def test_each_next_view_adds_most(points):
    found = greedy_views(visibility(points), 6)
    for number, pose in enumerate(found.poses):
        before = found.poses[:number]
        gains = [union(points, [*before, other]) for other in range(POSES)]
        assert gains[pose] == pytest.approx(max(gains))
        assert pose == np.flatnonzero(np.isclose(gains, max(gains)))[0]
        assert found.coverage[number] == pytest.approx(max(gains))


def test_the_first_view_of_one_fruit_is_its_best_pose(points):
    seen = visibility(points)
    for fruit, best in enumerate(seen.best_poses()):
        shares = points[:, fruit].mean(axis=1)
        assert best == (shares.argmax() if shares.any() else -1)
        if best >= 0:
            found = greedy_views(seen, 1, fruit=[fruit])
            assert (found.poses[0], found.coverage[0]) == (best, shares.max())


def test_views_that_were_taken_count_as_seen(points):
    whole = greedy_views(visibility(points), 5)
    rest = greedy_views(visibility(points), 3, taken=whole.poses[:2].tolist())
    np.testing.assert_array_equal(rest.poses, whole.poses[2:])
    np.testing.assert_allclose(rest.coverage, whole.coverage[2:])


def test_coverage_is_that_of_the_union(points):
    order = np.random.default_rng(0).permutation(POSES)
    coverage = view_coverage(visibility(points), order, fruit=[1, 3])
    expected = [union(points[:, [1, 3]], order[: number + 1]) for number in range(POSES)]
    np.testing.assert_allclose(coverage, expected)


def test_excluded_poses_are_neither_best_nor_next(points):
    allowed = np.arange(POSES) % 2 == 1
    seen = visibility(points).of_poses(allowed)
    assert set(seen.pose_index) <= set(range(1, POSES, 2))
    assert len(seen.poses) == POSES
    assert np.all(greedy_views(seen, 3).poses % 2 == 1)
    assert np.all(seen.best_poses()[seen.best_poses() >= 0] % 2 == 1)
    np.testing.assert_array_equal(seen.occluders.row, np.arange(len(seen)))
    np.testing.assert_array_equal(seen.occluders.fraction, seen.surface_fraction)


def test_invalid_arguments_are_rejected(points):
    seen = visibility(points)
    with pytest.raises(ArgumentError, match="count: must be at least 1, not 0"):
        greedy_views(seen, 0)
    with pytest.raises(ArgumentError, match="must be from 1 to the 12 poses"):
        exact_views(seen, 13)
    with pytest.raises(ArgumentError, match="numbers of the 4 fruit"):
        greedy_views(seen, 1, fruit=[4])
    with pytest.raises(ArgumentError, match="numbers of the 12 poses"):
        view_coverage(seen, [12])
    many = visibility(np.ones((200, 1, 64), dtype=bool))
    with pytest.raises(ArgumentError, match="use greedy_views"):
        exact_views(many, 10)
