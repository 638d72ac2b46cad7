"""Short representations, and the HTML by which notebooks show frames, data sets, builds and plants."""

from __future__ import annotations

import base64
import re
from io import BytesIO
from xml.etree import ElementTree

import numpy as np
import pytest
from PIL import Image

from pepperscene.cultivar import load_cultivar
from pepperscene.dataset.store.dataset import open_dataset
from pepperscene.frame import Frame
from pepperscene.grammar import grow
from pepperscene.notebook_view import WIDTH_PX
from pepperscene.outputs import DEFAULT_OUTPUTS

SOURCE = re.compile(r'src="data:image/png;base64,([^"]+)"')


def pictures(text):
    """The pictures of an HTML text."""
    return [np.asarray(Image.open(BytesIO(base64.b64decode(data)))) for data in SOURCE.findall(text)]


def test_frame_shows_images_of_8_bits_and_colours_of_classes():
    colour = np.full((30, 40, 3), (200, 100, 50), np.uint8)
    images = {
        "colour": colour,
        "class": np.full((30, 40), 2, np.uint8),
        "instance": np.zeros((30, 40), np.uint16),
        "distance": np.zeros((30, 40), np.float32),
        "harvest": {"fruit": []},
    }
    frame = Frame(images)
    assert repr(frame) == "Frame(colour, class, instance, distance, harvest, 40x30)"
    shown = pictures(frame._repr_html_())
    np.testing.assert_array_equal(shown[0], colour)
    assert (shown[1] == (255, 252, 82)).all()
    assert len(shown) == 2
    assert (repr(Frame({})), pictures(Frame({})._repr_html_())) == ("Frame()", [])
    # Large pictures are reduced.
    (large,) = pictures(Frame({"colour": np.zeros((900, 1200, 3), np.uint8)})._repr_html_())
    assert large.shape == (WIDTH_PX * 3 // 4, WIDTH_PX, 3)


@pytest.mark.usefixtures("empty_scenes")
def test_data_set_and_build_show_some_frames(build_small, fake_renderer, tmp_path):
    result = build_small("set <b>", "0:9", DEFAULT_OUTPUTS, renderer=fake_renderer)
    dataset = open_dataset(tmp_path / "set <b>")
    assert "9 frames of" in repr(dataset)
    assert len(repr(dataset)) < 120 + len(str(tmp_path))
    assert repr(result) == f"BuildResult(9 frames made, 0 kept, {dataset!r})"
    for text in (dataset._repr_html_(), result._repr_html_()):
        assert len(pictures(text)) == 5
        assert "frame 8" in text
        assert "<b>" not in text
    # Damaged and missing pictures are left out.
    dataset.path(0, "colour").write_bytes(b"damaged")
    for output in ("colour", "class", "distance_code", "instance"):
        dataset.path(2, output).unlink()
    assert len(pictures(dataset._repr_html_())) == 3


def test_plant_is_drawn_from_the_side():
    plant = grow(load_cultivar("kaite"), np.random.default_rng(1))
    fruit = len(plant.of_form("fruit"))
    assert re.fullmatch(
        rf"Plant\(.*kaite.*, {len(plant.organs)} organs, {fruit} fruit, \d\.\d\d m high\)", repr(plant), re.I
    )
    drawing = ElementTree.fromstring(re.search("<svg.*</svg>", plant._repr_html_()).group())
    lines = drawing.findall("{http://www.w3.org/2000/svg}polyline")
    assert len(lines) == len(plant.organs)
    # The stem's foot is at the bottom, and no point is outside of the picture.
    _, _, width, height = map(float, drawing.get("viewBox").split())
    points = np.array(
        [[float(c) for c in p.split(",")] for line in lines for p in line.get("points").split()]
    )
    assert (points >= 0).all()
    assert (points <= (width, height)).all()
    assert float(lines[0].get("points").split()[0].split(",")[1]) > 0.8 * height
