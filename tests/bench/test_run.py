"""A complete benchmark with a simulated renderer: files, tables, errors, and all-or-nothing output."""

from __future__ import annotations

import csv
import json
from xml.etree import ElementTree

import numpy as np
import pytest
from PIL import Image
from typer.testing import CliRunner

from pepperscene.bench import SCENES, parse_size, run, run_benchmark, select_scenes
from pepperscene.bench.scenes import resize_camera
from pepperscene.bench.settings import NAMED, settings
from pepperscene.camera import develop, expected_electrons
from pepperscene.cli import app
from pepperscene.errors import InputError

FILES = {"results.json", "results.csv", "results.md", "pareto_near.png", "pareto_near.svg"}
NEAR = [SCENES["near"]]


@pytest.mark.usefixtures("noisy_scenes")
def test_files_hold_all_measurements(tmp_path):
    lines = []
    result = run_benchmark(
        tmp_path / "out", NEAR, (16, 12), runs=2, budget_s=60.0, quick=True, on_progress=lines.append
    )
    assert {path.name for path in result.files} == FILES
    content = json.loads((tmp_path / "out" / "results.json").read_text())
    assert {"date", "cpu", "cores", "system", "python", "packages"} <= set(content["machine"])
    assert content["machine"]["packages"]["mitsuba"]
    assert content["asked"] == {"size": [16, 12], "runs": 2, "budget_s": 60.0, "quick": True}
    assert content["scenes"]["near"]["reference"]["error_codes"] > 0.0
    names = [(setting.family, setting.name) for setting in settings(quick=True)]
    assert [(row["family"], row["name"]) for row in content["measured"]] == names
    with (tmp_path / "out" / "results.csv").open(newline="") as file:
        table = list(csv.DictReader(file))
    for line, row in zip(table, content["measured"], strict=True):
        assert len(row["seconds"]) == 2
        assert row["rmse_codes"] > 0.0
        assert (line["family"], line["integrator"]) == (row["family"], row["effort"]["integrator"])
        assert [float(line[f"run_{n}_s"]) for n in (1, 2)] == row["seconds"]
        assert float(line["rmse_codes"]) == row["rmse_codes"]
    assert result.markdown == (tmp_path / "out" / "results.md").read_text()
    assert "nan" not in result.markdown
    assert any("round 2 of 2" in line for line in lines)

    with Image.open(tmp_path / "out" / "pareto_near.png") as plot:
        assert min(plot.size) >= 600
    svg = ElementTree.parse(tmp_path / "out" / "pareto_near.svg")
    words = {"".join(text.itertext()) for text in svg.iter("{http://www.w3.org/2000/svg}text")}
    assert {setting.family for setting in settings(quick=True)} | {"draft", NAMED} <= words


@pytest.mark.usefixtures("noisy_scenes")
def test_second_run_replaces_results_and_keeps_other_files(tmp_path):
    (tmp_path / "mine.txt").write_text("mine")
    for _ in range(2):
        run_benchmark(tmp_path, NEAR, (16, 12), runs=1, quick=True)
    assert {path.name for path in tmp_path.iterdir()} == {*FILES, "mine.txt", "references"}


@pytest.mark.usefixtures("noisy_scenes")
def test_interruption_leaves_the_references_only(tmp_path, monkeypatch):
    def interrupt(*args, **kwargs):
        raise KeyboardInterrupt

    monkeypatch.setattr(run, "plot_pareto", interrupt)
    with pytest.raises(KeyboardInterrupt):
        run_benchmark(tmp_path, NEAR, (16, 12), runs=1, quick=True)
    assert [path.name for path in tmp_path.iterdir()] == ["references"]


@pytest.mark.parametrize("size", [(80, 60), (1600, 1200), (400, 200)])
def test_resized_camera_has_the_same_view_and_exposure(camera, size):
    resized = resize_camera(camera, size)
    assert (resized.width, resized.height) == size
    assert resized.aperture_radius_m == camera.aperture_radius_m
    # The first corner of the middle row is in the same direction.
    first, second = (one.ray_slopes()[one.height // 2, 0] for one in (camera, resized))
    assert first == pytest.approx(second, rel=1e-6, abs=1e-6)
    # Uniform light gives the same grey value.
    codes = []
    for one in (camera, resized):
        image = develop(expected_electrons(np.full((one.height, one.width, 3), 1e19), one), one)
        codes.append(image[one.height // 2, one.width // 2].astype(int))
    assert 20 < codes[0].max() < 250
    assert np.abs(codes[0] - codes[1]).max() <= 2


def test_scenes_load_with_neighbouring_frames():
    for scene in SCENES.values():
        recipe = scene.load()
        assert 0 < recipe.plan.frame(scene.index).step < recipe.plan.frames - 10


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--scene", "far"], "unknown scene 'far'; allowed are near, standard, dense"),
        (["--scene", ","], "names no scene"),
        (["--size", "80"], "'80' must be WIDTHxHEIGHT"),
        (["--size", "0x60"], "must be WIDTHxHEIGHT"),
        (["--size", "99999x60"], "each 1 to 8192"),
        (["--runs", "0"], "--runs: 0 must be at least 1"),
        (["--budget", "-1"], "--budget: -1 must be above 0"),
        (["--profile", "--scaling"], "cannot be combined"),
        (["--profile", "--runs", "0"], "at least 1"),
        (["--out", "file"], "is not a folder"),
    ],
)
def test_invalid_options_give_one_line_and_exit_code_2(tmp_path, monkeypatch, arguments, message):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "file").write_text("")
    result = CliRunner().invoke(app, ["bench", "--out", "out", *arguments])
    assert result.exit_code == 2
    assert message in result.stderr
    assert result.stderr.count("\n") == 1
    assert not (tmp_path / "out").exists()


def test_names_and_sizes_are_parsed():
    assert [scene.name for scene in select_scenes(" dense,near ")] == ["near", "dense"]
    assert parse_size("80x60") == (80, 60)
    with pytest.raises(InputError):
        parse_size("80x60x3")
