"""Environments of gymnasium: their interface, repeatability, rewards against other functions, baselines."""

from __future__ import annotations

import sys
from itertools import pairwise

import gymnasium
import numpy as np
import pytest
import row_cache
import trimesh
from gymnasium.utils.env_checker import check_env

import pepperscene as ps
from pepperscene.environments import ENVIRONMENTS, ViewTask
from pepperscene.errors import ArgumentError, InputError, SetupError
from pepperscene.libraries import import_library

CHANGES = {
    "plan.sets": 1, "plan.rotations": 1, "plan.frames": 3, "row.plants_front": 1, "row.plants_back": 1,
    "camera.width": 32, "camera.height": 24,
}  # fmt: skip
VIEWS, REACH = "pepperscene/NextBestView-v0", "pepperscene/Reach-v0"
TASK = ViewTask(candidates=30, views=4, samples=256)
OPTIONS = {VIEWS: {"task": TASK}, REACH: {"image": True, "steps": 40}}


@pytest.fixture(scope="module", autouse=True)
def grown(rows):
    """Scenes that are opened in this process, or started from it, take their rows from the shared folder."""
    with row_cache.rows_from(rows):
        yield


@pytest.fixture(params=[VIEWS, REACH])
def env(request):
    return make(request.param)


def make(name, **options):
    return gymnasium.make(name, **{"changes": CHANGES, **OPTIONS[name], **options}).unwrapped


def episode(env, seed, policy):
    """Steps of an episode: the result of `reset`, then those of `step`."""
    steps = [env.reset(seed=seed)]
    while len(steps) == 1 or not (steps[-1][2] or steps[-1][3]):
        steps.append(env.step(policy()))
    return steps


def random_policy(seed):
    rng = np.random.default_rng(seed)
    return lambda: rng.uniform(-1.0, 1.0, 5).astype(np.float32)


def assert_equal(observation, expected):
    assert observation.keys() == expected.keys()
    for name, values in expected.items():
        np.testing.assert_array_equal(observation[name], values, err_msg=name)


def test_environments_have_the_interface_of_gymnasium(env):
    check_env(env)  # a warning is an error
    assert set(ENVIRONMENTS) <= set(gymnasium.registry)


@pytest.mark.parametrize("count", [100, pytest.param(1000, marks=pytest.mark.long)])
def test_random_steps_give_observations_of_the_space(env, count):
    env.reset(seed=1)
    policy = random_policy(2)
    for number in range(count):
        observation, reward, is_over, is_late, _ = env.step(policy())
        assert env.observation_space.contains(observation)
        assert np.isfinite(reward)
        if is_over or is_late:
            env.reset(seed=number)


@pytest.mark.parametrize("name", [VIEWS, REACH])
def test_the_same_seed_gives_the_same_episode_in_another_process(name):
    steps, policy = episode(make(name), 7, random_policy(3)), random_policy(3)
    others = gymnasium.make_vec(
        name, 1, "async", vector_kwargs={"context": "spawn"}, changes=CHANGES, **OPTIONS[name]
    )
    try:
        observation, _ = others.reset(seed=7)
        assert_equal({key: values[0] for key, values in observation.items()}, steps[0][0])
        for expected in steps[1:]:
            observation, reward, is_over, is_late, _ = others.step(policy()[None])
            assert_equal({key: values[0] for key, values in observation.items()}, expected[0])
            assert (reward[0], is_over[0], is_late[0]) == expected[1:4]
    finally:
        others.close()


def test_another_seed_gives_another_episode(env):
    first, second = (env.reset(seed=seed)[0] for seed in (1, 2))
    assert any(not np.array_equal(first[name], second[name]) for name in first)


def test_rewards_of_views_are_gains_of_coverage():
    env = make(VIEWS)
    steps = episode(env, 5, random_policy(5))
    assert len(steps) == TASK.views
    # Coverage of the same poses in the scene as a build grows it.
    recipe = ps.load_recipe("barth2018", CHANGES)
    frames, spec = ps.FrameRenderer(recipe, culled=False), recipe.plan.frame(0)
    scene = frames.scene(spec, traced=False)
    observer = ps.FruitObserver(scene, TASK.samples)
    ripe = {one.index for one in ps.Renderer(scene).fruit_truths() if one.measures["ripeness"] >= 0.5}
    counts = np.isin(observer.points.fruit, list(ripe)) & TASK.target.contains(observer.points.skin_centres)
    seen = observer.observe(frames.camera(spec, traced=False), env._poses)
    coverage = ps.view_coverage(seen, range(TASK.views), fruit=np.flatnonzero(counts))
    assert steps[0][1]["ripe"] == counts.sum() > 0
    np.testing.assert_allclose([step[-1]["coverage"] for step in steps], coverage, atol=1e-12)
    np.testing.assert_allclose([step[1] for step in steps[1:]], np.diff(coverage), atol=1e-12)
    assert coverage[-1] > 0.0


def test_observations_of_views_are_those_of_the_scene():
    env = make(VIEWS)
    steps = episode(env, 5, random_policy(5))
    observation, info = steps[-1][0], steps[-1][-1]
    low, high = TASK.box.bounds_m
    pose = env._poses[-1]
    np.testing.assert_allclose(low + (observation["pose"][:3] + 1) / 2 * (high - low), pose[:3, 3], atol=1e-6)
    yaw, pitch = observation["pose"][3:] * np.radians([90.0, 60.0])
    forward = np.array([np.sin(yaw) * np.cos(pitch), np.cos(yaw) * np.cos(pitch), np.sin(pitch)])
    np.testing.assert_allclose(ps.look_at(pose[:3, 3], pose[:3, 3] + forward), pose, atol=1e-5)
    frame = env.scene.render(pose)
    np.testing.assert_array_equal(observation["class"], frame["class"])
    np.testing.assert_array_equal(observation["depth"], np.minimum(frame["depth_z"], 3.0))
    # A row for each fruit that was found.
    is_row = observation["fruit"].any(axis=1)
    assert is_row.sum() == info["found"] > 0
    shares = observation["fruit"][is_row, 3]
    assert shares.sum() / info["ripe"] == pytest.approx(info["coverage"], abs=1e-6)
    assert (observation["fruit"][is_row, 4] >= 0.5).all()


def test_greedy_views_see_more_than_random_ones():
    env = make(VIEWS)
    rng = np.random.default_rng(1)
    policies = {"random": random_policy(1), "arc": env.arc_action, "greedy": lambda: env.greedy_action(rng)}
    reached = {
        name: np.mean([episode(env, seed, policy)[-1][-1]["coverage"] for seed in range(3)])
        for name, policy in policies.items()
    }
    assert reached["greedy"] > max(reached["random"], reached["arc"])


def test_cameras_do_not_enter_organs():
    # The box has the row in it, so that many positions are not free.
    inside = ViewTask(ps.BoxWorkspace((-0.3, -0.3, 1.0), (0.3, -0.01, 1.6)), candidates=5, samples=64)
    env = make(VIEWS, task=inside)
    episode(env, 1, random_policy(1))
    positions = np.array(env._poses)[:, :3, 3]
    assert (env.scene.nearest(positions)[0] >= inside.clearance_m - 1e-6).all()
    assert len(np.unique(positions, axis=0)) < len(positions)


def test_straight_motions_come_nearer_than_random_ones():
    env = make(REACH, image=False, steps=40)
    reached = {
        name: [episode(env, seed, policy)[-1][-1]["distance_m"] for seed in range(4)]
        for name, policy in (("random", random_policy(1)), ("straight", env.straight_action))
    }
    assert np.mean(reached["straight"]) < np.mean(reached["random"])


def test_rewards_of_the_tool_add_up_to_its_progress():
    env = make(REACH, image=False, steps=60)
    for seed in range(4):
        steps = episode(env, seed, env.straight_action)
        info = steps[-1][-1]
        start, end = (one["distance_m"] + 0.05 * one["angle_rad"] for one in (steps[0][1], info))
        expected = (start - end) / start - 0.05 * info["touches"] + info["is_success"]
        assert sum(step[1] for step in steps[1:]) == pytest.approx(expected, abs=1e-9)
        assert np.linalg.norm(steps[-1][0]["state"][:3]) == pytest.approx(info["distance_m"], abs=1e-6)
        assert info["is_success"] == (info["distance_m"] <= 0.02 and info["angle_rad"] <= np.radians(20))
        assert steps[-1][2] == (info["is_success"] or info["touches"] == 10)
        # The tool's speed is limited.
        for one, other in pairwise(steps):
            assert abs(one[-1]["distance_m"] - other[-1]["distance_m"]) <= np.sqrt(3) * 0.012 + 1e-9


def test_a_tool_touches_what_is_at_its_place_except_leaves_and_the_stalk():
    env = make(REACH, image=False)
    for seed in range(3):
        env.reset(seed=seed)
        # It is 20 cm long behind its tip, and 12 mm thick.
        axis, right = env._axes()[:, 2], env._axes()[:, 0]
        for along, aside, touches in (
            (0.003, 0.0, True), (0.008, 0.0, False), (-0.1, 0.01, True), (-0.1, 0.013, False),
            (-0.2, 0.0, True), (-0.207, 0.0, False),
        ):  # fmt: skip
            ball = trimesh.creation.icosphere(3, 0.005)
            ball.apply_translation(env._tip + along * axis + aside * right)
            number = env.scene.add(ball)
            assert env._touches(env._tip, env._turn) == ((number,) if touches else ())
            env.scene.remove(number)
    kinds = {one.instance: one.kind for one in env.scene.organs}
    assert {kinds[number] for number in env._leaves} == {"lamina", "shoot_lamina"}
    # A tool in the stalk touches no stalk.
    assert env._target.stalk not in env._touches(env._cut, env._turn)


@pytest.mark.parametrize(
    ("name", "options", "message"),
    [
        (VIEWS, {"recipe": "nowhere"}, "nowhere"),
        (VIEWS, {"scenes": 2}, "scenes: must be a whole number from 1 to 1, not 2"),
        (VIEWS, {"scenes": 1.0}, "scenes: must be a whole number"),
        (VIEWS, {"ripeness": 2.0}, "ripeness: must be from 0 to 1"),
        (VIEWS, {"ripeness": np.nan}, "ripeness: must be from 0 to 1"),
        (VIEWS, {"task": 3}, "task: must be a ViewTask, not int"),
        (VIEWS, {"changes": {"row.plants": 2}}, r"row\.plants"),
        (REACH, {"steps": 1}, "steps: must be a whole number"),
        (REACH, {"steps": "many"}, "steps: must be a whole number"),
    ],
)
def test_invalid_options_are_refused_in_a_sentence(name, options, message):
    with pytest.raises(InputError, match=message) as caught:
        make(name, **options)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("action", [None, "left", np.zeros(4), np.full(5, np.nan), [1, 2, 3, 4, None]])
def test_invalid_actions_and_options_of_reset_are_refused(env, action):
    observation, _ = env.reset(seed=1)
    with pytest.raises(ArgumentError, match="action: must be 5 finite numbers"):
        env.step(action)
    with pytest.raises(ArgumentError, match="options"):
        env.reset(options={"scene": 3})
    assert_equal(env.reset(seed=1)[0], observation)


def test_scenes_without_ripe_fruit_are_refused():
    places = {VIEWS: "opposite the workspace in scene 0", REACH: "with an approach from the aisle"}
    for name, where in places.items():
        with pytest.raises(InputError, match=f"barth2018: has no ripe fruit {where}"):
            make(name, ripeness=1.0).reset(seed=1)


def test_the_extra_is_named_where_gymnasium_is_missing(monkeypatch):
    monkeypatch.setitem(sys.modules, "gymnasium", None)
    with pytest.raises(SetupError, match=r"needs gymnasium.*pepperscene\[gym\]"):
        import_library("gymnasium", "gym")
