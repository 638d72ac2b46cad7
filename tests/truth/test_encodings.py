"""The published codes: the paper's formula at known points, and round trips."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pepperscene.classes import CLASS_COLOURS, OrganClass
from pepperscene.truth import (
    FARTHEST_CODED_M,
    class_colour,
    class_from_colour,
    class_pixel_counts,
    distance_code,
    distance_from_code,
)


@pytest.mark.parametrize("grey", [1, 55, 128, 255])
def test_code_is_the_papers_formula(grey):
    centimetres = (255 - grey) / (2 * 150 / 255)
    assert distance_code(np.array([centimetres / 100])) == grey
    assert distance_from_code(np.array([grey], np.uint8)) == pytest.approx(centimetres / 100, abs=1e-6)


def test_every_grey_value_survives_the_round_trip():
    grey = np.arange(256, dtype=np.uint8)
    np.testing.assert_array_equal(distance_code(distance_from_code(grey)), grey)


@given(st.floats(0, FARTHEST_CODED_M))
def test_coding_moves_a_distance_by_at_most_half_a_step(metres):
    back = distance_from_code(distance_code(np.array([metres], np.float64)))[0]
    assert abs(back - metres) <= 0.00425 + 1e-6


def test_background_is_zero_and_comes_back_as_infinity():
    assert distance_code(np.array([np.inf, 50.0])).tolist() == [0, 0]
    assert distance_from_code(np.zeros(1, np.uint8))[0] == np.inf


@pytest.mark.parametrize("wrong", [-0.1, np.nan, -np.inf])
def test_impossible_distances_are_refused(wrong):
    with pytest.raises(ValueError, match="distances"):
        distance_code(np.array([0.5, wrong]))


def test_class_colours_and_back():
    ids = np.arange(8, dtype=np.uint8).reshape(2, 4)
    rgb = class_colour(ids)
    assert rgb.shape == (2, 4, 3)
    assert tuple(rgb[1, 3].tolist()) == CLASS_COLOURS[OrganClass.CUT]
    np.testing.assert_array_equal(class_from_colour(rgb), ids)


def test_slightly_wrong_colours_find_their_class():
    rng = np.random.default_rng(1)
    ids = rng.integers(0, 8, (300, 300))
    # Half the smallest gap between two of the colours is far above 20.
    off = class_colour(ids).astype(int) + rng.integers(-20, 21, (300, 300, 3))
    np.testing.assert_array_equal(class_from_colour(off.clip(0, 255).astype(np.uint8)), ids)


def test_wrong_shapes_and_ids_are_refused():
    with pytest.raises(ValueError, match="channels"):
        class_from_colour(np.zeros((4, 4), np.uint8))
    with pytest.raises(ValueError, match="ids"):
        class_colour(np.array([8]))
    with pytest.raises(ValueError, match="ids"):
        class_pixel_counts(np.array([8]))


def test_counts_cover_the_image():
    ids = np.array([[0, 0, 2], [7, 1, 2]])
    counts = class_pixel_counts(ids)
    assert sum(counts.values()) == ids.size
    assert (counts["background"], counts["pepper"], counts["cut"], counts["stem"]) == (2, 2, 1, 0)
