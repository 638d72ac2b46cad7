"""The loss, also for labels that are coarser than the network's classes."""

from __future__ import annotations

import numpy as np
import pytest
from toy_models import image_set

torch = pytest.importorskip("torch")

from pepperscene.errors import InputError  # noqa: E402
from pepperscene.learning.class_table import FRUIT_CLASSES, ClassTable  # noqa: E402
from pepperscene.learning.training.loss import SegmentationLoss, class_weights  # noqa: E402

ORGANS, FRUIT = ClassTable.organs(), ClassTable.parse(FRUIT_CLASSES)


def random_batch(classes, seed=0):
    rng = np.random.default_rng(seed)
    logits = torch.tensor(rng.normal(0, 2, (2, 8, 5, 6)), dtype=torch.float32)
    labels = rng.integers(0, classes, (2, 5, 6))
    labels[rng.random(labels.shape) < 0.2] = 255
    return logits, torch.tensor(labels)


@pytest.mark.parametrize("table", [ORGANS, FRUIT, ClassTable.parse("pepper,peduncle")], ids=str)
def test_the_loss_is_minus_the_logarithm_of_summed_probabilities(table):
    weights = np.linspace(1, 2, len(table))
    logits, labels = random_batch(len(table))
    # By hand, in double precision: classes that the labels drop have no probability.
    exponentials = np.exp(logits.numpy().astype(float))
    merged = np.einsum("ck,nkhw->nchw", table.merging(ORGANS), exponentials)
    merged /= merged.sum(axis=1, keepdims=True)
    total = weight_sum = 0.0
    for n, y, x in zip(*np.nonzero(labels.numpy() != 255), strict=True):
        label = int(labels[n, y, x])
        total -= weights[label] * np.log(merged[n, label, y, x])
        weight_sum += weights[label]
    loss = SegmentationLoss(table, ORGANS, weights)(logits, labels)
    assert float(loss) == pytest.approx(total / weight_sum, rel=1e-5)


def test_gradients_agree_with_finite_differences_and_void_pixels_have_none():
    loss = SegmentationLoss(FRUIT, ORGANS, np.array([1.0, 3.0, 5.0]))
    logits, labels = random_batch(3)
    logits.requires_grad_()
    loss(logits, labels).backward()
    void = (labels == 255)[:, None].expand_as(logits)
    assert not logits.grad[void].any()
    step = 1e-2
    for place in [(0, 0, 1, 2), (1, 2, 3, 4), (0, 3, 4, 5), (1, 7, 0, 0)]:
        with torch.no_grad():
            moved = [logits.clone(), logits.clone()]
            moved[0][place] -= step
            moved[1][place] += step
            difference = (loss(moved[1], labels) - loss(moved[0], labels)) / (2 * step)
        assert float(logits.grad[place]) == pytest.approx(float(difference), abs=3e-5)


def test_a_batch_of_void_pixels_has_no_loss():
    logits, labels = random_batch(3)
    logits.requires_grad_()
    loss = SegmentationLoss(FRUIT, ORGANS, np.ones(3))(logits, torch.full_like(labels, 255))
    loss.backward()
    assert float(loss.detach()) == 0
    assert not logits.grad.any()


@pytest.mark.parametrize("balance", [0.0, 0.5, 1.0])
def test_weights_are_powers_of_the_frequency(balance):
    masks = [np.repeat([0, 0, 0, 1, 1, 2], 10).reshape(6, 10), np.full((6, 10), 255)]
    table = ClassTable.parse("background,leaf,pepper")
    weights = class_weights([image_set(*masks)], table, balance)
    frequencies = np.array([1 / 2, 1 / 3, 1 / 6])
    assert (weights * frequencies).sum() == pytest.approx(1)
    np.testing.assert_allclose(weights / weights[0], (frequencies / frequencies[0]) ** -balance)


def test_weights_of_rare_classes_are_limited_and_no_overlap_is_an_error():
    mask = np.zeros((100, 100))
    mask[0, 0] = 2
    weights = class_weights([image_set(mask)], ClassTable.parse("background,leaf,pepper"), 1.0)
    assert weights[1] / weights[0] == weights[2] / weights[0] == pytest.approx(30)
    with pytest.raises(InputError, match="has no pixel of the classes stem,wire"):
        class_weights([image_set(mask)], ClassTable.parse("stem,wire"), 0.5)
