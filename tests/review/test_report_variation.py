"""The report of data sets with drawn values: its section on variation, and links between twins."""

from __future__ import annotations

import html
import json
import re
from types import SimpleNamespace

import numpy as np
import pytest
from data_sets import set_without_plants
from varied_set import FRAMES, make_varied_set

from pepperscene.dataset.store.dataset import open_dataset
from pepperscene.errors import InputError
from pepperscene.recipe.plan import FrameSpec, Plan
from pepperscene.recipe.variation.notation import parse_varied
from pepperscene.recipe.variation.recorded import as_number
from pepperscene.recipe.variation.varied import as_json, draw_values
from pepperscene.review.report import write_report
from pepperscene.review.report.data import DrawnRecords, Moments, frame_records
from pepperscene.review.report.page import render
from pepperscene.review.report.sections import VARIATION_HEADS, variation_tables


@pytest.fixture(scope="module")
def varied(tmp_path_factory):
    return make_varied_set(tmp_path_factory.mktemp("varied") / "set")


def page_of(dataset, limit=12):
    return write_report(dataset.folder, limit).page.read_text(encoding="utf-8")


def rows_of(text):
    """Cells of each row of the table of drawn values by key."""
    table = text.partition('class="drawn"')[2].partition("</table>")[0]
    rows = re.findall(r'<th scope="row">(.*?)</th>(.*?)</tr>', table)
    return {
        name: [html.unescape(cell) for cell in re.findall("<td>(.*?)</td>", cells)] for name, cells in rows
    }


def summary(kind, table, frames=400, per="frame"):
    """What the report knows of a set whose plan has many frames, without the frames."""
    plan, value = Plan(sets=1, rotations=1, frames=frames), parse_varied(("x", "y"), table, kind, per)
    drawn = [as_json(draw_values([value], 5, plan.frame(i)))["x.y"] for i in range(frames)]
    numbers = {"x.y": np.array([as_number(value, item) for item in drawn])}
    records = DrawnRecords(plan, np.arange(frames), (value,), numbers, {})
    return drawn, SimpleNamespace(key="a", name="set", records=SimpleNamespace(drawn=records))


def section_of(item):
    tables = variation_tables([item])
    return render("variation.html", sets=[item], variation=tables, variation_heads=VARIATION_HEADS)


def descriptions(text):
    return re.findall("<desc[^>]*>(.*?)</desc>", text)


@pytest.mark.parametrize(
    ("kind", "table"),
    [
        ("number", {"mean": 10.0, "sd": 2.0}),
        ("number", {"low": 20.0, "high": 2000.0, "scale": "log"}),
        ("integer", {"low": 1, "high": 6}),
        ("number", {"value": 3.0}),
        ("number", {"value": -3.0}),
        ("number", {"histogram": [[0.0, 1.0, 0.2], [3.0, 5.0, 0.8]]}),
    ],
)
def test_numbers_have_limits_and_a_histogram_beside_the_distribution(kind, table):
    drawn, item = summary(kind, table)
    page = section_of(item)
    cells = rows_of(page)["x.y"]
    assert cells[0] == "frame"
    assert cells[2:6] == ["400", *(f"{value:.4g}" for value in (min(drawn), np.median(drawn), max(drawn)))]
    assert cells[6] == "–" if "value" in table else float(cells[6]) > 1e-4
    (description,) = descriptions(page)
    # Both peaks are in percent of the same bins, and near each other.
    peaks = [float(value) for value in re.findall(r"maximum ([\d.e+]+) at", description)]
    assert peaks[0] == pytest.approx(peaks[1], rel=0.5)


def test_a_record_without_a_logarithm_does_not_stop_the_report():
    _, item = summary("number", {"low": 20.0, "high": 2000.0, "scale": "log"}, 3)
    item.records.drawn.numbers["x.y"][0] = 0.0
    page = section_of(item)
    assert rows_of(page)["x.y"][3] == "0"
    assert len(descriptions(page)) == 1


def test_few_draws_have_a_chart_but_no_p_value():
    for frames in (1, 2, 19):
        _, item = summary("number", {"mean": 10.0, "sd": 2.0}, frames)
        page = section_of(item)
        assert rows_of(page)["x.y"][-1] == "–"
        assert len(descriptions(page)) == 1


def test_choices_have_a_bar_for_each_outcome_and_dates_are_dates():
    drawn, item = summary(None, {"red": 0.75, "green": 0.25})
    page = section_of(item)
    share = 100 * drawn.count("red") / len(drawn)
    assert f"{share:.1f}\u00a0%</td><td>75.0\u00a0%</td>" in page
    assert page.count("<rect") == 4
    _, item = summary("date", {"2026-03-01": 0.5, "2026-04-01": 0.5})
    assert "2026-03-01 50 %, 2026-04-01 50 %" in rows_of(section_of(item))["x.y"][1]


def test_a_set_drawn_for_the_scene_counts_once():
    _, item = summary("number", {"mean": 10.0, "sd": 2.0}, 400, "scene")
    assert rows_of(section_of(item))["x.y"][2] == "1"


def test_page_shows_what_the_manifest_holds(varied):
    rows = rows_of(page_of(varied))
    numbers = varied.manifest()["drawn.camera.exposure_us"].to_numpy()
    expected = [f"{value:.4g}" for value in (numbers.min(), np.median(np.unique(numbers)), numbers.max())]
    assert rows["camera.exposure_us"] == [
        "frame", "20 to 2000, uniform, logarithmic scale", "6", *expected, "–",
    ]  # fmt: skip
    assert rows["camera.focus_mm"][2] == "2"
    assert rows["developing.white_balance"][:2] == ["twin", "flash, none"]


def test_records_without_a_manifest_come_from_the_frames(varied, tmp_path):
    copy = make_varied_set(tmp_path / "set", outputs=("class",))
    expected = frame_records(copy).drawn
    for name in ("manifest.parquet", "journal.jsonl"):
        (copy.folder / name).unlink()
    found = frame_records(open_dataset(copy.folder)).drawn
    for name, numbers in expected.numbers.items():
        assert np.array_equal(numbers, found.numbers[name])
        assert np.isfinite(numbers).all()


def test_values_of_several_types_are_read_from_the_manifest(tmp_path):
    key, values = "camera.exposure_us", ["auto", 500.0]
    dataset = make_varied_set(tmp_path / "set", outputs=("class",), **{key: {"in_turn": values}})
    assert set(dataset.manifest()[f"drawn.{key}"].to_pylist()) == {"auto", "500.0"}
    drawn = [dataset.metadata(index)["drawn"][key] for index in dataset.indices()]
    assert frame_records(dataset).drawn.numbers[key].tolist() == [values.index(value) for value in drawn]


def test_facts_of_varied_values_do_not_show_one_value(tmp_path):
    changes = {
        "cultivar": {"in_turn": ["kaite_february", "tomato"]},
        "row.spacing_mm": {"low": 300.0, "high": 400.0, "per": "set"},
        "twins": {"daylight.illuminance_lx": [0.0, 20_000.0]},
    }
    page = page_of(make_varied_set(tmp_path / "set", [0, 1], ("class",), **changes))
    lead = "Rendered images of sweet pepper and Solanum lycopersicum, cultivars kaite_february, tomato,"
    assert lead in page
    facts = dict(re.findall("<dt>(.*?)</dt><dd>(.*?)</dd>", page))
    assert facts["Rows"] == "1 + 0 plants, varied spacing"
    assert facts["Exposure"] == facts["Daylight"] == "varied"


def test_images_of_a_moment_link_to_each_other(varied):
    page = page_of(varied)
    targets = set(re.findall(r'class="card" id="(.*?)"', page))
    assert len(targets) == 12 < FRAMES
    lines = re.findall("Same moment: (.*?)</p>", page)
    assert len(lines) == 12
    for card, line in zip(sorted(targets), lines, strict=True):
        links = re.findall(r'href="#(.*?)"', line)
        assert set(links) <= targets
        moments = {varied.metadata(int(name[2:]))["moment"] for name in (card, *links)}
        assert len(links) == 3
        assert len(moments) == 1
    assert lines[0].startswith(
        '<a href="#a-000001">000001</a> (right), <a href="#a-000006">000006</a> (twin 1)'
    )
    # Images that are not shown are named without a link.
    line = re.findall("Same moment: (.*?)</p>", page_of(varied, 1))[0]
    assert line == "000001 (right), 000006 (twin 1), 000007 (twin 1, right)"


def test_page_without_variation_has_no_section(tmp_path):
    page = page_of(set_without_plants(tmp_path / "set", [0, 1], ("class",)))
    assert "Variation" not in page
    assert "Same moment" not in page


def test_texts_of_hostile_variation_are_shown_as_text(varied, tmp_path):
    copy = make_varied_set(tmp_path / "set", [0, 1], ("class",))
    path = copy.folder / "dataset.json"
    info = json.loads(path.read_text())
    variation = info["recipe"]["variation"]
    variation["<img src=x>"] = {"per": "set", "in_turn": ["<b>$x^2$</b>"]}
    variation["camera.<i>"] = variation["camera.exposure_us"]
    path.write_text(json.dumps(info))
    page = page_of(open_dataset(copy.folder))
    assert "<img src=x>" not in page
    assert "<b>$x" not in page
    assert "<i>" not in page.partition('id="variation"')[2].partition("<footer>")[0]
    for identity in (
        {"per": "set"},
        {**variation["camera.focus_mm"], "sd": 1e300},
        {"per": "set", "in_turn": []},
    ):
        variation["camera.focus_mm"] = identity
        path.write_text(json.dumps(info))
        with pytest.raises(InputError, match="variation"):
            write_report(copy.folder)


def test_shown_moments_are_whole_and_evenly_spaced():
    plan = Plan(sets=1, rotations=1, frames=10, twins=2, cameras=2)
    positions = Moments(plan, ("main", "right"), range(plan.count)).evenly_spaced(12)
    specs: list[FrameSpec] = [plan.frame(position) for position in positions]
    assert sorted({spec.moment for spec in specs}) == [0, 4, 9]
    assert len(positions) == 12
    assert len(Moments(plan, ("main", "right"), range(plan.count)).evenly_spaced(3)) == 3
