"""Confusion matrices and fruit as objects: by definition, by hand, and against torchmetrics."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import binom

from pepperscene.classes import IGNORE_CLASS
from pepperscene.colour.comparison.bootstrap import bootstrap_weights
from pepperscene.learning.evaluation.measures import (
    ObjectCounts,
    class_precision,
    class_recall,
    confusion_matrix,
    connected_objects,
    count_objects,
    intersection_over_union,
    match_objects,
    mean_intersection_over_union,
    measure_classes,
    measure_objects,
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


SIZE = (30, 40)


def mask(*boxes):
    """Pixels in any of these boxes (rows, then columns; ends excluded)."""
    pixels = np.zeros(SIZE, bool)
    for top, bottom, left, right in boxes:
        pixels[top:bottom, left:right] = True
    return pixels


NONE = mask()
A, B = (2, 12, 2, 12), (2, 12, 20, 30)  # 100 pixels each


@pytest.mark.parametrize(
    ("truth", "prediction", "expected"),
    [
        ([A, B], [A, B], ObjectCounts(2, 2, 2)),
        ([A, B], [A], ObjectCounts(1, 2, 1)),
        ([A], [A, B], ObjectCounts(1, 1, 2)),
        ([], [], ObjectCounts(0, 0, 0)),
        ([], [A], ObjectCounts(0, 0, 1)),
        ([A], [], ObjectCounts(0, 1, 0)),
        # IoU 60 / 100 and 50 / 100: the limit itself is not enough.
        ([A], [(2, 8, 2, 12)], ObjectCounts(1, 1, 1)),
        ([A], [(2, 7, 2, 12)], ObjectCounts(0, 1, 1)),
        # One prediction over both, IoU 100 / 280 with each.
        ([A, B], [(2, 12, 2, 30)], ObjectCounts(0, 2, 1)),
        # A fruit in two pieces: the larger one matches.
        ([A], [(2, 8, 2, 12), (9, 12, 2, 12)], ObjectCounts(1, 1, 2)),
        # 24 pixels are too few on either side; 25 are enough.
        ([A], [A, (20, 24, 20, 26)], ObjectCounts(1, 1, 1)),
        ([A], [A, (20, 25, 20, 25)], ObjectCounts(1, 1, 2)),
        ([A, (20, 24, 20, 26)], [A], ObjectCounts(1, 1, 1)),
        # What lies on a fruit too small to count is not wrong.
        ([A, (20, 24, 20, 26)], [A, (20, 25, 20, 27)], ObjectCounts(1, 1, 1, 1)),
    ],
)
def test_counts_of_painted_objects(truth, prediction, expected):
    assert count_objects(mask(*truth), mask(*prediction), NONE) == expected


def test_void_does_not_count_against_a_prediction():
    # Half of the prediction is void; the rest is the whole object.
    void = mask((12, 22, 2, 12))
    assert count_objects(mask(A), mask((2, 22, 2, 12)), void) == ObjectCounts(1, 1, 1)
    assert count_objects(mask(A), mask((2, 22, 2, 12)), NONE) == ObjectCounts(0, 1, 1)
    # What matches nothing is ignored if more than half of it is void.
    void = mask((20, 30, 20, 30))
    assert count_objects(NONE, mask((20, 30, 16, 30)), void) == ObjectCounts(0, 0, 0, 1)
    assert count_objects(NONE, mask((20, 30, 10, 30)), void) == ObjectCounts(0, 0, 1)


def test_instances_separate_fruit_that_touch():
    left, right = mask((2, 12, 2, 12)), mask((2, 12, 12, 22))
    both = left | right
    instances = np.where(left, 7, np.where(right, 300, 9)).astype(np.uint16)
    assert count_objects(both, both, NONE) == ObjectCounts(1, 1, 1)
    assert count_objects(both, both, NONE, instances) == ObjectCounts(0, 2, 1)
    assert count_objects(both, left, NONE, instances) == ObjectCounts(1, 2, 1)
    # An instance hidden in part by a leaf is one object in two pieces.
    pieces = mask((2, 12, 2, 10), (2, 12, 12, 16))
    one = np.where(pieces, 5, 0).astype(np.uint16)
    assert count_objects(pieces, mask((2, 12, 2, 10)), NONE, one) == ObjectCounts(1, 1, 1)
    # Fruit without an instance are a crowd.
    known = np.where(mask(A), 3, 0).astype(np.uint16)
    assert count_objects(mask(A, B), mask(A, B), NONE, known) == ObjectCounts(1, 1, 1, 1)


def test_equal_pairs_are_matched_in_order():
    ones = np.full((2, 2), 6)
    assert match_objects(ones, np.array([10, 10]), np.array([10, 10]), 0.3) == [(0, 0), (1, 1)]
    # The highest IoU comes first, whatever its position.
    overlaps = np.array([[6, 9], [6, 7]])
    assert match_objects(overlaps, np.array([10, 10]), np.array([10, 10]), 0.3) == [(0, 1), (1, 0)]


def test_regions_connect_at_corners():
    pixels = np.zeros((4, 4), bool)
    pixels[:2, :2] = pixels[2:, 2:] = True
    assert connected_objects(pixels).max() == 1


def test_precision_and_recall_are_those_of_all_images():
    counts = [ObjectCounts(3, 4, 3, 1), ObjectCounts(1, 2, 5), ObjectCounts(0, 0, 0)]
    measures = measure_objects(counts, [bootstrap_weights(bytes([k])) for k in range(3)])
    assert measures.counts == ObjectCounts(4, 6, 8, 1)
    assert (measures.precision.value, measures.recall.value) == (0.5, 4 / 6)
    assert measures.precision.low < 0.5 < measures.precision.high
    empty = measure_objects([ObjectCounts(0, 0, 0)], [bootstrap_weights(b"")])
    assert (empty.precision.value, empty.precision.why) == (None, "no object is predicted")
    assert empty.recall.why == "the masks have no object"
