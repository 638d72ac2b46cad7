"""The report: its page, its contact sheet, and the numbers in them."""

from __future__ import annotations

import base64
import io
import re
import shutil
import weakref

import numpy as np
import pytest
from data_sets import RandomImages, set_without_plants
from hostile_set import edit_json
from PIL import Image
from report_page import Page

from pepperscene.classes import OrganClass
from pepperscene.dataset.store.dataset import open_dataset
from pepperscene.errors import InputError, OutputError
from pepperscene.outputs import DEFAULT_OUTPUTS
from pepperscene.review.report import write_report
from pepperscene.review.report.data import (
    NUMBERS,
    evenly_spaced,
    frame_records,
    image_statistics,
)

PANELS = ("colour", "class", "instance", "distance")


def images(page, *kinds):
    return [attrs for attrs in page.of("img") if attrs.get("class") in kinds]


def fractions(page):
    return page.text.partition('class="fractions"')[2].partition("</table>")[0]


@pytest.fixture(scope="module")
def cache(tmp_path_factory):
    """Data sets that are built once and copied for each test."""
    return tmp_path_factory.mktemp("cache")


@pytest.fixture
def make(cache, tmp_path):
    def run(frames=3, outputs=DEFAULT_OUTPUTS, **changes):
        cached = cache / "-".join([*outputs, str(frames), *map(str, changes)])
        if not cached.exists():
            set_without_plants(cached, range(frames), outputs, changes=changes)
        return shutil.copytree(cached, tmp_path / "set", dirs_exist_ok=True)

    return run


@pytest.fixture
def photographs():
    return RandomImages(name="random & co", items=tuple(range(5)))


def remove_tables(folder):
    for name in ("manifest.parquet", "journal.jsonl"):
        (folder / name).unlink(missing_ok=True)


@pytest.fixture(scope="module")
def compared(cache):
    """The page of three frames beside photographs, at most two of each, and the result."""
    folder = set_without_plants(cache / "compared", range(3), DEFAULT_OUTPUTS).folder
    photographs = RandomImages(name="random & co", items=tuple(range(5)))
    result = write_report(folder, beside=photographs, limit=2)
    return Page(result.page), result


def test_page_contains_its_images_and_needs_no_network(make):
    folder = make()
    page = Page(write_report(folder).page)
    assert len(images(page, *PANELS)) == 3 * 4
    # The script draws the others, which `test_report_overlays.py` examines.
    for attrs in images(page, "colour", "distance"):
        kind, data = re.fullmatch(r"data:image/(png|jpeg);base64,(.+)", attrs["src"]).groups()
        with Image.open(io.BytesIO(base64.b64decode(data)), formats=[kind.upper()]) as image:
            assert image.size == (8, 6) == (int(attrs["width"]), int(attrs["height"]))
    assert "://" not in page.text
    assert page.policy()["default-src"] == ["'none'"]
    assert write_report(folder).page.read_text(encoding="utf-8") == page.text
    percentages = [float(value) for value in re.findall(r"<td>([\d.]+)\u00a0%</td>", fractions(page))]
    assert len(percentages) == len(OrganClass)
    assert sum(percentages) == pytest.approx(100, abs=0.05)


def test_links_have_targets_and_ids_are_unique(compared):
    page, _ = compared
    assert len(page.links()) > 2 + 2
    ids = {attrs["id"] for _, attrs in page.elements if "id" in attrs}
    assert {name for _, attrs in page.elements for name in attrs.get("aria-labelledby", "").split()} <= ids


def test_second_set_is_in_every_figure(compared):
    page, result = compared
    assert (result.shown, result.frames) == (2, 3)
    assert "random &amp; co" in page.text
    assert len(images(page, "colour")) == 2 + 2
    assert len(images(page, "mean")) == 2
    # Half of every photograph is fruit, the other half has no label.
    assert [re.findall(r"<td>([^<]*)</td>", row)[1] for row in fractions(page).split("<tr>")[2:]] == [
        "–", "–", "50.00\u00a0%", *"–––––", "50.00\u00a0%",
    ]  # fmt: skip
    assert len(images(page, "map")) == len(OrganClass) + 1
    dashed = [attrs for attrs in page.of("path") if "stroke-dasharray" in attrs]
    assert len(dashed) == 2
    assert all(attrs["stroke"] == "var(--b)" for attrs in dashed)
    assert page.text.count("Correlation of the two") == 1


def test_set_compared_with_itself_has_correlation_1(make):
    folder = make()
    page = Page(write_report(folder, beside=folder).page)
    correlations = [float(value) for value in re.findall(r"<b>r = ([-\d.]+)</b>", page.text)]
    assert correlations == [1.0] * len(OrganClass)


def test_contact_sheet_has_a_row_per_frame(make):
    heights, folder = [], make()
    for limit in (2, 3):
        with Image.open(write_report(folder, limit).sheet) as sheet:
            assert sheet.format == "PNG"
            assert sheet.width > 4 * 400
            heights.append(sheet.height)
    assert heights[1] - heights[0] > 300


def test_shown_frames_are_evenly_spaced(make):
    result = write_report(make(24), limit=4, sample=10)
    assert (result.shown, result.measured, result.frames) == (4, 10, 24)
    text = Page(result.page).text
    assert [int(index) for index in re.findall(r"<h3>Frame (\d+)</h3>", text)] == [0, 8, 15, 23]
    assert "10 evenly spaced of 24 images" in text
    # The class fractions are those of all frames, from the manifest.
    assert "in 24 images of" in text


def test_missing_outputs_have_no_panel(make):
    page = Page(write_report(make(1, ("instance", "electrons"))).page)
    assert [attrs["class"] for attrs in page.of("img") if "src" in attrs] == ["instance"]


def test_images_with_similar_names_have_different_links(make, tmp_path):
    for name in ("a/b", "a-b"):
        path = tmp_path / "photographs" / "images" / f"{name}.png"
        path.parent.mkdir(parents=True, exist_ok=True)
        Image.new("RGB", (8, 6)).save(path)
    page = Page(write_report(make(1), beside=tmp_path / "photographs").page)
    ids = [attrs["id"] for attrs in page.of("article")]
    assert len(set(ids)) == 1 + 2
    assert page.links()[-2:] == ids[1:]


def test_missing_data_set_or_frames_are_an_input_error(make, tmp_path):
    with pytest.raises(InputError, match="no data set"):
        write_report(tmp_path)
    folder = make(1)
    with pytest.raises(InputError, match="nowhere"):
        write_report(folder, beside=tmp_path / "nowhere")
    (folder / "frames" / "000000.json").unlink()
    with pytest.raises(InputError, match="no frames"):
        write_report(folder)


def test_damaged_image_and_unwritable_page_are_errors(make):
    folder = make(1)
    path = folder / "colour" / "000000.png"
    content = path.read_bytes()
    path.write_bytes(b"nothing")
    with pytest.raises(InputError, match=r"000000\.png"):
        write_report(folder)
    assert not (folder / "index.html").exists()
    path.write_bytes(content)
    (folder / "index.html").mkdir()
    with pytest.raises(OutputError, match="cannot be written"):
        write_report(folder)


@pytest.mark.parametrize(("count", "limit"), [(1, 1), (5, 9), (9, 9), (10_500, 12), (7, 1)])
def test_evenly_spaced_positions(count, limit):
    positions = evenly_spaced(count, limit)
    assert len(positions) == min(count, limit) == len(set(positions))
    assert positions == sorted(positions)
    assert positions[0] == 0
    if limit > 1:
        assert positions[-1] == count - 1
        assert len(positions) <= 2 or np.ptp(np.diff(positions)) <= 1


def test_images_are_measured_in_order_with_progress(photographs):
    progress = []
    statistics = image_statistics(photographs, 4, lambda done, total: progress.append((done, total)))
    assert progress == [(1, 4), (2, 4), (3, 4), (4, 4)]
    grey = [np.asarray(Image.fromarray(photographs[k].colour).convert("L")).mean() for k in (0, 1, 3, 4)]
    np.testing.assert_allclose(statistics.intensities, grey)


def test_few_images_are_in_memory_at_a_time():
    alive, counts = set(), []

    class WatchedImages(RandomImages):
        def read(self, item):
            image = super().read(item)
            alive.add(item)
            weakref.finalize(image, alive.discard, item)
            counts.append(len(alive))
            return image

    image_statistics(WatchedImages(name="watched", items=tuple(range(300))), 300)
    assert len(counts) == 300
    assert max(counts) < 20


def test_records_match_the_files(make):
    dataset = open_dataset(make())
    records = frame_records(dataset)
    assert records.indices.tolist() == [0, 1, 2]
    assert set(records.numbers) == set(NUMBERS)
    for position, index in enumerate(dataset.indices()):
        paths = [dataset.path(index, output) for output in DEFAULT_OUTPUTS]
        assert records.numbers["bytes"][position] == sum(path.stat().st_size for path in paths)
        counts = np.bincount(dataset.image(index, "class").ravel(), minlength=8)
        assert records.pixels[position].tolist() == counts.tolist()
    assert len(records.labelled()) == 3


def test_records_without_tables_come_from_the_frames(make):
    folder = make()
    complete = frame_records(open_dataset(folder))
    remove_tables(folder)
    records = frame_records(open_dataset(folder))
    np.testing.assert_array_equal(records.pixels, complete.pixels)
    np.testing.assert_array_equal(records.numbers["bytes"], complete.numbers["bytes"])
    # Only the tables contain timings.
    assert not records.known("render_s").any()


def test_page_shows_estimated_errors(make):
    folder = make()
    remove_tables(folder)
    for index in range(3):
        sampling = {"error_codes": 1.5 + index, "noise_codes": 10.0, "samples_per_pixel": 8.0}
        edit_json(
            folder / f"frames/{index:06d}.json", lambda content, it=sampling: content | {"sampling": it}
        )
    text = Page(write_report(folder).page).text
    assert "median <b>2.5</b>" in text
    assert "maximum 3.5 in frame 000002" in text
    assert "25 % of the sensor" in text
