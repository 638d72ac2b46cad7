from __future__ import annotations

import base64
import io
import json
import re
import shutil
import weakref
from html.parser import HTMLParser

import numpy as np
import pytest
from PIL import Image

from pepperscene.classes import OrganClass
from pepperscene.dataset import BuildOptions, build, open_dataset, write_report
from pepperscene.dataset.readers.image_set import FIELDS, ImageSet, LabelledImage
from pepperscene.dataset.report.data import (
    NUMBERS,
    distance_range,
    evenly_spaced,
    frame_records,
    image_statistics,
)
from pepperscene.errors import InputError, OutputError
from pepperscene.frame import DEFAULT_OUTPUTS

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

    def handle_startendtag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def pictures(self, *kinds):
        return [attrs for tag, attrs in self.tags if tag == "img" and attrs.get("class") in kinds]


class Made(ImageSet):
    """Pictures made up when they are asked for."""

    def names(self):
        return tuple(f"made{item}" for item in self.items)

    def read(self, item):
        rng = np.random.default_rng(item)
        colour = rng.integers(0, 256, (30, 40, 3)).astype(np.uint8) if "colour" in self.fields else None
        classes = np.full((30, 40), 255, np.uint8)
        classes[:15] = 2
        return LabelledImage(f"made{item}", colour, classes if "classes" in self.fields else None)


@pytest.fixture(scope="module")
def shelf(tmp_path_factory):
    """Data sets that were built already: building takes longer than what is examined here."""
    return tmp_path_factory.mktemp("shelf")


@pytest.fixture
def make(recipe, fake_renderer, shelf, tmp_path):
    def run(recipe=recipe, frames="0:24", outputs=DEFAULT_OUTPUTS):
        kept = shelf / f"{'-'.join(outputs)} {frames} {recipe.sha256()}".replace(":", "-")
        if not kept.exists():
            build(recipe, kept, frames, outputs, BuildOptions(renderer=fake_renderer))
        return shutil.copytree(kept, tmp_path / "set", dirs_exist_ok=True)

    return run


@pytest.fixture
def photographs():
    return Made(name="made & up", items=tuple(range(5)), fields=FIELDS)


SHOWN = ("colour", "class", "instance", "distance")


def test_the_page_holds_every_picture_and_needs_no_network(make):
    done = write_report(make(frames="0:3"))
    text = done.page.read_text(encoding="utf-8")
    found = Page(text).pictures(*SHOWN)
    assert len(found) == 3 * 4
    for attrs in found:
        kind, data = re.fullmatch(r"data:image/(png|jpeg);base64,(.+)", attrs["src"]).groups()
        with Image.open(io.BytesIO(base64.b64decode(data)), formats=[kind.upper()]) as shown:
            assert shown.size == (8, 6) == (int(attrs["width"]), int(attrs["height"]))
    assert "://" not in text
    links = [attrs["href"] for _, attrs in Page(text).tags if attrs.get("href")]
    assert all(link.startswith(("#", "data:")) for link in links)
    assert not [tag for tag, _ in Page(text).tags if tag in ("iframe", "object", "embed")]
    assert "default-src 'none'" in text


def test_links_within_the_page_lead_somewhere_and_names_are_unique(make, photographs):
    tags = Page(write_report(make(frames="0:3"), beside=photographs).page.read_text(encoding="utf-8")).tags
    names = [attrs["id"] for _, attrs in tags if "id" in attrs]
    assert len(names) == len(set(names))
    targets = [attrs["href"][1:] for _, attrs in tags if attrs.get("href", "").startswith("#")]
    assert len(targets) > 3 + 5
    assert set(targets) <= set(names)
    labels = [attrs["aria-labelledby"].split() for _, attrs in tags if "aria-labelledby" in attrs]
    assert set().union(*labels) <= set(names)


def test_class_shares_add_up(make):
    text = write_report(make(frames="0:2")).page.read_text(encoding="utf-8")
    table = text.partition('class="shares"')[2].partition("</table>")[0]
    shares = [float(found) for found in re.findall(r"<td>([\d.]+)\u00a0%</td>", table)]
    assert len(shares) == len(OrganClass)
    assert sum(shares) == pytest.approx(100, abs=0.05)


def test_a_second_set_stands_beside_the_first_in_every_figure(make, photographs):
    done = write_report(make(frames="0:3"), beside=photographs, limit=2)
    assert (done.shown, done.frames) == (2, 3)
    text = done.page.read_text(encoding="utf-8")
    page = Page(text)
    assert "made &amp; up" in text
    assert len(page.pictures("colour")) == 2 + 2
    assert len(page.pictures("mean")) == 2
    # Half of every made-up picture is fruit, and nobody says what the other half is.
    table = text.partition('class="shares"')[2].partition("</table>")[0]
    assert [re.findall(r"<td>([^<]*)</td>", row)[1] for row in table.split("<tr>")[2:]] == [
        "–", "–", "50.00\u00a0%", *"–––––", "50.00\u00a0%",
    ]  # fmt: skip
    assert len(page.pictures("map")) == len(OrganClass) + 1
    lines = [attrs["class"] for tag, attrs in page.tags if tag == "polyline"]
    assert lines.count("b") == 2
    assert text.count("Correlation of the two") == 1


def test_a_data_set_can_stand_beside_itself_and_is_alike(make):
    folder = make(frames="0:3")
    text = write_report(folder, beside=folder).page.read_text(encoding="utf-8")
    correlations = [float(found) for found in re.findall(r"<b>r = ([-\d.]+)</b>", text)]
    assert correlations == [1.0] * len(OrganClass)


def test_the_contact_sheet_shows_the_pictures_side_by_side(make):
    with Image.open(write_report(make(frames="0:2")).sheet) as sheet:
        assert sheet.format == "PNG"
        assert sheet.width > 4 * 400
        two = sheet.height
    with Image.open(write_report(make(frames="0:3")).sheet) as sheet:
        # One frame more is one row of pictures more.
        assert sheet.height - two > 300


def test_frames_beyond_the_limit_are_spread(make):
    done = write_report(make(), limit=4, sample=10)
    assert (done.shown, done.measured, done.frames) == (4, 10, 24)
    text = done.page.read_text(encoding="utf-8")
    assert [int(found) for found in re.findall(r"<h3>Frame (\d+)</h3>", text)] == [0, 8, 15, 23]
    assert "10 of 24" in text
    # The shares are of all frames, as their own JSON tell.
    assert "in 24 pictures of" in text


def test_outputs_that_are_not_there_are_left_out(make):
    done = write_report(make(frames="0:1", outputs=("instance", "electrons")))
    page = Page(done.page.read_text(encoding="utf-8"))
    assert [attrs["class"] for tag, attrs in page.tags if tag == "img" and "src" in attrs] == ["instance"]


def test_names_cannot_inject_markup(make, recipe, photographs):
    named = recipe.model_copy(update={"name": '<script>alert("x")</script>'})
    other = Made(name="<b onclick='x'>", items=photographs.items)
    text = write_report(make(named, frames="0:1"), beside=other).page.read_text(encoding="utf-8")
    assert sum(tag == "script" for tag, _ in Page(text).tags) == 1
    assert "&lt;script&gt;" in text
    assert not [attrs for _, attrs in Page(text).tags if "onclick" in attrs]


def test_the_same_set_gives_the_same_page(make):
    folder = make(frames="0:4")
    assert write_report(folder).page.read_bytes() == write_report(folder).page.read_bytes()


def test_a_report_does_not_stop_a_build_from_going_on(make, recipe, fake_renderer):
    folder = make(frames="0:1")
    write_report(folder)
    build(recipe, folder, "0:2", options=BuildOptions(renderer=fake_renderer))
    assert write_report(folder).frames == 2


def test_no_data_set_or_no_frames_is_an_input_error(make, tmp_path):
    with pytest.raises(InputError, match="no data set"):
        write_report(tmp_path)
    folder = make(frames="0:1")
    (folder / "frames" / "000000.json").unlink()
    with pytest.raises(InputError, match="no frames"):
        write_report(folder)
    with pytest.raises(InputError, match="nowhere"):
        write_report(make(frames="0:1"), beside=tmp_path / "nowhere")


def test_a_damaged_image_is_an_input_error_and_leaves_no_report(make):
    folder = make(frames="0:1")
    (folder / "colour" / "000000.png").write_bytes(b"nothing")
    with pytest.raises(InputError, match=r"000000\.png"):
        write_report(folder)
    assert not (folder / "index.html").exists()


def test_a_report_that_cannot_be_written_is_an_output_error(make):
    folder = make(frames="0:1")
    (folder / "index.html").mkdir()
    with pytest.raises(OutputError, match="cannot be written"):
        write_report(folder)


# --- what is gathered ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(("count", "most"), [(1, 1), (5, 9), (9, 9), (10_500, 12), (7, 1)])
def test_places_are_spread_over_the_whole(count, most):
    places = evenly_spaced(count, most)
    assert len(places) == min(count, most) == len(set(places))
    assert places == sorted(places)
    assert places[0] == 0
    if most > 1:
        assert places[-1] == count - 1
        assert np.ptp(np.diff(places)) <= 1 if len(places) > 2 else True


def test_pictures_are_measured_in_order_and_told(photographs):
    told = []
    statistics = image_statistics(photographs, 4, lambda done, of: told.append((done, of)))
    assert told == [(1, 4), (2, 4), (3, 4), (4, 4)]
    expected = [np.asarray(Image.fromarray(photographs[k].colour).convert("L")).mean() for k in (0, 1, 3, 4)]
    np.testing.assert_allclose(statistics.intensities, expected)


def test_few_pictures_are_in_memory_at_a_time():
    alive, most = set(), []

    class Watched(Made):
        def read(self, item):
            picture = super().read(item)
            alive.add(item)
            weakref.finalize(picture, alive.discard, item)
            most.append(len(alive))
            return picture

    image_statistics(Watched(name="long", items=tuple(range(300))), 300)
    assert len(most) == 300
    assert max(most) < 20


def test_a_fault_ends_the_reading(photographs):
    class Broken(Made):
        def read(self, item):
            if item == 3:
                raise InputError("made3", "is broken")
            return super().read(item)

    with pytest.raises(InputError, match="is broken"):
        image_statistics(Broken(name="broken", items=tuple(range(50))), 50)


def test_a_set_without_distances_has_no_range(photographs):
    assert distance_range(photographs, [0, 1]) is None


# --- what the data set tells --------------------------------------------------------------------------------


def test_records_are_those_of_the_frames(make):
    dataset = open_dataset(make(frames="0:4"))
    found = frame_records(dataset)
    assert found.indices.tolist() == [0, 1, 2, 3]
    assert set(found.numbers) == set(NUMBERS)
    sizes = [sum(path.stat().st_size for path in dataset.folder.glob(f"*/{k:06d}.*")
                 if path.parent.name != "frames") for k in range(4)]  # fmt: skip
    assert found.numbers["bytes"].tolist() == sizes
    for place, index in enumerate(dataset.indices()):
        counts = np.bincount(dataset.image(index, "class").ravel(), minlength=8)
        assert found.pixels[place].tolist() == counts.tolist()
    assert found.shares().sum() == pytest.approx(1.0)


def test_records_need_no_table_and_know_what_the_frames_tell(make):
    folder = make(frames="0:4")
    whole = frame_records(open_dataset(folder))
    for name in ("manifest.parquet", "journal.jsonl"):
        (folder / name).unlink(missing_ok=True)
    left = frame_records(open_dataset(folder))
    np.testing.assert_array_equal(left.pixels, whole.pixels)
    np.testing.assert_array_equal(left.numbers["bytes"], whole.numbers["bytes"])
    # How long a frame took stands nowhere else.
    assert not left.known("render_s").any()


def test_errors_are_shown(make):
    folder = make(frames="0:3")
    for name in ("manifest.parquet", "journal.jsonl"):
        (folder / name).unlink(missing_ok=True)
    for place in range(3):
        path = folder / "frames" / f"{place:06d}.json"
        facts = json.loads(path.read_text())
        facts["sampling"] = {"error_codes": 1.5 + place, "noise_codes": 10.0, "samples_per_pixel": 8.0}
        path.write_text(json.dumps(facts))
    text = write_report(folder).page.read_text(encoding="utf-8")
    assert "median <b>2.5</b>" in text
    assert "most 3.5 in frame 000002" in text
    assert "25 % of the sensor" in text
