"""OpenEXR files of our own, read by the library that owns the format."""

from __future__ import annotations

import cv2
import numpy as np
import OpenEXR
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pepperscene.dataset.store.images import exr_bytes


def read(path):
    with OpenEXR.File(str(path), separate_channels=True) as file:
        return dict(file.header()), {name: np.array(one.pixels) for name, one in file.channels().items()}


@given(
    st.integers(1, 40),
    st.integers(1, 40),
    st.lists(st.sampled_from(["Y", "R", "a.b", "visible", "distance"]), min_size=1, unique=True),
    st.sampled_from(["float16", "float32"]),
    st.integers(0, 2**32 - 1),
)
def test_the_library_reads_what_was_written(tmp_path_factory, height, width, names, kind, seed):
    rng = np.random.default_rng(seed)
    images = {name: rng.normal(size=(height, width)).astype(kind) for name in names}
    images[names[0]][0, 0] = [np.inf, -np.inf, np.nan, 0.0][seed % 4]
    path = tmp_path_factory.mktemp("exr") / "image.exr"
    path.write_bytes(exr_bytes(images, {"unit": "metres"}))
    header, found = read(path)
    assert set(found) == set(images)
    for name, image in images.items():
        assert found[name].dtype == image.dtype
        np.testing.assert_array_equal(found[name], image)
    assert header["unit"] == "metres"
    assert header["compression"] == OpenEXR.NO_COMPRESSION
    assert header["dataWindow"][1].tolist() == [width - 1, height - 1]
    # The library's own file has the same bytes.
    told = {"compression": OpenEXR.NO_COMPRESSION, "type": OpenEXR.scanlineimage, "unit": "metres"}
    OpenEXR.File(told, images).write(str(path.with_name("theirs.exr")))
    assert path.read_bytes() == path.with_name("theirs.exr").read_bytes()


def test_another_reader_agrees(tmp_path, monkeypatch):
    monkeypatch.setenv("OPENCV_IO_ENABLE_OPENEXR", "1")
    image = np.random.default_rng(3).uniform(size=(7, 5, 3)).astype(np.float32)
    path = tmp_path / "rgb.exr"
    path.write_bytes(exr_bytes({name: image[..., k] for k, name in enumerate("RGB")}, {}))
    try:
        found = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    except cv2.error as fault:
        pytest.skip(f"this OpenCV reads no OpenEXR: {fault}")
    if found is None:
        pytest.skip("this OpenCV reads no OpenEXR")
    np.testing.assert_array_equal(found[..., ::-1], image)


@pytest.mark.parametrize(
    "images",
    [
        {},
        {"Y": np.zeros((2, 3), np.float64)},
        {"Y": np.zeros(3, np.float32)},
        {"Y": np.zeros((0, 3), np.float32)},
        {"R": np.zeros((2, 3), np.float32), "G": np.zeros((3, 2), np.float32)},
        {"x" * 32: np.zeros((2, 3), np.float32)},
    ],
)
def test_what_makes_no_image_is_refused(images):
    with pytest.raises(ValueError, match="image"):
        exr_bytes(images, {})
