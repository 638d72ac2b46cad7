"""Pictures of spectral indices: values as colours, and a scale bar of the same colours."""

from __future__ import annotations

import matplotlib
import numpy as np
import pytest

from pepperscene.camera.sensor.indices import spectral_index
from pepperscene.dataset.readers.image_set import LabelledImage
from pepperscene.errors import ArgumentError, InputError
from pepperscene.review.report.image_view import available_indices, index_picture

BANDS_NM = (475.0, 560.0, 668.0, 717.0, 842.0)
METADATA = {"camera": {"bands": [{"name": "", "centre_nm": nm, "width_nm": 10.0} for nm in BANDS_NM]}}
DARK = (13, 15, 20)


def image_of(reflectance):
    """An image of 4 x 400 pixels whose red and infrared give each NDVI of `ndvi`."""
    return LabelledImage("000000", None, None, reflectance=reflectance, metadata=METADATA)


@pytest.fixture
def ndvi():
    """From -0.2 to 1, and one that is not known."""
    values = np.tile(np.linspace(-0.2, 1.0, 400, dtype=np.float32), (4, 1))
    values[0, 0] = np.nan
    return values


@pytest.fixture
def image(ndvi):
    reflectance = np.full((*ndvi.shape, 5), 0.2, np.float32)
    reflectance[..., 2], reflectance[..., 4] = 0.3 * (1.0 - ndvi), 0.3 * (1.0 + ndvi)
    return image_of(reflectance)


def test_index_is_the_normalised_difference(image, ndvi):
    values = spectral_index("ndvi", image.reflectance, BANDS_NM)
    np.testing.assert_allclose(values, ndvi, atol=1e-6)
    assert np.isnan(values[0, 0])
    # Two bands without any signal.
    assert spectral_index("ndvi", np.zeros((1, 5)), BANDS_NM) == 0.0
    assert available_indices(image) == ("ndvi", "ndre")
    with pytest.raises(InputError, match="pri: needs a band from 526 to 536 nm"):
        spectral_index("pri", image.reflectance, BANDS_NM)
    with pytest.raises(ArgumentError, match="must be one of ndvi, ndre, pri"):
        spectral_index("savi", image.reflectance, BANDS_NM)


@pytest.mark.parametrize(("palette", "map_name"), [("viridis", "viridis"), ("red-green", "RdYlGn")])
def test_colours_are_those_of_the_palette_and_of_its_scale(image, ndvi, palette, map_name):
    picture = index_picture(image, "ndvi", palette)
    assert picture.shape == (4 + 36, 400, 3)
    assert picture.dtype == np.uint8
    assert tuple(picture[0, 0]) == DARK
    expected = 255.0 * matplotlib.colormaps[map_name](np.clip(ndvi[1], 0.0, 1.0))[:, :3]
    assert np.abs(picture[1] - expected).max() < 8.0
    # The bar, from 0 to 1.
    bar = picture[4 + 9, 80:380]
    expected = 255.0 * matplotlib.colormaps[map_name](np.linspace(0.0, 1.0, 300))[:, :3]
    assert np.abs(bar - expected).max() < 8.0


def test_small_images_are_enlarged_by_whole_numbers(image):
    small = image_of(image.reflectance[:, ::5])
    picture, large = index_picture(small), index_picture(image)
    assert picture.shape == (4 * 4 + 36, 320, 3)
    np.testing.assert_array_equal(picture[: 4 * 4 : 4, ::4], large[:4, ::5])


def test_images_without_bands_have_no_index():
    with pytest.raises(InputError, match="has no reflectance in bands"):
        index_picture(LabelledImage("photo", np.zeros((2, 2, 3), np.uint8), None))
    assert available_indices(LabelledImage("photo", np.zeros((2, 2, 3), np.uint8), None)) == ()
