"""Confusion matrices and what follows from them, against torchmetrics and by hand."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import binom

from pepperscene.classes import IGNORE_CLASS
from pepperscene.colour.comparison.bootstrap import bootstrap_weights
from pepperscene.learning.evaluation.measures import (
    class_precision,
    class_recall,
    confusion_matrix,
    intersection_over_union,
    mean_intersection_over_union,
    measure_classes,
)


def label_pair(rng):
    """Truth and prediction of 4 x 5 pixels of up to eight classes, some of them absent."""
    classes = int(rng.integers(2, 9))
    truth, prediction = rng.integers(0, rng.integers(1, classes + 1), (2, 4, 5)).astype(np.uint8)
    # Half of the predictions are mostly right.
    prediction = np.where(rng.random((4, 5)) < 0.8 * rng.integers(2), truth, prediction)
    truth[rng.random((4, 5)) < 0.2] = IGNORE_CLASS
    return classes, truth, prediction


def counted(truth, prediction, classes):
    """The matrix by its definition, Eq. 1 of Barth et al. 2018."""
    pairs = list(zip(truth.ravel().tolist(), prediction.ravel().tolist(), strict=True))
    return np.array([[pairs.count((i, j)) for j in range(classes)] for i in range(classes)])


def test_matrix_and_iou_of_random_pairs_equal_definition_and_torchmetrics():
    torch = pytest.importorskip("torch", reason="the extra `learn` installs torch")
    classification = pytest.importorskip("torchmetrics.functional.classification")
    rng = np.random.default_rng(1)
    for _ in range(60):
        classes, truth, prediction = label_pair(rng)
        matrix = confusion_matrix(truth, prediction, classes)
        np.testing.assert_array_equal(matrix, counted(truth, prediction, classes))
        if not matrix.any():
            continue
        tensors = torch.from_numpy(prediction.astype(int)), torch.from_numpy(truth.astype(int))
        jaccard = {
            average: classification.multiclass_jaccard_index(
                *tensors, classes, average=average, ignore_index=IGNORE_CLASS
            ).numpy()
            for average in ("none", "macro")
        }
        iou = intersection_over_union(matrix)
        # torchmetrics gives absent classes an IoU of 0, and leaves them out of the mean too.
        np.testing.assert_allclose(np.nan_to_num(iou), jaccard["none"], atol=1e-6)
        assert mean_intersection_over_union(matrix) == pytest.approx(jaccard["macro"], abs=1e-6)
        np.testing.assert_array_equal(np.isnan(iou), (matrix + matrix.T).sum(axis=0) == 0)


def test_measures_by_hand():
    # The third class is only predicted, the fourth is absent.
    matrix = np.array([[6, 2, 1, 0], [4, 8, 0, 0], [0, 0, 0, 0], [0, 0, 0, 0]])
    np.testing.assert_allclose(intersection_over_union(matrix), [6 / 13, 8 / 14, 0, np.nan])
    assert mean_intersection_over_union(matrix) == pytest.approx((6 / 13 + 8 / 14) / 3)
    np.testing.assert_allclose(class_precision(matrix), [6 / 10, 8 / 10, 0, np.nan])
    np.testing.assert_allclose(class_recall(matrix), [6 / 9, 8 / 12, np.nan, np.nan])
    assert np.isnan(mean_intersection_over_union(np.zeros((2, 2), int)))


def test_measures_are_those_of_the_sum_and_say_why_one_is_missing():
    matrices = [np.array([[3, 1, 0], [0, 0, 0], [0, 0, 0]]), np.array([[1, 0, 0], [2, 5, 0], [0, 0, 0]])]
    weights = [bootstrap_weights(b"a"), bootstrap_weights(b"b")]
    measures = measure_classes(matrices, weights)
    assert [iou.value for iou in measures.iou] == [4 / 7, 5 / 8, None]
    assert measures.mean_iou.value == pytest.approx((4 / 7 + 5 / 8) / 2)
    assert measures.iou[2].why == "the class is neither in the masks nor predicted"
    assert measures.recall[2].why == "the class is not in the masks"
    assert measures.mean_iou.low < measures.mean_iou.value < measures.mean_iou.high
    # One image says nothing about the spread.
    assert measure_classes(matrices[:1], weights[:1]).mean_iou.low is None


def test_what_is_predicted_where_the_truth_is_ignored_does_not_count():
    labels = np.zeros((2, 3), np.uint8)
    assert confusion_matrix(labels + IGNORE_CLASS, labels + 9, 2).sum() == 0


@pytest.mark.parametrize(("cases", "wrong"), [(80, 0.7), pytest.param(300, 0.8, marks=pytest.mark.long)])
def test_intervals_cover_the_true_iou(cases, wrong):
    """The IoU of infinitely many images is in the 95 % interval of 60 images in about 95 of 100 cases.

    Images differ in their number of pixels of the class and in how well it is found. Significance: if the
    coverage were at least 0.91, as for ratios of 60 skewed images, the test would fail in less than one of
    10,000 cases; likewise if it were at most 0.98. A coverage of `wrong` fails with 90 % or more.
    """
    images, rng = 60, np.random.default_rng(4)

    def draw(count):
        sizes = rng.gamma(2.0, 100.0, count).astype(int) + 1
        hits, wrong = rng.binomial(sizes, rng.beta(6, 2, count)), rng.poisson(0.2 * sizes)
        return np.stack([np.full(count, 5000), wrong, sizes - hits, hits], axis=-1).reshape(-1, 2, 2)

    true = intersection_over_union(draw(200_000).sum(axis=0))
    covered = np.zeros(3, int)
    for case in range(cases):
        weights = [bootstrap_weights(f"{case} {image}".encode()) for image in range(images)]
        measures = measure_classes(list(draw(images)), weights)
        estimates = zip((*measures.iou, measures.mean_iou), (*true, true.mean()), strict=True)
        covered += [e.low <= value <= e.high for e, value in estimates]
    assert (covered >= binom.ppf(1e-4, cases, 0.91)).all(), covered / cases
    assert (covered <= binom.isf(1e-4, cases, 0.98)).all(), covered / cases
    assert binom.cdf(binom.ppf(1e-4, cases, 0.91) - 1, cases, wrong) > 0.9
