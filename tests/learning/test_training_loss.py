"""The loss of a training, against its definition in float64."""

from __future__ import annotations

import numpy as np
import pytest
from toy_models import image_set, random_masks

from pepperscene.classes import IGNORE_CLASS
from pepperscene.errors import InputError
from pepperscene.learning.class_table import FRUIT_CLASSES, ClassTable

torch = pytest.importorskip("torch", reason="the extra `learn` installs torch")

from pepperscene.learning.training.loop import class_frequencies, class_weights  # noqa: E402
from pepperscene.learning.training.segmentation_loss import SegmentationLoss, overlap_loss  # noqa: E402

ORGANS = ClassTable.organs()
FRUIT = ClassTable.parse(FRUIT_CLASSES)
DROPPED = ClassTable.parse("plant=leaf+stem,pepper")
TABLES = pytest.mark.parametrize("labels", [ORGANS, FRUIT, DROPPED], ids=["plain", "merged", "dropped"])


def batch(labels, seed=0, shape=(2, 3, 4), void=0.3):
    """Logits of the eight classes, labels of a table, and weights."""
    rng = np.random.default_rng(seed)
    logits = rng.normal(0, 2, (shape[0], len(ORGANS), *shape[1:])).astype(np.float32)
    truth = rng.integers(0, len(labels), shape)
    truth[rng.random(shape) < void] = IGNORE_CLASS
    return logits, truth, rng.uniform(0.2, 3, len(labels))


def defined_loss(labels, logits, truth, weights):
    """Weighted mean of -log of the summed probabilities of a label's classes, among those of all labels."""
    total = weight = 0.0
    for n, row, column in np.ndindex(truth.shape):
        index = truth[n, row, column]
        if index == IGNORE_CLASS:
            continue
        probabilities = np.exp(logits[n, :, row, column].astype(np.float64))
        sums = [sum(probabilities[list(ids)]) for ids in labels.members]
        total -= weights[index] * np.log(sums[index] / sum(sums))
        weight += weights[index]
    return total / weight


def loss_of(labels, logits, truth, weights):
    module = SegmentationLoss(labels, ORGANS, weights)
    return module(torch.as_tensor(logits), torch.as_tensor(truth))


@TABLES
def test_loss_is_minus_the_logarithm_of_summed_probabilities(labels):
    logits, truth, weights = batch(labels)
    expected = defined_loss(labels, logits, truth, weights)
    assert float(loss_of(labels, logits, truth, weights)) == pytest.approx(expected, rel=1e-5)


@pytest.mark.parametrize("shift", [-500.0, 500.0])
def test_loss_does_not_overflow(shift):
    logits, truth, weights = batch(FRUIT)
    expected = defined_loss(FRUIT, logits, truth, weights)
    assert float(loss_of(FRUIT, logits + shift, truth, weights)) == pytest.approx(expected, rel=1e-3)


@TABLES
def test_gradients_are_those_of_finite_differences(labels):
    logits, truth, weights = batch(labels, seed=7)
    tensor = torch.tensor(logits, requires_grad=True)
    loss_of(labels, tensor, truth, weights).backward()
    gradient, step = tensor.grad.numpy(), 1e-4
    expected = np.zeros(logits.shape)
    for index in np.ndindex(logits.shape):
        values = []
        for sign in (-1, 1):
            moved = logits.astype(np.float64)
            moved[index] += sign * step
            values.append(defined_loss(labels, moved, truth, weights))
        expected[index] = (values[1] - values[0]) / (2 * step)
    np.testing.assert_allclose(gradient, expected, atol=1e-6)
    assert np.abs(expected).max() > 0.01


@TABLES
def test_void_pixels_have_no_gradient_and_do_not_change_the_loss(labels):
    logits, truth, weights = batch(labels, seed=3)
    void = truth == IGNORE_CLASS
    tensor = torch.tensor(logits, requires_grad=True)
    loss = loss_of(labels, tensor, truth, weights)
    loss.backward()
    gradient = np.moveaxis(tensor.grad.numpy(), 1, -1)
    assert not gradient[void].any()
    assert np.abs(gradient[~void]).max(axis=-1).all()
    changed = np.moveaxis(logits.copy(), 1, -1)
    changed[void] = 99
    assert float(loss_of(labels, np.moveaxis(changed, -1, 1).copy(), truth, weights)) == float(loss.detach())
    # A batch of void alone.
    truth[:] = IGNORE_CLASS
    tensor = torch.tensor(logits, requires_grad=True)
    loss = loss_of(labels, tensor, truth, weights)
    loss.backward()
    assert float(loss.detach()) == 0
    assert not tensor.grad.any()


def test_logits_of_half_precision_are_computed_in_single_precision():
    logits, truth, weights = batch(FRUIT)
    rounded = torch.tensor(logits).bfloat16()
    loss, expected = (loss_of(FRUIT, one, truth, weights) for one in (rounded, rounded.float()))
    assert loss.dtype == torch.float32
    assert float(loss) == pytest.approx(float(expected), rel=1e-6)


# --- overlap of classes -----------------------------------------------------------------------------------


def one_hot(labels, count):
    return np.moveaxis(np.eye(count, dtype=np.float32)[np.minimum(labels, count - 1)], -1, 1).copy()


def test_overlap_loss_of_certain_predictions_is_one_minus_the_mean_iou():
    _, truth, _ = batch(FRUIT, seed=1, shape=(2, 9, 11))
    predicted = np.where(np.random.default_rng(2).random(truth.shape) < 0.6, truth, 1)
    predicted[predicted == IGNORE_CLASS] = 0
    known = truth != IGNORE_CLASS
    iou = [
        (known & (truth == k) & (predicted == k)).sum() / (known & ((truth == k) | (predicted == k))).sum()
        for k in range(3)
    ]
    loss = overlap_loss(torch.as_tensor(one_hot(predicted, 3)), torch.as_tensor(truth))
    assert float(loss) == pytest.approx(1 - np.mean(iou), abs=1e-6)
    # A class that does not occur does not count.
    truth[truth == 2] = IGNORE_CLASS
    assert float(overlap_loss(torch.as_tensor(one_hot(np.minimum(truth, 2), 3)), torch.as_tensor(truth))) == 0


def test_overlap_loss_has_the_gradient_of_finite_differences_and_none_at_void_pixels():
    logits, truth, _ = batch(FRUIT, seed=4)
    tensor = torch.tensor(logits[:, :3], dtype=torch.float64, requires_grad=True)
    labels = torch.as_tensor(truth)
    assert torch.autograd.gradcheck(lambda x: overlap_loss(x.softmax(dim=1), labels), tensor)
    overlap_loss(tensor.softmax(dim=1), labels).backward()
    assert not np.moveaxis(tensor.grad.numpy(), 1, -1)[truth == IGNORE_CLASS].any()
    void = torch.full_like(labels, IGNORE_CLASS)
    tensor.grad = None
    overlap_loss(tensor.softmax(dim=1), void).backward()
    assert not tensor.grad.any()


@TABLES
def test_overlap_is_added_to_the_cross_entropy(labels):
    logits, truth, weights = batch(labels, shape=(2, 6, 8))
    plain = loss_of(labels, logits, truth, weights)
    both = SegmentationLoss(labels, ORGANS, weights, 0.5)(torch.as_tensor(logits), torch.as_tensor(truth))
    probabilities = np.exp(logits)
    sums = np.stack([probabilities[:, list(ids)].sum(axis=1) for ids in labels.members], axis=1)
    seen = torch.as_tensor((sums / sums.sum(axis=1, keepdims=True))[..., ::2, ::2])
    expected = float(plain) + 0.5 * float(overlap_loss(seen, torch.as_tensor(truth[:, ::2, ::2])))
    assert float(both) == pytest.approx(expected, rel=1e-5)


# --- weights of classes -----------------------------------------------------------------------------------


@pytest.mark.parametrize("balance", [0, 0.5])
@TABLES
def test_weights_are_inverse_frequencies_with_an_exponent_and_one_on_average(labels, balance):
    masks = random_masks(6, seed=2)
    indices = np.concatenate([labels.indices(mask).ravel() for mask in masks])
    frequencies = np.bincount(indices, minlength=256)[: len(labels)].astype(float)
    frequencies /= frequencies.sum()
    counted = class_frequencies([image_set(*masks[:4]), image_set(*masks[4:])], labels)
    weights = class_weights(counted, balance)
    np.testing.assert_allclose(weights / weights[0], (frequencies / frequencies[0]) ** -balance)
    assert (weights * frequencies).sum() == pytest.approx(1)
    # On average over the labelled pixels, so that the learning rate has the same meaning.
    assert weights[indices[indices != IGNORE_CLASS]].mean() == pytest.approx(1)


def test_weights_of_rare_and_absent_classes_are_limited():
    mask = np.zeros((200, 200), np.uint8)
    mask[0, 0] = 1
    weights = class_weights(class_frequencies([image_set(mask)], ORGANS), 1.0)
    np.testing.assert_allclose(weights[1:] / weights[0], 30)
    assert np.isfinite(weights).all()


def test_images_without_masks_are_not_counted():
    masks = random_masks(3)
    expected = class_frequencies([image_set(*masks)], ORGANS)
    np.testing.assert_array_equal(class_frequencies([image_set(None, *masks, None)], ORGANS), expected)


def test_rejects_sets_without_pixels_of_the_classes():
    peppers = ClassTable.parse("pepper,peduncle")
    sets = [image_set(None, name="a"), image_set(np.zeros((3, 4)), np.full((2, 2), 255), name="b")]
    with pytest.raises(InputError, match="a, b: has no pixel of the classes pepper,peduncle"):
        class_frequencies(sets, peppers)
