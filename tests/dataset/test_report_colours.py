"""Labels and distances in colours, and images as data URIs."""

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
    instance_colours,
    jpeg_data_uri,
    png_data_uri,
    viridis_colours,
)


def decode(uri):
    kind, _, data = uri.removeprefix("data:image/").partition(";base64,")
    with Image.open(io.BytesIO(base64.b64decode(data)), formats=[kind.upper()]) as image:
        return image.mode, np.asarray(image.convert("RGB"))


def test_distances_follow_viridis_from_near_to_far():
    distance = np.linspace(0.2, 1.0, 9)[None]
    colours = distance_colours(distance, 0.2, 1.0)[0]
    assert ["#{:02X}{:02X}{:02X}".format(*colour) for colour in colours[::-1].tolist()] == list(VIRIDIS)
    # Nearer is always lighter, so that the map is readable in grey.
    luma = distance_colours(np.linspace(0.1, 1.2, 200)[None], 0.2, 1.0)[0] @ [0.2126, 0.7152, 0.0722]
    assert (np.diff(luma) <= 0.51).all()


def test_background_is_darkest():
    background, far = distance_colours(np.array([[np.inf, 5.0]]), 0.2, 1.0)[0].astype(int)
    assert background.sum() < far.sum()


def test_fractions_are_clipped_and_reversed_distances():
    fractions = np.linspace(-0.5, 1.5, 41)[None]
    np.testing.assert_array_equal(viridis_colours(fractions), distance_colours(1.0 - fractions, 0.0, 1.0))


def test_neighbouring_instances_have_different_hues():
    colours = instance_colours(np.arange(1, 500)[None])[0]
    hue = np.array([colorsys.rgb_to_hsv(*(c / 255))[0] for c in colours])
    step = np.abs(np.diff(hue))
    assert np.minimum(step, 1 - step).min() > 0.3
    np.testing.assert_array_equal(instance_colours(np.array([[7, 0], [0, 7]]))[0, 0], colours[6])


def test_unlabelled_pixels_have_another_colour():
    colours = class_colours(np.array([[0, 1, 2, 3, 4, 5, 6, 7, 8, 255]], np.uint8))[0]
    assert tuple(map(tuple, colours[:8].tolist())) == CLASS_COLOURS
    assert tuple(colours[9]) not in CLASS_COLOURS
    np.testing.assert_array_equal(colours[8], colours[9])


def test_drawings_are_lossless_and_have_a_palette_if_possible():
    rng = np.random.default_rng(6)
    # All colours of viridis and the background fit into a palette.
    distance = np.append(np.linspace(0.1, 1.1, 1199), np.inf).reshape(30, 40)
    for picture, expected_mode in (
        (class_colours(rng.integers(0, 8, (30, 40)).astype(np.uint8)), "P"),
        (distance_colours(distance, 0.2, 1.0), "P"),
        (rng.integers(0, 256, (30, 40, 3)).astype(np.uint8), "RGB"),
    ):
        mode, decoded = decode(png_data_uri(picture))
        assert mode == expected_mode
        np.testing.assert_array_equal(decoded, picture)


def test_large_images_shrink_without_new_label_colours():
    classes = class_colours(np.random.default_rng(7).integers(0, 8, (90, 200)).astype(np.uint8))
    _, decoded = decode(png_data_uri(classes, max_size_px=100))
    assert decoded.shape == (45, 100, 3)
    np.testing.assert_array_equal(decoded, classes[::2, ::2])
    _, decoded = decode(jpeg_data_uri(np.zeros((40, 4000, 3), np.uint8)))
    assert decoded.shape == (16, 1600, 3)


def test_photographs_are_hardly_changed():
    rows, columns = np.mgrid[0:60, 0:80]
    picture = np.stack([3 * rows, 2 * columns, rows + columns], axis=-1).astype(np.uint8)
    mode, decoded = decode(jpeg_data_uri(picture))
    assert mode == "RGB"
    assert np.abs(decoded.astype(int) - picture).mean() == pytest.approx(0.0, abs=2.0)
