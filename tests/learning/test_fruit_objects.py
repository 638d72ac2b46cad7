"""Fruit as objects: matching, small objects, void, crowds."""

from __future__ import annotations

import numpy as np
import pytest

from pepperscene.colour.comparison.bootstrap import bootstrap_weights
from pepperscene.learning.evaluation.measures import (
    ObjectCounts,
    connected_objects,
    count_objects,
    match_objects,
    measure_objects,
)

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


def test_matches_do_not_depend_on_the_side():
    rng = np.random.default_rng(8)
    for _ in range(50):
        first, second = (
            mask(*((t, t + 6, c, c + 8) for t, c in rng.integers(0, 24, (4, 2)))) for _ in range(2)
        )
        one, other = count_objects(first, second, NONE), count_objects(second, first, NONE)
        assert (one.matched, one.truth, one.predicted) == (other.matched, other.predicted, other.truth)


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
