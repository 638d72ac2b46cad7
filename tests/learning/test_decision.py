"""Probabilities of classes: weights taken back, other shares, temperature; against Bayes' rule."""

from __future__ import annotations

import json

import numpy as np
import pytest
from commands import rejected, run
from PIL import Image
from skimage.morphology import dilation, disk
from toy_models import image_set

from pepperscene.errors import ArgumentError, InputError
from pepperscene.learning.class_table import FRUIT_CLASSES, ClassTable, parse_shares

torch = pytest.importorskip("torch", reason="the extra `learn` installs torch")

from pepperscene.learning.evaluation.evaluate import predict_classes, with_shares  # noqa: E402
from pepperscene.learning.models import TrainedModel, build_model, load_model  # noqa: E402
from pepperscene.learning.models.decision import (  # noqa: E402
    Decision,
    estimate_shares,
    fit_factors,
    fit_temperature,
)
from pepperscene.learning.models.trained_model import read_weights, weights_as_bytes  # noqa: E402
from pepperscene.learning.options import TrainingOptions  # noqa: E402
from pepperscene.learning.training import train  # noqa: E402

FRUIT = ClassTable.parse(FRUIT_CLASSES)
MEANS = np.array([0.0, 1.5, 3.0])  # of a measured number by class, with a standard deviation of 1
TRAINING = np.array([0.6, 0.3, 0.1])
OTHER = np.array([0.9, 0.02, 0.08])


def densities(values):
    """`(n, 3)` of the values in each class, up to a factor."""
    return np.exp(-0.5 * (values[:, None] - MEANS) ** 2)


def posterior(values, shares):
    joint = densities(values) * shares
    return joint / joint.sum(axis=1, keepdims=True)


def drawn(count, shares, seed):
    rng = np.random.default_rng(seed)
    labels = rng.choice(3, count, p=shares)
    return MEANS[labels] + rng.normal(size=count), labels


def as_images(rows):
    """Rows `(n, k)` as a tensor `(1, k, n, 1)`."""
    return torch.as_tensor(rows.T.copy())[None, :, :, None]


@pytest.mark.parametrize("temperature", [1.0, 2.5])
def test_weights_are_taken_back_and_shares_replaced_by_bayes_rule(temperature):
    values, weights = np.linspace(-3, 6, 50), np.array([0.5, 1.3, 4.0])
    # What a loss with these weights teaches, and an arbitrary constant by pixel.
    logits = np.log(densities(values) * TRAINING * weights) + np.sin(values)[:, None]
    decision = Decision(tuple(weights), tuple(TRAINING), temperature)
    found = decision.probabilities(as_images(logits * temperature))[0, :, :, 0].T.numpy()
    np.testing.assert_allclose(found, posterior(values, TRAINING), rtol=1e-9)

    adapted = decision.for_shares(OTHER, np.eye(3, dtype=np.float32))
    found = adapted.probabilities(as_images(logits * temperature))[0, :, :, 0].T.numpy()
    np.testing.assert_allclose(found, posterior(values, OTHER), rtol=1e-6)


def test_members_of_a_merged_class_keep_their_proportions():
    merging = np.array([[1, 1, 0, 0], [0, 0, 1, 0]], np.float32)
    before = np.array([0.3, 0.1, 0.4, 0.2])
    decision = Decision((1.0,) * 4, tuple(before)).for_shares([0.9, 0.1], merging)
    shares = np.array(decision.shares)
    assert shares[0] / shares[1] == pytest.approx(3)
    np.testing.assert_allclose(merging @ shares, [0.72, 0.08])
    # A class that belongs to none keeps its own.
    assert shares[3] == pytest.approx(0.2)


def test_shares_are_those_of_the_greatest_likelihood():
    values, labels = drawn(40_000, OTHER, seed=3)
    found = estimate_shares(posterior(values, TRAINING), TRAINING)
    mixture = densities(values) @ found
    # At the maximum, all classes that occur have the same gain (Karush, Kuhn and Tucker).
    np.testing.assert_allclose((densities(values) / mixture[:, None]).mean(axis=0), 1, atol=1e-3)
    counted = np.bincount(labels, minlength=3) / len(labels)
    np.testing.assert_allclose(found, counted, atol=0.01)
    with pytest.raises(ArgumentError, match="at least one pixel"):
        estimate_shares(np.empty((0, 3)), TRAINING)


def test_the_temperature_of_overconfident_logits_is_found():
    values, labels = drawn(20_000, TRAINING, seed=5)
    logits = 2.2 * np.log(posterior(values, TRAINING))
    found = fit_temperature(logits, labels, np.zeros(3), np.eye(3, dtype=np.float32))
    assert found == pytest.approx(2.2, rel=0.03)


def test_factors_give_the_greatest_mean_iou():
    # Probabilities that are right: of the pixels of probability p, a part p has the second class.
    rng = np.random.default_rng(8)
    second = rng.beta(0.4, 3.0, 50_000)
    labels = (rng.random(len(second)) < second).astype(np.intp)

    def mean_iou(threshold):
        chosen, true = second > threshold, labels == 1
        parts = ((chosen, true), (~chosen, ~true))
        return np.mean([(one & other).sum() / (one | other).sum() for one, other in parts])

    factors = fit_factors(np.stack([1 - second, second], axis=1), labels)
    assert factors[0] == 1
    found = mean_iou(1 / (1 + factors[1]))
    best = max(mean_iou(threshold) for threshold in np.linspace(0.05, 0.6, 60))
    assert best - 0.004 < found
    assert found > mean_iou(0.5) + 0.01


def trained(decision, classes=FRUIT):
    torch.manual_seed(0)
    return TrainedModel(
        build_model("small,width=0.25", len(classes)), "small,width=0.25", classes, decision=decision
    )


def test_a_file_keeps_the_decision_but_not_the_shares_of_some_images(tmp_path):
    model = trained(Decision((0.5, 2.0, 9.0), (0.9, 0.08, 0.02), 1.4, (1.0, 1.4, 4.0)))
    with_shares(model, {"fruit": 0.3}).save(tmp_path / "model.safetensors")
    assert load_model(tmp_path).decision == model.decision
    # Files of before have none, and give the same as before.
    tensors, description = read_weights(tmp_path / "model.safetensors", "pepperscene model 1")
    del description["decision"]
    (tmp_path / "old.safetensors").write_bytes(weights_as_bytes(tensors, description))
    old = load_model(tmp_path / "old.safetensors")
    colour = np.random.default_rng(0).integers(0, 256, (20, 24, 3), np.uint8)
    assert old.decision is None
    np.testing.assert_array_equal(old.probabilities(colour), trained(None).probabilities(colour))
    with pytest.raises(InputError, match="does not know the shares of its classes"):
        with_shares(old, {"fruit": 0.3})


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("weights", [1.0, 1.0]),
        ("frequencies", [0.5] * 4),
        ("weights", [1, 0.0, 1]),
        ("factors", [1.0]),
        ("temperature", 0),
    ],
)
def test_rejects_files_with_another_decision(tmp_path, key, value):
    file = tmp_path / "model.safetensors"
    trained(Decision((0.5, 2.0, 9.0), (0.9, 0.08, 0.02))).save(file)
    tensors, description = read_weights(file, "pepperscene model 1")
    description["decision"][key] = value
    file.write_bytes(weights_as_bytes(tensors, description))
    with pytest.raises(InputError, match="decision"):
        load_model(file)


def test_named_shares_leave_the_others_in_proportion():
    model = trained(Decision((1.0,) * 3, (0.9, 0.08, 0.02)))
    assert with_shares(model, {"fruit": 0.3}).decision.shares == pytest.approx(
        (0.7 * 0.9 / 0.92, 0.3, 0.7 * 0.02 / 0.92)
    )
    colour = np.random.default_rng(0).integers(0, 256, (20, 24, 3), np.uint8)
    sums = [
        with_shares(model, {"fruit": share}).probabilities(colour)[1].sum() for share in (0.01, 0.08, 0.5)
    ]
    assert sums == sorted(sums)
    np.testing.assert_allclose(sums[1], model.probabilities(colour)[1].sum(), rtol=1e-5)
    # A second call replaces the first.
    again = with_shares(with_shares(model, {"fruit": 0.3}), {"fruit": 0.01})
    assert again.decision == with_shares(model, {"fruit": 0.01}).decision
    for shares, problem in (
        ({"leaf": 0.1}, "leaf is none of"),
        ({"fruit": 0.9, "peduncle": 0.2}, "sum to 1"),
    ):
        with pytest.raises(ArgumentError, match=problem):
            with_shares(model, shares)


@pytest.mark.parametrize(
    "text", ["fruit", "fruit=", "fruit=2", "fruit=0", "fruit=.1,fruit=.1", "fruit=nan", "=0.1"]
)
def test_rejects_texts_that_are_no_shares(text):
    with pytest.raises(ArgumentError, match="must be classes with shares"):
        parse_shares(text)


class Painted(torch.nn.Module):
    """Logits of fruit and peduncle from red and blue."""

    def __init__(self):
        super().__init__()
        self.none = torch.nn.Parameter(torch.zeros(1))

    def forward(self, images):
        return torch.cat([torch.full_like(images[:, :1], 0.5), images[:, :1], images[:, 2:]], dim=1) * 20


def test_small_regions_of_fruit_get_the_other_class():
    colour = np.zeros((20, 30, 3), np.uint8)
    colour[2:6, 2:7, 0] = 255  # 20 pixels of fruit
    colour[6:8, 4, 2] = 255  # and 2 of its peduncle
    colour[12:15, 20:25, 0] = 255  # 15 pixels of another fruit
    expected = np.where(colour[..., 0] > 0, 1, np.where(colour[..., 2] > 0, 2, 0))
    model = TrainedModel(Painted(), "small", FRUIT)
    np.testing.assert_array_equal(predict_classes(model, colour), expected)
    for least, left in ((15, expected), (16, np.where(np.arange(20)[:, None] < 10, expected, 0)), (23, 0)):
        found = predict_classes(model.with_regions(least), colour)
        np.testing.assert_array_equal(found, np.broadcast_to(left, found.shape))
    # Without another class, nothing can be left out.
    objects = ClassTable.parse("pepper,peduncle")
    merging = objects.merging(FRUIT)
    kept = predict_classes(model.with_regions(99), colour, merging)
    np.testing.assert_array_equal(kept, predict_classes(model, colour, merging))


@pytest.mark.parametrize("pixels", [1, 2, 5])
def test_regions_of_fruit_grow_by_a_distance(pixels):
    colour = np.zeros((40, 50, 3), np.uint8)
    colour[8:15, 10:22, 0] = 255
    colour[30, 40, 0] = 255
    model = TrainedModel(Painted(), "small", FRUIT)
    grown = predict_classes(model.with_regions(grown_px=pixels), colour)
    np.testing.assert_array_equal(grown == 1, dilation(colour[..., 0] > 0, disk(pixels)))
    # Small regions are left out before.
    largest = predict_classes(model.with_regions(least_area=2, grown_px=pixels), colour)
    np.testing.assert_array_equal(largest, np.where(np.arange(40)[:, None] < 25, grown, 0))
    assert not predict_classes(model.with_regions(least_area=99, grown_px=pixels), colour).any()
    # Each pixel gets the class of the nearest one.
    colour[5:8, 15, 2] = 255
    grown = predict_classes(model.with_regions(grown_px=pixels), colour)
    assert (grown[5 - pixels : 6, 15] == 2).all()


def painted(count, share, seed):
    """Masks of background and fruit, which is red in the images."""
    rng = np.random.default_rng(seed)
    return [np.where(rng.random((48, 64)) < share, 2, 0).astype(np.uint8) for _ in range(count)]


def test_a_training_writes_weights_frequencies_and_a_temperature(tmp_path):
    masks = painted(4, 0.2, seed=1)
    options = TrainingOptions(
        model="small,width=0.25",
        classes="background,pepper",
        steps=4,
        batch=2,
        size=(32, 32),
        width=None,
        validate=2,
    )
    model = train(image_set(*masks), tmp_path / "m", options, validation=image_set(*painted(2, 0.2, seed=2)))
    share = np.mean([mask == 2 for mask in masks])
    np.testing.assert_allclose(model.decision.frequencies, [1 - share, share], rtol=1e-6)
    ratio = model.decision.weights[1] / model.decision.weights[0]
    assert ratio == pytest.approx(((1 - share) / share) ** 0.5)
    assert model.decision.temperature != 1


def test_the_command_line_takes_shares_and_folders(tmp_path):
    trained(Decision((1.0,) * 3, (0.9, 0.08, 0.02))).save(tmp_path / "model.safetensors")
    (tmp_path / "photos").mkdir()
    for number in range(2):
        pixels = np.random.default_rng(number).integers(0, 256, (24, 32, 3), np.uint8)
        Image.fromarray(pixels).save(tmp_path / "photos" / f"{number}.png")

    predict, counts = ("predict", tmp_path / "model.safetensors", tmp_path / "photos", "--out"), []
    for number, share in enumerate(("0.001", "0.9")):
        result = run(*predict, tmp_path / f"p{number}", "--prior", f"fruit={share}")
        assert result.exit_code == 0, result.output
        counts.append(np.mean(np.asarray(Image.open(tmp_path / f"p{number}" / "class" / "0.png")) == 1))
    assert counts[0] < counts[1]
    assert run(*predict, tmp_path / "p2", "--prior", tmp_path / "photos").exit_code == 0
    for message, *options in (
        ("must be classes with shares", "--prior", "fruit=7"),
        ("nowhere", "--prior", "nowhere"),
        ("score: applies to the objects of a detector", "--score", "0.5"),
    ):
        assert message in rejected(*predict, tmp_path / "p3", *options)
    assert not (tmp_path / "p3").exists()
    assert json.loads((tmp_path / "p0" / "classes.json").read_text())
