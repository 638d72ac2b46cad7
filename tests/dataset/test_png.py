"""PNG files of our own, read by Pillow and by OpenCV's copy of libpng."""

from __future__ import annotations

import io
import struct
import zlib

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from pepperscene.dataset.store.codecs import png_bytes
from PIL import Image


def sides(*tail):
    return st.tuples(st.integers(1, 9), st.integers(1, 9)).map(lambda shape: (*shape, *tail))


IMAGES = st.one_of(arrays("uint8", sides()), arrays("uint16", sides()), arrays("uint8", sides(3)))


@settings(max_examples=200, deadline=None)
@given(IMAGES)
def test_two_other_readers_see_the_same_values(image):
    data = png_bytes(image)
    with Image.open(io.BytesIO(data), formats=["PNG"]) as shown:
        np.testing.assert_array_equal(np.asarray(shown), image)
    seen = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    np.testing.assert_array_equal(seen[..., ::-1] if image.ndim == 3 else seen, image)


@given(arrays("uint8", sides(), elements=st.integers(0, 2)))
@settings(max_examples=50, deadline=None)
def test_a_palette_is_shown_and_its_indices_are_kept(image):
    colours = ((9, 8, 7), (255, 0, 128), (1, 2, 3))
    with Image.open(io.BytesIO(png_bytes(image, colours)), formats=["PNG"]) as shown:
        np.testing.assert_array_equal(np.asarray(shown), image)
        np.testing.assert_array_equal(np.asarray(shown.convert("RGB")), np.array(colours, np.uint8)[image])


def test_how_an_array_lies_in_memory_does_not_matter():
    image = np.random.default_rng(1).integers(0, 65536, (6, 8)).astype(np.uint16)
    expected = png_bytes(image)
    assert png_bytes(np.asfortranarray(image)) == expected
    assert png_bytes(np.repeat(image, 2, axis=1)[:, ::2]) == expected


def test_every_chunk_carries_its_checksum():
    data = png_bytes(np.zeros((3, 4), np.uint8), ((0, 0, 0),))
    place, names = 8, []
    while place < len(data):
        (length,) = struct.unpack_from(">I", data, place)
        body = data[place + 4 : place + 8 + length]
        assert struct.unpack_from(">I", data, place + 8 + length) == (zlib.crc32(body),)
        names.append(body[:4])
        place += 12 + length
    assert names == [b"IHDR", b"PLTE", b"IDAT", b"IEND"]


def test_repeating_rows_cost_next_to_nothing():
    # A label over the whole picture: 1.44 MB of it in less than a hundredth.
    assert len(png_bytes(np.full((600, 800, 3), 77, np.uint8))) < 14_400


@pytest.mark.parametrize(
    ("image", "palette"),
    [
        (np.zeros((2, 2), np.float32), None),
        (np.zeros((2, 2), np.int16), None),
        (np.zeros((2, 2, 3), np.uint16), None),
        (np.zeros((2, 2, 4), np.uint8), None),
        (np.zeros((2, 2, 3, 1), np.uint8), None),
        (np.zeros(4, np.uint8), None),
        (np.zeros((0, 4), np.uint8), None),
        (np.zeros((2, 2), np.uint16), ((0, 0, 0),)),
        (np.zeros((2, 2, 3), np.uint8), ((0, 0, 0),)),
    ],
)
def test_what_is_no_such_image_is_refused(image, palette):
    with pytest.raises(ValueError, match="no image"):
        png_bytes(image, palette)
