"""Segmentation across sensors: IoU by twin against torchmetrics, the gap, trained baselines, bad requests."""

from __future__ import annotations

import numpy as np
import pytest
from commands import rejected
from painted_bands import COLOURS
from PIL import Image
from task_sets import painted_set

from pepperscene.classes import OrganClass
from pepperscene.dataset.store.dataset import open_dataset
from pepperscene.errors import InputError
from pepperscene.learning.tasks import evaluate_sensors
from pepperscene.learning.tasks.frames import open_task_frames
from pepperscene.learning.tasks.sensor_task import twin_number

TWINS = {"twins": {"camera.exposure_us": [50, 60, 70]}, "daylight.illuminance_lx": 5000}
TEST = range(6, 12)  # the second set of plants, three twins of two views


def paint(seed, size):
    classes = np.random.default_rng(seed).integers(0, len(OrganClass), (4, 4)).astype(np.uint8)
    classes = np.kron(classes, np.ones((size[0] // 4, size[1] // 4), np.uint8))
    return {"class": classes, "colour": COLOURS[classes]}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return painted_set(tmp_path_factory.mktemp("twins") / "set", ("colour", "class"), paint, TWINS).folder


def write_predictions(folder, path, change=lambda classes, twin: classes):
    (path / "class").mkdir(parents=True)
    data = open_dataset(folder)
    for index in TEST:
        classes = change(data.image(index, "class").copy(), index // 2 % 3)
        Image.fromarray(classes).save(path / "class" / f"{index:06d}.png")
    return path


def test_twins_are_numbered_as_in_the_plan(folder):
    frames = open_task_frames(folder, ("colour", "class"))
    assert frames.test.indices == tuple(TEST)
    plan = open_dataset(folder).info["recipe"]["plan"]
    from pepperscene.recipe.plan import Plan

    whole = Plan.model_validate({key: plan[key] for key in ("sets", "rotations", "frames", "twins")})
    assert [twin_number(frames.test, index) for index in TEST] == [whole.frame(index).twin for index in TEST]


def test_a_perfect_prediction_has_no_gap(folder, tmp_path):
    result = evaluate_sensors(folder, [], [write_predictions(folder, tmp_path / "mine")])
    assert result.score("mine", "own")["mean"] == result.score("mine", "other")["mean"] == 1
    assert set(result.score("mine", "gap").values()) <= {0.0}


def test_iou_of_each_twin_is_that_of_its_frames(folder, tmp_path):
    rng = np.random.default_rng(0)

    def spoil(classes, twin):
        wrong = rng.random(classes.shape) < 0.2 * (twin + 1)
        return np.where(wrong, rng.integers(0, 8, classes.shape), classes).astype(np.uint8)

    path = write_predictions(folder, tmp_path / "mine", spoil)
    result, data = evaluate_sensors(folder, [], [path]), open_dataset(folder)
    for part, twins in (("own", [0]), ("other", [1, 2]), ("twin 1", [1]), ("twin 2", [2])):
        frames = [index for index in TEST if index // 2 % 3 in twins]
        truth = np.stack([data.image(index, "class") for index in frames])
        found = np.stack([np.array(Image.open(path / "class" / f"{index:06d}.png")) for index in frames])
        each = [((truth == k) & (found == k)).sum() / ((truth == k) | (found == k)).sum() for k in range(8)]
        values = result.score("mine", part)
        np.testing.assert_allclose([values[one.name.lower()] for one in OrganClass], each, atol=1e-6)
        assert values["mean"] == pytest.approx(np.mean(each), abs=1e-6)
    gap = result.score("mine", "own")["mean"] - result.score("mine", "other")["mean"]
    assert result.score("mine", "gap")["mean"] == pytest.approx(gap)
    assert gap > 0


def test_a_baseline_is_trained_once_on_one_twin_of_the_training_plants(folder, tmp_path):
    pytest.importorskip("torch")
    from pepperscene.learning import TrainingOptions
    from pepperscene.learning.models import load_model

    options = TrainingOptions("small,width=0.25", None, 1, 1, (32, 32), 32, precision="float32")
    result = evaluate_sensors(folder, ["small_plain"], out=tmp_path, options=options)
    record = load_model(tmp_path / "small_plain").training
    assert record["options"]["augmentation"] == 0
    assert record["sets"][0]["images"] == 2
    # The trained network is used again.
    again = evaluate_sensors(folder, ["small_plain"], out=tmp_path, options=options)
    assert again.scores == result.scores


@pytest.mark.parametrize(("name", "indices"), [("small", range(2)), ("small_all_sensors", range(6))])
def test_baselines_learn_from_these_frames(folder, tmp_path, monkeypatch, name, indices):
    pytest.importorskip("torch")
    names = []

    def train(sets, *_args, **_others):
        names.extend(name for images in sets for name in images.names())
        raise InputError("train", "is not run here")

    monkeypatch.setattr("pepperscene.learning.training.run.train", train)
    with pytest.raises(InputError, match="is not run here"):
        evaluate_sensors(folder, [name], out=tmp_path)
    assert names == [f"{index:06d}" for index in indices]


def test_bad_requests_give_one_sentence(folder, tmp_path):
    whole = write_predictions(folder, tmp_path / "whole")
    short = write_predictions(folder, tmp_path / "short", lambda classes, _: classes[1:])
    nine = write_predictions(folder, tmp_path / "nine", lambda classes, _: classes + np.uint8(5))
    for message, *options in [
        ("000006.png: must be 24 rows x 32 columns as the frame, not 23 x 32", "--predictions", short),
        ("must hold class ids from 0 to 7, not", "--predictions", nine),
        ("--twin: must be the number of one of two twins", "--predictions", whole, "--twin", "3"),
        ("--views: does not apply to this task", "--predictions", whole, "--views", "3"),
        ("--baseline: must be one of small_plain, small, small_all_sensors", "--baseline", "large"),
    ]:
        assert message in rejected("task", "cross_sensor", folder, *options)
