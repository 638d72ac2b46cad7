"""A whole bench with made-up light: its files, its tables, its refusals, and nothing half-written."""

from __future__ import annotations

import csv
import json
import re
from xml.etree import ElementTree

import numpy as np
import pytest
from PIL import Image
from typer.testing import CliRunner

from pepperscene.bench import SCENES, run_benchmark, scenes_named, size_of
from pepperscene.bench import run as against_error
from pepperscene.bench.measure import BenchResult
from pepperscene.bench.plot import pareto
from pepperscene.bench.reference import Errors
from pepperscene.bench.scenes import resized
from pepperscene.bench.settings import NAMED, OURS, PLAIN, settings
from pepperscene.bench.tables import duration, error_table, ratio_table, ratios
from pepperscene.camera import develop, expected_electrons
from pepperscene.cli import app
from pepperscene.errors import InputError

FILES = {"results.json", "results.csv", "results.md", "pareto_near.png", "pareto_near.svg"}


@pytest.fixture
def noisy(no_plants, noisy_renderer):
    """What makes a renderer of made-up light, for scenes without plants."""
    return noisy_renderer


def of(family, name, seconds, error, scene="near"):
    """A measurement."""
    return BenchResult(scene, family, name, {}, Errors(error, error**2), (seconds,), 2 * seconds)


def test_all_that_was_measured_is_in_the_files(noisy, tmp_path):
    lines = []
    done = run_benchmark(
        tmp_path / "out", [SCENES["near"]], (16, 12), runs=2, quick=True, factory=noisy, told=lines.append
    )
    assert {path.name for path in done.files} == FILES
    told = json.loads((tmp_path / "out" / "results.json").read_text())
    assert {"date", "cpu", "cores", "system", "python", "packages"} <= set(told["machine"])
    assert told["machine"]["packages"]["mitsuba"]
    assert told["asked"] == {"size": [16, 12], "runs": 2, "budget_s": None, "quick": True, "peers": False}
    assert told["scenes"]["near"]["reference"]["error_codes"] > 0.0
    assert [(one["family"], one["name"]) for one in told["measured"]] == [
        (one.family, one.name) for one in settings(quick=True)
    ]
    for one in told["measured"]:
        assert len(one["seconds"]) == 2
        assert one["rmse_codes"] > 0.0
        assert one["effort"]["samples"] >= 1

    with (tmp_path / "out" / "results.csv").open(newline="") as file:
        table = list(csv.DictReader(file))
    for line, one in zip(table, told["measured"], strict=True):
        assert (line["family"], line["integrator"]) == (one["family"], one["effort"]["integrator"])
        assert [float(line[f"run_{n}_s"]) for n in (1, 2)] == one["seconds"]
        assert float(line["rmse_codes"]) == one["rmse_codes"]
    assert done.markdown == (tmp_path / "out" / "results.md").read_text()
    for line in done.markdown.splitlines():
        # Markdown tables of equally many cells; nothing is told as nan.
        assert "nan" not in line
    assert any("round 2 of 2" in line for line in lines)

    with Image.open(tmp_path / "out" / "pareto_near.png") as plot:
        assert min(plot.size) >= 600
    svg = ElementTree.parse(tmp_path / "out" / "pareto_near.svg")
    words = {"".join(text.itertext()) for text in svg.iter("{http://www.w3.org/2000/svg}text")}
    assert {one.family for one in settings(quick=True)} - {NAMED} <= words
    assert "draft" in words


def test_a_second_bench_replaces_the_first_and_keeps_foreign_files(noisy, tmp_path):
    (tmp_path / "mine.txt").write_text("mine")
    for _ in range(2):
        run_benchmark(tmp_path, [SCENES["near"]], (16, 12), runs=1, quick=True, factory=noisy)
    assert {path.name for path in tmp_path.iterdir()} == {*FILES, "mine.txt", "references"}


def test_a_fault_on_the_way_leaves_no_half_of_a_result(noisy, tmp_path, monkeypatch):
    def broken(*args, **kwargs):
        raise KeyboardInterrupt

    monkeypatch.setattr(against_error, "pareto", broken)
    with pytest.raises(KeyboardInterrupt):
        run_benchmark(tmp_path, [SCENES["near"]], (16, 12), runs=1, quick=True, factory=noisy)
    # What was paid for is kept, and nothing else.
    assert [path.name for path in tmp_path.iterdir()] == ["references"]


def test_ratios_at_equal_error_on_made_laws():
    measured = [
        of(NAMED, "standard", 2.0, 1.0),
        *(of(OURS, f"{n}", n / 4, (2.0 / (n / 4)) ** 0.5) for n in (1, 4, 16)),
        *(of(PLAIN, f"{n}", float(n), (90.0 / n) ** 0.5) for n in (1, 4, 16)),
        *(of("Cycles, raw", f"{n}", 2.0 * n, (60.0 / n) ** 0.5) for n in (1, 4, 16)),
        *(of("Cycles, denoised", f"{n}", 5.0 * n, (4.0 / n) ** 0.5) for n in (1, 4, 16)),
    ]
    found = {(one["error_codes"], one["other"]): one for one in ratios(measured)}
    plain = found[1.0, "plain path"]
    assert (plain["ours"], plain["times"], plain["beyond"]) == ("standard", pytest.approx(45.0), True)
    assert found[1.0, "Cycles, raw"]["times"] == pytest.approx(60.0)
    assert found[1.0, "Cycles, denoised"]["times"] == pytest.approx(10.0)
    assert not found[1.0, "Cycles, denoised"]["beyond"]
    # The best of all settings for the error counts.
    assert found[1.0, "Cycles, its best"]["times"] == pytest.approx(10.0)
    table = ratio_table(ratios(measured))
    assert "| 1.00 codes | standard | 2,000 ms | plain path | 90.0 s | 45.0 * |" in table


def test_tables_have_a_cell_for_each_head():
    lines = error_table([of(PLAIN, "4 spp", 12.0, 2.0)]).splitlines()
    assert len({line.count("|") for line in lines}) == 1
    assert "| plain path | 4 spp | 2.00 | 4 |  | 12.0 s | 12.0 s | 12.0 s | 1 |" in lines
    assert [duration(s) for s in (0.0321, 9.9994, 10.0, 1234.5)] == [
        "32 ms",
        "9,999 ms",
        "10.0 s",
        "1,234.5 s",
    ]


def test_a_plot_of_very_few_points_is_still_one():
    made = pareto([of(PLAIN, "1 spp", 1.0, 2.0), of(OURS, "free", 0.1, 0.0)], "title", "below")
    assert made["png"].startswith(b"\x89PNG")
    assert made == pareto([of(PLAIN, "1 spp", 1.0, 2.0), of(OURS, "free", 0.1, 0.0)], "title", "below")


@pytest.mark.parametrize("size", [(80, 60), (1600, 1200), (400, 200)])
def test_a_resized_camera_sees_as_much_and_exposes_alike(camera, size):
    other = resized(camera, size)
    assert (other.width, other.height) == size
    assert other.aperture_radius_m == camera.aperture_radius_m
    # The middle row's first corner lies in the same direction.
    first, second = (one.ray_slopes()[one.height // 2, 0] for one in (camera, other))
    assert first == pytest.approx(second, rel=1e-6, abs=1e-6)
    # An even light makes the same middle grey.
    signal = [np.full((one.height, one.width, 3), 1e19) for one in (camera, other)]
    codes = [
        develop(expected_electrons(light, one), one)[one.height // 2, one.width // 2].astype(int)
        for light, one in zip(signal, (camera, other), strict=True)
    ]
    assert 20 < codes[0].max() < 250
    assert np.abs(codes[0] - codes[1]).max() <= 2


def test_every_scene_loads_with_room_beside_its_frame():
    for scene in SCENES.values():
        recipe = scene.load()
        assert 0 < recipe.plan.frame(scene.index).step < recipe.plan.frames - 10


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--scene", "far"], "unknown scene 'far'; allowed are near, standard, dense"),
        (["--scene", ","], "no scene is named"),
        (["--size", "80"], "'80' must be WIDTHxHEIGHT"),
        (["--size", "0x60"], "must be WIDTHxHEIGHT"),
        (["--size", "99999x60"], "each 1 to 8192"),
        (["--runs", "0"], "--runs: 0 must be at least 1"),
        (["--budget", "-1"], "--budget: -1 must be above 0"),
        (["--profile", "--scaling"], "one at a time"),
        (["--profile", "--runs", "0"], "at least 1"),
    ],
)
def test_bad_input_is_one_sentence_and_code_2(tmp_path, arguments, words):
    done = CliRunner().invoke(app, ["bench", "--out", str(tmp_path / "out"), *arguments])
    assert done.exit_code == 2
    assert words in done.stderr
    assert done.stderr.count("\n") == 1
    assert not (tmp_path / "out").exists()


def test_an_output_that_is_a_file_and_missing_peers_are_told(tmp_path, monkeypatch):
    (tmp_path / "file").write_text("")
    done = CliRunner().invoke(app, ["bench", "--out", str(tmp_path / "file")])
    assert (done.exit_code, "is not a folder" in done.stderr) == (2, True)
    monkeypatch.setenv("PEPPERSCENE_BPY_PYTHON", str(tmp_path / "nothing"))
    done = CliRunner().invoke(app, ["bench", "--out", str(tmp_path / "out"), "--peers"])
    assert (done.exit_code, "needs bpy" in done.stderr) == (2, True)


def test_names_and_sizes_are_read():
    assert [one.name for one in scenes_named(" dense,near ")] == ["near", "dense"]
    assert size_of("80x60") == (80, 60)
    with pytest.raises(InputError):
        size_of("80x60x3")
    assert re.fullmatch(r"[a-z]+", "".join(SCENES))
