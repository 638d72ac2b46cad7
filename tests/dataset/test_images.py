from __future__ import annotations

from typing import Any

import numpy as np
import OpenEXR
import pytest
from PIL import Image

from pepperscene.classes import CLASS_COLOURS
from pepperscene.dataset import read_image, write_image
from pepperscene.errors import InputError
from pepperscene.frame import OUTPUTS


def picture(output: str) -> Any:
    """Values that use the whole range of an output."""
    if output == "harvest":
        return {"format": "pepperscene harvest 1", "fruit": [{"instance": 3, "pose": [[1.0, 0.1]]}]}
    rng = np.random.default_rng(3)
    shape = (37, 53, *OUTPUTS[output].channels[-1:])
    if OUTPUTS[output].dtype.startswith("float"):
        values = rng.normal(0, 1e3, shape).astype(OUTPUTS[output].dtype)
        values[0, 0] = np.inf
        values[0, 1] = np.finfo(values.dtype).smallest_subnormal * 3
        values[0, 2] = np.nan
        return values
    top = 8 if output == "class" else np.iinfo(OUTPUTS[output].dtype).max + 1
    return rng.integers(0, top, shape).astype(OUTPUTS[output].dtype)


@pytest.mark.parametrize("output", OUTPUTS)
def test_every_output_comes_back_bit_for_bit(tmp_path, output):
    path = tmp_path / f"x{OUTPUTS[output].suffix}"
    image = picture(output)
    write_image(path, image, output)
    back = read_image(path)
    if output == "harvest":
        assert back == image
        return
    assert back.dtype == image.dtype
    np.testing.assert_array_equal(back, image)


@pytest.mark.parametrize("output", OUTPUTS)
def test_the_same_image_gives_the_same_bytes(tmp_path, output):
    for name in ("a", "b"):
        write_image(tmp_path / name, picture(output), output)
    assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes()


def test_class_png_shows_the_class_colours(tmp_path):
    ids = np.arange(8, dtype=np.uint8).reshape(2, 4)
    write_image(tmp_path / "c.png", ids, "class")
    with Image.open(tmp_path / "c.png") as shown:
        assert shown.mode == "P"
        rgb = np.asarray(shown.convert("RGB")).reshape(8, 3)
    assert [tuple(colour) for colour in rgb.tolist()] == list(CLASS_COLOURS)


@pytest.mark.parametrize("output", ["instance", "raw"])
def test_png_of_16_bits(tmp_path, output):
    write_image(tmp_path / "i.png", np.array([[0, 65535]], np.uint16), output)
    with Image.open(tmp_path / "i.png") as shown:
        assert shown.mode == "I;16"


@pytest.mark.parametrize(
    ("output", "channels"),
    [
        ("distance", ["distance"]),
        ("depth_z", ["depth_z"]),
        ("electrons", ["R", "G", "B"]),
        ("normal", ["X", "Y", "Z"]),
        ("position", ["X", "Y", "Z"]),
        ("uv", ["U", "V"]),
        ("flow", ["flow.x", "flow.y", "visible"]),
        ("stereo", ["stereo.x", "stereo.y", "visible"]),
        ("coverage", ["background", "leaf", "pepper", "peduncle", "stem", "shoot", "wire", "cut"]),
    ],
)
def test_exr_channels_are_named_and_the_header_tells_the_unit(tmp_path, output, channels):
    path, image = tmp_path / "x.exr", picture(output)
    write_image(path, image, output)
    with OpenEXR.File(str(path), separate_channels=True) as file:
        assert set(file.channels()) == set(channels)
        assert file.header()["unit"]
        for axis, name in enumerate(channels):
            plane = np.atleast_3d(image)[..., axis]
            pixels = file.channels()[name].pixels
            assert pixels.dtype == OUTPUTS[output].dtype
            np.testing.assert_array_equal(pixels, plane)


def test_coverage_of_few_edges_takes_little_space(tmp_path):
    image = np.zeros((100, 100, 8), np.float16)
    image[:, :50, 0], image[:, 50:, 1] = 1, 1
    write_image(tmp_path / "x.exr", image, "coverage")
    assert (tmp_path / "x.exr").stat().st_size < 0.05 * image.nbytes


def test_electrons_of_a_monochrome_sensor_have_one_channel(tmp_path):
    path, image = tmp_path / "x.exr", picture("electrons")[..., :1]
    write_image(path, image, "electrons")
    np.testing.assert_array_equal(read_image(path), image)
    with OpenEXR.File(str(path), separate_channels=True) as file:
        assert set(file.channels()) == {"Y"}


@pytest.mark.parametrize(
    ("output", "image"),
    [
        ("class", np.zeros((4, 4), np.uint16)),
        ("class", np.zeros((4, 4, 3), np.uint8)),
        ("colour", np.zeros((4, 4), np.uint8)),
        ("colour", np.zeros((4, 4, 4), np.uint8)),
        ("distance", np.zeros((4, 4), np.float64)),
        ("distance", np.zeros((4, 4, 1), np.float32)),
        ("electrons", np.zeros((4, 4), np.float32)),
        ("electrons", np.zeros((4, 4, 2), np.float32)),
        ("raw", np.zeros((4, 4, 3), np.uint16)),
        ("raw", np.zeros((4, 4), np.uint8)),
        ("coverage", np.zeros((4, 4, 8), np.float32)),
        ("coverage", np.zeros((4, 4, 7), np.float16)),
        ("uv", np.zeros((4, 4, 3), np.float32)),
        ("flow", np.zeros((4, 4, 2), np.float32)),
        ("harvest", np.zeros((4, 4), np.float32)),
        ("harvest", [1, 2]),
        ("class", {"fruit": []}),
    ],
)
def test_wrong_arrays_are_refused(tmp_path, output, image):
    with pytest.raises(ValueError, match=output):
        write_image(tmp_path / "x", image, output)
    assert not (tmp_path / "x").exists()


@pytest.mark.parametrize("name", ["x.png", "x.exr", "x.json"])
def test_damaged_or_missing_files_are_input_errors(tmp_path, name):
    with pytest.raises(InputError, match="cannot be read"):
        read_image(tmp_path / name)
    (tmp_path / name).write_bytes(b"\x89PNG\r\n\x1a\n nothing")
    with pytest.raises(InputError, match="cannot be read"):
        read_image(tmp_path / name)


def test_an_object_holds_what_json_knows(tmp_path):
    with pytest.raises(ValueError, match="JSON"):
        write_image(tmp_path / "x", {"fruit": float("nan")}, "harvest")
    (tmp_path / "x.json").write_text("[1, 2]")
    with pytest.raises(InputError, match="no JSON object"):
        read_image(tmp_path / "x.json")


def test_truncated_files_are_input_errors(tmp_path):
    for output in ("colour", "distance"):
        path = tmp_path / f"x{OUTPUTS[output].suffix}"
        write_image(path, picture(output), output)
        path.write_bytes(path.read_bytes()[:-200])
        with pytest.raises(InputError):
            read_image(path)
