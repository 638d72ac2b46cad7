from __future__ import annotations

import base64
import colorsys
import io
import re
from html.parser import HTMLParser

import numpy as np
import pytest
from PIL import Image

from pepperscene.dataset import build, report
from pepperscene.dataset.display import VIRIDIS, distance_colours, instance_colours
from pepperscene.errors import InputError

pytestmark = pytest.mark.usefixtures("empty_scenes")


class Page(HTMLParser):
    """All tags of a page with their attributes, and a check that they close in order."""

    VOID = ("meta", "img", "input", "br", "link")

    def __init__(self, text):
        super().__init__()
        self.tags, self.open = [], []
        self.feed(text)
        assert self.open == []

    def handle_starttag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag


@pytest.fixture
def make(recipe, fake_renderer, tmp_path):
    def run(recipe=recipe, **arguments):
        build(recipe, tmp_path / "set", renderer=fake_renderer, **arguments)
        return tmp_path / "set"

    return run


def test_the_page_holds_every_picture_and_needs_no_network(make):
    done = report(make(frames="0:3"))
    text = done.page.read_text(encoding="utf-8")
    pictures = [attrs["src"] for tag, attrs in Page(text).tags if tag == "img" and "src" in attrs]
    assert len(pictures) == 3 * 4
    for source in pictures:
        kind, data = re.fullmatch(r"data:image/(png|jpeg);base64,(.+)", source).groups()
        with Image.open(io.BytesIO(base64.b64decode(data)), formats=[kind.upper()]) as shown:
            assert shown.size == (8, 6)
    assert "http" not in text
    assert not [attrs for tag, attrs in Page(text).tags if tag in ("link", "iframe") or attrs.get("href")]


def test_class_shares_add_up(make):
    text = report(make(frames="0:2")).page.read_text(encoding="utf-8")
    shares = [float(found) for found in re.findall(r"<td>([\d.]+) %</td>", text)]
    assert len(shares) == 8
    assert sum(shares) == pytest.approx(100, abs=0.05)


def test_the_contact_sheet_shows_the_pictures_side_by_side(make):
    with Image.open(report(make(frames="0:2")).sheet) as sheet:
        assert sheet.format == "PNG"
        assert sheet.width > 4 * 400
        two = sheet.height
    with Image.open(report(make(frames="0:3")).sheet) as sheet:
        # One frame more is one row of pictures more.
        assert sheet.height - two > 300


def test_frames_beyond_the_limit_are_spread(make):
    done = report(make(), limit=4)
    assert (done.shown, done.frames) == (4, 24)
    text = done.page.read_text(encoding="utf-8")
    assert [int(found) for found in re.findall(r"<h3>Frame (\d+)</h3>", text)] == [0, 8, 15, 23]


def test_outputs_that_are_not_there_are_left_out(make):
    done = report(make(frames="0:1", outputs=("instance", "electrons")))
    pictures = [attrs for tag, attrs in Page(done.page.read_text()).tags if tag == "img" and "src" in attrs]
    assert [attrs["class"] for attrs in pictures] == ["instance"]


def test_names_cannot_inject_markup(make, recipe):
    named = recipe.model_copy(update={"name": '<script>alert("x")</script>'})
    text = report(make(named, frames="0:1")).page.read_text(encoding="utf-8")
    assert sum(tag == "script" for tag, _ in Page(text).tags) == 1
    assert "&lt;script&gt;" in text


def test_a_report_does_not_stop_a_build_from_going_on(make):
    report(make(frames="0:1"))
    report(make(frames="0:2"))


def test_no_data_set_or_no_frames_is_an_input_error(make, tmp_path):
    with pytest.raises(InputError, match="no data set"):
        report(tmp_path)
    folder = make(frames="0:1")
    (folder / "frames" / "000000.json").unlink()
    with pytest.raises(InputError, match="no frames"):
        report(folder)


def test_a_damaged_image_is_an_input_error_and_leaves_no_report(make):
    folder = make(frames="0:1")
    (folder / "colour" / "000000.png").write_bytes(b"nothing")
    with pytest.raises(InputError, match=r"000000\.png"):
        report(folder)
    assert not (folder / "index.html").exists()


# --- colours ------------------------------------------------------------------------------------------------


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


def test_neighbouring_instances_have_hues_far_apart():
    colours = instance_colours(np.arange(1, 500)[None])[0]
    hue = np.array([colorsys.rgb_to_hsv(*(c / 255))[0] for c in colours])
    step = np.abs(np.diff(hue))
    assert np.minimum(step, 1 - step).min() > 0.3
    np.testing.assert_array_equal(instance_colours(np.array([[7, 0], [0, 7]]))[0, 0], colours[6])
