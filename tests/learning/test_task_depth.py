"""Depth completion: errors against closed forms and other libraries, baselines on planes, bad predictions."""

from __future__ import annotations

import json

import cv2
import numpy as np
import pytest
from commands import rejected, run
from task_sets import D435, paint_depth, painted_set

from pepperscene.errors import InputError
from pepperscene.learning.tasks import evaluate_depth
from pepperscene.learning.tasks.depth_baselines import BASELINES
from pepperscene.learning.tasks.depth_task import depth_regions, error_sums, errors_of_sums, organ_borders

OUTPUTS = ("colour", "instance", "depth_z", "depth_sensor")
TEST = (2, 3)  # the second of two sets of plants


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return painted_set(tmp_path_factory.mktemp("depth") / "set", OUTPUTS, paint_depth, D435).folder


def truth_of(folder, index):
    from pepperscene.dataset.store.dataset import open_dataset

    return open_dataset(folder).image(index, "depth_z")


def write_predictions(folder, path, change=lambda depth: depth, frames=TEST):
    path.mkdir()
    for index in frames:
        depth = truth_of(folder, index)
        np.save(path / f"{index:06d}.npy", change(np.where(np.isfinite(depth), depth, 0)))
    return path


def measures(prediction, truth):
    mask = np.ones(truth.shape, bool)
    return errors_of_sums(error_sums(prediction, truth, mask), truth.size)


def test_errors_have_their_closed_forms():
    rng = np.random.default_rng(0)
    truth = rng.uniform(0.3, 1.5, (9, 11))
    for prediction in (truth, truth - 0.02, truth + 0.02, truth * rng.uniform(0.8, 1.2, truth.shape)):
        error, found = prediction - truth, measures(prediction, truth)
        assert found["rmse_mm"] == pytest.approx(1e3 * np.sqrt((error**2).mean()))
        assert found["mae_mm"] == pytest.approx(1e3 * np.abs(error).mean())
        assert found["rel"] == pytest.approx((np.abs(error) / truth).mean())
    for scale, within in ((1, (1, 1, 1)), (1.049, (1, 1, 1)), (1 / 1.09, (0, 1, 1)), (1.3, (0, 0, 0))):
        found = measures(scale * truth, truth)
        assert (found["within_1.05"], found["within_1.10"], found["within_1.25"]) == within


def test_regions_are_those_of_holes_and_borders():
    truth = np.full((6, 8), 0.7, np.float32)
    truth[0], truth[1] = np.inf, 2.0
    sensor = truth.copy()
    sensor[3, 5] = np.nan
    instances = np.ones((6, 8), np.uint16)
    instances[:, 4:] = 2
    regions = depth_regions(truth, sensor, instances, 1.5)
    assert regions["all"].sum() == 4 * 8
    assert np.argwhere(regions["holes"]).tolist() == [[3, 5]]
    assert regions["measured"].sum() == 4 * 8 - 1
    np.testing.assert_array_equal(organ_borders(instances, 1).all(axis=0), [0, 0, 0, 1, 1, 0, 0, 0])
    np.testing.assert_array_equal(organ_borders(instances, 3).all(axis=0), [0, 1, 1, 1, 1, 1, 1, 0])
    assert regions["borders"].sum() == 4 * 6


@pytest.mark.parametrize("name", BASELINES)
def test_baselines_fill_a_plane_exactly_also_from_a_single_pixel(name):
    sensor = np.full((40, 50), 0.6, np.float32)
    sensor[10:25, 5:20] = sensor[:4] = np.nan
    colour = np.random.default_rng(0).integers(0, 256, (40, 50, 3)).astype(np.uint8)
    np.testing.assert_allclose(BASELINES[name](colour, sensor), 0.6, atol=1e-5)
    sensor = np.full((40, 50), np.nan, np.float32)
    sensor[30, 45] = 0.7
    depth = BASELINES[name](colour, sensor)
    assert np.isfinite(depth).all()
    if name != "navier_stokes":
        np.testing.assert_allclose(depth, 0.7, atol=1e-5)


def test_the_guided_filter_follows_the_colours():
    images = paint_depth(3, (60, 80))
    hole = np.isnan(images["depth_sensor"]) & np.isfinite(images["depth_z"])

    def error(name):
        found = BASELINES[name](images["colour"], images["depth_sensor"].copy())
        return np.abs(found - images["depth_z"])[hole].max()

    # The border is where the colours change, which a method without the photograph cannot know.
    assert error("guided_filter") < 0.02
    assert error("navier_stokes") > 0.1


def test_ip_basic_gives_holes_the_nearest_surface_around():
    sensor = np.full((40, 60), 1.0, np.float32)
    sensor[:, 30:] = 0.5
    sensor[15:25, 20:40] = np.nan
    depth = BASELINES["ip_basic"](np.zeros((40, 60, 3), np.uint8), sensor)
    assert depth[20, 31:].max() == pytest.approx(0.5, abs=1e-6)
    # Its diamond of five pixels makes near surfaces two pixels larger.
    assert depth[5, 28] < 0.75 < depth[5, 25]
    assert BASELINES["nearest"](np.zeros((40, 60, 3), np.uint8), sensor)[5, 29] == 1.0


def test_perfect_predictions_score_zero_in_all_regions_of_the_test_plants(folder, tmp_path):
    result = evaluate_depth(folder, {}, [write_predictions(folder, tmp_path / "mine")])
    for region in ("all", "holes", "measured", "borders"):
        found = result.score("mine", region)
        assert found["rmse_mm"] == 0
        assert found["share"] > 0
    assert result.score("mine", "holes")["share"] + result.score("mine", "measured")["share"] == 1
    assert "2 frames" in result.title


@pytest.mark.parametrize("suffix", ["exr", "png"])
def test_predictions_can_be_exr_in_metres_or_png_in_millimetres(folder, tmp_path, suffix):
    from pepperscene.dataset.store.images import write_image

    (tmp_path / "mine").mkdir()
    for index in TEST:
        depth = truth_of(folder, index) + np.float32(0.004)
        path = tmp_path / "mine" / f"{index:06d}.{suffix}"
        if suffix == "exr":
            write_image(path, depth, "depth_z")
        else:
            millimetres = np.where(np.isfinite(depth), np.rint(1e3 * depth), 0)
            cv2.imwrite(str(path), millimetres.astype(np.uint16))
    found = evaluate_depth(folder, {}, [tmp_path / "mine"]).score("mine", "all")
    assert found["rmse_mm"] == pytest.approx(4, abs=0.01)


def test_the_command_prints_a_table_of_baselines_and_predictions(folder, tmp_path):
    mine = write_predictions(folder, tmp_path / "mine", lambda depth: depth + 0.01)
    arguments = ("task", "depth_completion", folder, "--baseline", "nearest", "--predictions", mine)
    done = run(*arguments)
    assert done.exit_code == 0, done.output
    lines = done.stdout.splitlines()
    assert lines[0].startswith("Depth completion: set, 2 frames, surfaces up to 1.5 m")
    row = next(line.split() for line in lines if line.startswith("mine") and " all " in line)
    assert row[:5] == ["mine", "all", "100.0", "10.0", "10.0"]
    content = json.loads(run(*arguments, "--json").stdout)
    assert {score["method"] for score in content["scores"]} == {"sensor", "nearest", "mine"}


def test_a_function_of_the_user_is_scored(folder, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "own_depth.py").write_text(
        "import numpy as np\n\n\ndef fill(colour, sensor):\n    return np.nan_to_num(sensor, nan=0.5)\n"
        "\n\ndef fails(colour, sensor):\n    return sensor\n"
    )
    words = ("task", "depth_completion", folder, "--allow-code", "--method")
    done = run(*words, "own_depth:fill")
    assert done.exit_code == 0, done.output
    assert "own_depth:fill" in done.stdout
    assert rejected(*words, "own_depth:fails") == (
        "error: own_depth:fails: must return a finite depth above 0 for each pixel that counts\n"
    )


def _with_nan(depth):
    depth[12, 3] = np.nan
    return depth


def test_bad_predictions_give_one_sentence(folder, tmp_path):
    for number, (change, frames, message) in enumerate(
        (
            (lambda depth: depth[:-1], TEST, "000002.npy: must be 24 rows x 32 columns as the frame, not 23"),
            (lambda depth: depth, TEST[:1], "no prediction for frame 3: 000003 with .npy, .exr or .png"),
            (_with_nan, TEST, "in each pixel that counts, not nan at row 12, column 3"),
            (lambda depth: 0 * depth, TEST, "must have a finite value above 0 in each pixel that counts"),
            (lambda depth: depth.astype(str), TEST, "000002.npy: must hold numbers, not <U"),
            (lambda depth: np.array([{}]), TEST, "000002.npy: cannot be read as an array"),
        )
    ):
        mine = write_predictions(folder, tmp_path / f"mine{number}", change, frames)
        assert message in rejected("task", "depth_completion", folder, "--predictions", mine)


def test_bad_requests_are_rejected(folder, tmp_path):
    for task, message, *options in [
        ("depth", "task: must be one of depth_completion, next_best_view"),
        ("depth_completion", "--baseline: must be one of nearest", "--baseline", "magic"),
        ("depth_completion", "--twin: does not apply to this task", "--twin", "1"),
        ("depth_completion", "--method: must be module:function, not 'no'", "--method", "no"),
        ("depth_completion", "nowhere: must be a folder of predictions", "--predictions", "nowhere"),
        ("depth_completion", "--split: must have a split 'test'", "--split", "train=1"),
    ]:
        assert message in rejected("task", task, folder, *options)


def test_a_frame_without_an_output_says_how_to_build_it(tmp_path):
    painted_set(tmp_path / "set", ("colour", "instance"), paint_depth)
    with pytest.raises(
        InputError, match=r"lacks the output depth_z; build it with --outputs colour,instance,"
    ):
        evaluate_depth(tmp_path / "set")
