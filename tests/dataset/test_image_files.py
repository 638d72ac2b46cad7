"""Image files: exact values and reproducible bytes, read by this package and by other libraries."""

from __future__ import annotations

import io

import cv2
import numpy as np
import OpenEXR
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from PIL import Image

from pepperscene.classes import CLASS_COLOURS
from pepperscene.dataset.store import images as encoding
from pepperscene.dataset.store.images import encode_image, png_bytes, read_image, write_image
from pepperscene.errors import InputError
from pepperscene.outputs import OUTPUTS


def example(output):
    """Values that use the whole range of an output."""
    if not OUTPUTS[output].is_image:
        return {"format": f"pepperscene {output} 1", "fruit": [{"instance": 3, "pose": [[1.0, 0.1]]}]}
    rng = np.random.default_rng(3)
    shape = (37, 53, *OUTPUTS[output].channels[-1:])
    if OUTPUTS[output].dtype.startswith("float"):
        values = rng.normal(0, 1e3, shape).astype(OUTPUTS[output].dtype)
        tiny = np.finfo(values.dtype).smallest_subnormal * 3
        for column, value in enumerate((np.inf, -np.inf, np.nan, tiny)):
            values[0, column] = value
        return values
    end = 8 if output == "class" else np.iinfo(OUTPUTS[output].dtype).max + 1
    return rng.integers(0, end, shape).astype(OUTPUTS[output].dtype)


@pytest.mark.parametrize("output", [name for name, output in OUTPUTS.items() if output.suffix != ".jpg"])
def test_every_output_is_read_back_exactly_from_reproducible_bytes(tmp_path, output):
    path, image = tmp_path / f"x{OUTPUTS[output].suffix}", example(output)
    write_image(path, image, output)
    content, result = path.read_bytes(), read_image(path)
    if not OUTPUTS[output].is_image:
        assert result == image
    else:
        assert result.dtype == image.dtype
        np.testing.assert_array_equal(result, image)
    write_image(path, example(output), output)
    assert path.read_bytes() == content


@pytest.mark.parametrize(
    ("output", "channels", "dtype"),
    [
        ("class", (), "u2"), ("class", (3,), "u1"), ("colour", (), "u1"), ("colour", (4,), "u1"),
        ("distance", (), "f8"), ("distance", (1,), "f4"), ("electrons", (), "f4"), ("electrons", (2,), "f4"),
        ("raw", (3,), "u2"), ("raw", (), "u1"), ("coverage", (8,), "f4"), ("coverage", (7,), "f2"),
        ("uv", (3,), "f4"), ("flow", (2,), "f4"), ("harvest", (), "f4"), ("amodal", (), "u1"),
        ("albedo", (3,), "f4"), ("albedo", (2,), "f2"), ("albedo", (), "f2"),
    ],
)  # fmt: skip
def test_rejects_arrays_that_do_not_fit_the_output(tmp_path, output, channels, dtype):
    with pytest.raises(ValueError, match=output):
        write_image(tmp_path / "x", np.zeros((4, 4, *channels), dtype), output)
    assert not (tmp_path / "x").exists()


@pytest.mark.parametrize("output", ["colour", "distance", "harvest"])
def test_missing_damaged_and_truncated_files_are_input_errors(tmp_path, output):
    path = tmp_path / f"x{OUTPUTS[output].suffix}"
    content = encode_image(example(output), output)
    for damaged in (None, b"\x89PNG\r\n\x1a\n nothing", content[: -min(200, len(content) // 2)]):
        if damaged is not None:
            path.write_bytes(damaged)
        with pytest.raises(InputError, match="cannot be read"):
            read_image(path)


def test_objects_must_be_valid_json(tmp_path):
    for content, output in (([1, 2], "harvest"), ({"fruit": []}, "class")):
        with pytest.raises(ValueError, match=output):
            write_image(tmp_path / "x", content, output)
    with pytest.raises(ValueError, match="JSON"):
        write_image(tmp_path / "x", {"fruit": float("nan")}, "harvest")
    (tmp_path / "x.json").write_text("[1, 2]")
    with pytest.raises(InputError, match="no JSON object"):
        read_image(tmp_path / "x.json")


@pytest.mark.parametrize(
    ("output", "channels"),
    [
        *((name, [name]) for name in ("distance", "depth_z", "depth_sensor", "depth_confidence", "leaf_age")),
        *((name, ["R", "G", "B"]) for name in ("electrons", "albedo")),
        *((name, ["X", "Y", "Z"]) for name in ("normal", "position")),
        ("uv", ["U", "V"]),
        *((name, [f"{name}.x", f"{name}.y", "visible"]) for name in ("flow", "stereo")),
        ("coverage", ["background", "leaf", "pepper", "peduncle", "stem", "shoot", "wire", "cut"]),
    ],
)
def test_exr_has_named_channels_and_a_unit(tmp_path, output, channels):
    path, image = tmp_path / "x.exr", example(output)
    write_image(path, image, output)
    with OpenEXR.File(str(path), separate_channels=True) as file:
        assert set(file.channels()) == set(channels)
        assert file.header()["unit"]
        for axis, name in enumerate(channels):
            pixels = file.channels()[name].pixels
            assert pixels.dtype == OUTPUTS[output].dtype
            np.testing.assert_array_equal(pixels, np.atleast_3d(image)[..., axis])


def test_images_are_compressed(tmp_path):
    image = np.zeros((100, 100, 8), np.float16)
    image[:, :50, 0], image[:, 50:, 1] = 1, 1
    write_image(tmp_path / "x.exr", image, "coverage")
    assert (tmp_path / "x.exr").stat().st_size < 0.05 * image.nbytes
    # A constant image of 1.44 MB takes less than a hundredth.
    assert len(png_bytes(np.full((600, 800, 3), 77, np.uint8))) < 14_400


@pytest.mark.parametrize("output", ["electrons", "albedo"])
def test_measures_of_a_monochrome_sensor_have_one_channel(output, tmp_path):
    path, image = tmp_path / "x.exr", example(output)[..., :1]
    write_image(path, image, output)
    np.testing.assert_array_equal(read_image(path), image)
    with OpenEXR.File(str(path), separate_channels=True) as file:
        assert set(file.channels()) == {"Y"}


def open_png(content):
    return Image.open(io.BytesIO(content), formats=["PNG"])


def shapes(*tail):
    return st.tuples(st.integers(1, 9), st.integers(1, 9)).map(lambda shape: (*shape, *tail))


@given(
    st.one_of(
        arrays("uint8", shapes()), arrays("uint16", shapes()), *(arrays("uint8", shapes(n)) for n in (3, 4))
    )
)
def test_pillow_and_opencv_read_the_same_png_values(image):
    content = png_bytes(image)
    with open_png(content) as picture:
        np.testing.assert_array_equal(np.asarray(picture), image)
    result = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_UNCHANGED)
    channels = [2, 1, 0, 3][: image.shape[-1]]  # of OpenCV
    np.testing.assert_array_equal(result[..., channels] if image.ndim == 3 else result, image)


@given(arrays("uint8", shapes(), elements=st.integers(0, 2)))
def test_palette_png_has_indices_and_colours(image):
    colours = ((9, 8, 7), (255, 0, 128), (1, 2, 3))
    with open_png(png_bytes(image, colours)) as picture:
        np.testing.assert_array_equal(np.asarray(picture), image)
        np.testing.assert_array_equal(np.asarray(picture.convert("RGB")), np.array(colours, "u1")[image])


def test_class_png_shows_the_class_colours(tmp_path):
    write_image(tmp_path / "c.png", np.arange(8, dtype=np.uint8).reshape(2, 4), "class")
    with Image.open(tmp_path / "c.png") as picture:
        assert picture.mode == "P"
        rgb = np.asarray(picture.convert("RGB")).reshape(8, 3)
    assert [tuple(colour) for colour in rgb.tolist()] == list(CLASS_COLOURS)


@pytest.mark.parametrize(
    ("shape", "dtype", "palette"),
    [
        ((2, 2), np.float32, None), ((2, 2), np.int16, None), ((2, 2, 3), np.uint16, None),
        ((2, 2, 5), np.uint8, None), ((2, 2, 3, 1), np.uint8, None), ((4,), np.uint8, None),
        ((0, 4), np.uint8, None), ((2, 2), np.uint16, ((0, 0, 0),)),
        ((2, 2, 3), np.uint8, ((0, 0, 0),)),
    ],
)  # fmt: skip
def test_rejects_arrays_that_are_no_png(shape, dtype, palette):
    with pytest.raises(ValueError, match="does not fit this PNG type"):
        png_bytes(np.zeros(shape, dtype), palette)


def test_png_depends_neither_on_the_size_of_its_parts_nor_on_memory_layout(monkeypatch):
    images = [example("colour"), example("instance"), example("class")]
    expected = [png_bytes(image) for image in images]
    assert [png_bytes(np.asfortranarray(image)) for image in images] == expected
    for part in (1, 1000):
        monkeypatch.setattr(encoding, "_PNG_PART", part)
        assert [png_bytes(image) for image in images] == expected
