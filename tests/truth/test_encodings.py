"""Encodings: the paper's distance code, class colours, boxes, and run lengths as in pycocotools."""

import numpy as np
import pytest

from pepperscene.classes import CLASS_COLOURS
from pepperscene.truth.encodings import (
    class_colour,
    class_from_colour,
    class_pixel_counts,
    decode_rle,
    distance_code,
    distance_from_code,
    encode_rle,
    mask_box,
    touches_border,
)


@pytest.mark.parametrize("grey", [1, 55, 128, 255])
def test_distance_code_follows_the_papers_formula(grey):
    centimetres = (255 - grey) / (2 * 150 / 255)
    assert distance_code(np.array([centimetres / 100])) == grey
    assert distance_from_code(np.array([grey], np.uint8)) == pytest.approx(centimetres / 100, abs=1e-6)


def test_every_grey_value_survives_the_round_trip():
    grey = np.arange(256, dtype=np.uint8)
    np.testing.assert_array_equal(distance_code(distance_from_code(grey)), grey)


def test_background_is_code_0_and_infinite():
    assert distance_code(np.array([np.inf, 50.0])).tolist() == [0, 0]
    assert distance_from_code(np.zeros(1, np.uint8))[0] == np.inf


@pytest.mark.parametrize("distance", [-0.1, np.nan, -np.inf])
def test_raises_on_negative_or_nan_distance(distance):
    with pytest.raises(ValueError, match="distances"):
        distance_code(np.array([0.5, distance]))


def test_colours_off_by_20_still_give_their_class():
    rng = np.random.default_rng(1)
    ids = rng.integers(0, 8, (300, 300))
    np.testing.assert_array_equal(class_colour(ids), np.array(CLASS_COLOURS)[ids])
    # Half the smallest distance of two of the colours is far above 20.
    noisy = class_colour(ids).astype(int) + rng.integers(-20, 21, (300, 300, 3))
    np.testing.assert_array_equal(class_from_colour(noisy.clip(0, 255).astype(np.uint8)), ids)


def test_class_counts_cover_the_image():
    ids = np.array([[0, 0, 2], [7, 1, 2]])
    counts = class_pixel_counts(ids)
    assert sum(counts.values()) == ids.size
    assert (counts["background"], counts["pepper"], counts["cut"], counts["stem"]) == (2, 2, 1, 0)


def test_raises_on_wrong_channels_or_class_ids():
    with pytest.raises(ValueError, match="channels"):
        class_from_colour(np.zeros((4, 4), np.uint8))
    for encode in (class_colour, class_pixel_counts):
        with pytest.raises(ValueError, match="ids"):
            encode(np.array([8]))


MASKS = [np.zeros((4, 5), bool), np.ones((4, 5), bool), np.eye(4, 5, dtype=bool)]
MASKS += [np.random.default_rng(0).uniform(size=(13, 17)) < fraction for fraction in (0.05, 0.5, 0.95)]


@pytest.mark.filterwarnings("ignore:__array__ implementation:DeprecationWarning")  # of pycocotools
@pytest.mark.parametrize("mask", MASKS)
def test_run_lengths_and_boxes_match_pycocotools(mask):
    coder = pytest.importorskip("pycocotools.mask", reason="pycocotools defines the format")
    runs = encode_rle(mask)
    assert sum(runs["counts"]) == mask.size
    assert sum(runs["counts"][1::2]) == mask.sum()
    np.testing.assert_array_equal(decode_rle(runs), mask)
    packed = coder.frPyObjects(dict(runs), *mask.shape)
    np.testing.assert_array_equal(coder.decode(packed), mask)
    assert packed["counts"] == coder.encode(np.asfortranarray(mask.astype(np.uint8)))["counts"]
    if mask.any():
        x0, y0, x1, y1 = mask_box(mask)
        assert coder.toBbox(packed).tolist() == [x0, y0, x1 - x0, y1 - y0]


@pytest.mark.parametrize("corner", [(0, 0), (3, 5)])
def test_mask_of_an_image_part_encodes_like_the_whole(corner):
    part = np.random.default_rng(1).uniform(size=(8, 6)) < 0.6
    whole = np.zeros((13, 10), bool)
    x, y = corner
    whole[y : y + 8, x : x + 6] = part
    assert encode_rle(part, (13, 10), corner) == encode_rle(whole)
    assert mask_box(part, corner) == mask_box(whole)


def test_raises_on_mask_outside_or_runs_of_wrong_length():
    for corner in ((3, 0), (-1, 0)):
        with pytest.raises(ValueError, match="not inside"):
            encode_rle(np.ones((3, 3), bool), (5, 5), corner)
    for counts in ([3, 4], [-1, 7], []):
        with pytest.raises(ValueError, match="do not fill"):
            decode_rle({"size": [2, 3], "counts": counts})


def test_boxes_are_half_open_and_detect_the_border():
    mask = np.zeros((6, 9), bool)
    assert mask_box(mask) is None
    mask[2:4, 5] = True
    assert mask_box(mask) == (5, 2, 6, 4)
    assert not touches_border((5, 2, 6, 4), mask.shape)
    for box in ((0, 2, 3, 4), (5, 0, 6, 4), (5, 2, 9, 4), (5, 2, 6, 6)):
        assert touches_border(box, mask.shape)
