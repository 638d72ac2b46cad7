from __future__ import annotations

import base64
import colorsys
import io

import numpy as np
import pytest
from PIL import Image

from pepperscene.classes import CLASS_COLOURS
from pepperscene.dataset.report.colours import (
    VIRIDIS,
    class_colours,
    distance_colours,
    drawing,
    instance_colours,
    photograph,
    share_colours,
)


def decoded(address):
    kind, _, data = address.removeprefix("data:image/").partition(";base64,")
    with Image.open(io.BytesIO(base64.b64decode(data)), formats=[kind.upper()]) as picture:
        return picture.mode, np.asarray(picture.convert("RGB"))


def test_distances_follow_viridis_from_near_to_far():
    distance = np.linspace(0.2, 1.0, 9)[None]
    shown = distance_colours(distance, 0.2, 1.0)[0]
    assert ["#{:02X}{:02X}{:02X}".format(*colour) for colour in shown[::-1].tolist()] == list(VIRIDIS)
    # Nearer is lighter, all the way: the map can be read in grey.
    luma = distance_colours(np.linspace(0.1, 1.2, 200)[None], 0.2, 1.0)[0] @ [0.2126, 0.7152, 0.0722]
    assert (np.diff(luma) <= 0.51).all()


def test_nothing_is_darker_than_anything():
    shown = distance_colours(np.array([[np.inf, 5.0]]), 0.2, 1.0)[0].astype(int)
    assert shown[0].sum() < shown[1].sum()


def test_shares_go_the_other_way_and_no_further_than_the_ends():
    share = np.linspace(-0.5, 1.5, 41)[None]
    np.testing.assert_array_equal(share_colours(share), distance_colours(1.0 - share, 0.0, 1.0))


def test_neighbouring_instances_have_hues_far_apart():
    colours = instance_colours(np.arange(1, 500)[None])[0]
    hue = np.array([colorsys.rgb_to_hsv(*(c / 255))[0] for c in colours])
    step = np.abs(np.diff(hue))
    assert np.minimum(step, 1 - step).min() > 0.3
    np.testing.assert_array_equal(instance_colours(np.array([[7, 0], [0, 7]]))[0, 0], colours[6])


def test_what_has_no_label_has_a_colour_of_its_own():
    shown = class_colours(np.array([[0, 1, 2, 3, 4, 5, 6, 7, 8, 255]], np.uint8))[0]
    assert tuple(map(tuple, shown[:8].tolist())) == CLASS_COLOURS
    assert tuple(shown[9]) not in CLASS_COLOURS
    np.testing.assert_array_equal(shown[8], shown[9])


def test_drawings_come_back_as_they_were_and_with_a_palette_where_one_suffices():
    rng = np.random.default_rng(6)
    classes = class_colours(rng.integers(0, 8, (30, 40)).astype(np.uint8))
    mode, shown = decoded(drawing(classes))
    assert mode == "P"
    np.testing.assert_array_equal(shown, classes)
    # All of the ramp and what is nothing fit into a palette.
    distance = np.append(np.linspace(0.1, 1.1, 1199), np.inf).reshape(30, 40)
    mode, shown = decoded(drawing(distance_colours(distance, 0.2, 1.0)))
    assert mode == "P"
    np.testing.assert_array_equal(shown, distance_colours(distance, 0.2, 1.0))
    many = rng.integers(0, 256, (30, 40, 3)).astype(np.uint8)
    mode, shown = decoded(drawing(many))
    assert mode == "RGB"
    np.testing.assert_array_equal(shown, many)


def test_large_pictures_are_made_smaller_without_new_label_colours():
    classes = class_colours(np.random.default_rng(7).integers(0, 8, (90, 200)).astype(np.uint8))
    _, shown = decoded(drawing(classes, longest_px=100))
    assert shown.shape == (45, 100, 3)
    np.testing.assert_array_equal(shown, classes[::2, ::2])
    _, shown = decoded(photograph(np.zeros((40, 4000, 3), np.uint8)))
    assert shown.shape == (16, 1600, 3)


def test_photographs_are_hardly_changed():
    rows, columns = np.mgrid[0:60, 0:80]
    picture = np.stack([3 * rows, 2 * columns, rows + columns], axis=-1).astype(np.uint8)
    mode, shown = decoded(photograph(picture))
    assert mode == "RGB"
    assert np.abs(shown.astype(int) - picture).mean() == pytest.approx(0.0, abs=2.0)
