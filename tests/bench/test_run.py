"""A complete benchmark with a simulated renderer: files, tables, errors, and all-or-nothing output."""

from __future__ import annotations

import csv
import inspect
import json
from xml.etree import ElementTree

import numpy as np
import pytest
from noisy_renderer import NoisyRenderer
from PIL import Image
from typer.testing import CliRunner

from pepperscene.bench import SCENES, parse_size, run, run_benchmark, select_scenes
from pepperscene.bench.scenes import resize_camera
from pepperscene.bench.settings import ADAPTIVE, NAMED, settings
from pepperscene.building.scenes.frame_renderer import FrameRenderer
from pepperscene.camera import develop, expected_electrons
from pepperscene.cli import app
from pepperscene.cli.machine import BenchCost

FILES = {"results.json", "results.csv", "results.md", "pareto.png", "pareto.svg"}
NEAR = [SCENES["near"]]


@pytest.mark.usefixtures("noisy_scenes")
def test_files_hold_all_measurements(tmp_path):
    lines = []
    options = {"runs": 2, "budget_s": 60.0, "quick": True}
    result = run_benchmark(tmp_path / "out", NEAR, (16, 12), **options, on_progress=lines.append)
    assert {path.name for path in result.files} == FILES
    content = json.loads((tmp_path / "out" / "results.json").read_text())
    assert {"date", "cpu", "cores", "system", "python", "packages"} <= set(content["machine"])
    assert content["machine"]["packages"]["mitsuba"]
    assert content["asked"] == {"size": [16, 12], **options, "all_settings": False}
    assert content["scenes"]["near"]["reference"]["error_codes"] > 0.0
    names = [(setting.family, setting.name) for setting in settings(quick=True)]
    assert [(row["family"], row["name"]) for row in content["measured"]] == names
    with (tmp_path / "out" / "results.csv").open(newline="") as file:
        table = list(csv.DictReader(file))
    for line, row in zip(table, content["measured"], strict=True):
        assert len(row["seconds"]) == 2
        assert row["rmse_codes"] > 2.0 * row["rmse_codes_uncertainty"] > 0.0
        assert row["rmse_codes_limit"] is None
        assert line["rmse_codes_limit"] == ""
        assert (line["family"], line["integrator"]) == (row["family"], row["effort"]["integrator"])
        assert [float(line[f"run_{n}_s"]) for n in (1, 2)] == row["seconds"]
        assert float(line["rmse_codes"]) == row["rmse_codes"]
    assert result.markdown == (tmp_path / "out" / "results.md").read_text()
    assert "nan" not in result.markdown
    assert any("round 2 of 2" in line for line in lines)

    with Image.open(tmp_path / "out" / "pareto.png") as plot:
        assert min(plot.size) >= 600
    svg = ElementTree.parse(tmp_path / "out" / "pareto.svg")
    words = {"".join(text.itertext()) for text in svg.iter("{http://www.w3.org/2000/svg}text")}
    assert {"draft", "standard", "16 spp", NAMED, ADAPTIVE} <= words


@pytest.mark.usefixtures("noisy_scenes")
def test_all_scenes_are_in_one_table_and_one_plot_and_replace_earlier_ones(tmp_path):
    (tmp_path / "mine.txt").write_text("mine")
    run_benchmark(tmp_path, NEAR, (16, 12), runs=1, quick=True)
    result = run_benchmark(tmp_path, size=(16, 12), runs=1, quick=True)
    rows = [line.split(" | ")[0][2:] for line in result.markdown.splitlines() if line.startswith("| ")]
    assert list(dict.fromkeys(rows)) == ["scene", "flash", "daylight", "nir", "near"]
    assert (tmp_path / "pareto.svg").read_text().count("16 × 12 pixels") == 4
    content = json.loads((tmp_path / "results.json").read_text())
    assert {row["scene"] for row in content["measured"]} == set(SCENES)
    assert {path.name for path in tmp_path.iterdir()} == {*FILES, "mine.txt", "references"}


@pytest.mark.usefixtures("noisy_scenes")
def test_errors_below_the_noise_are_stated_as_limits(tmp_path, monkeypatch):
    # All images are exact, but the two of the reference are not.
    render = NoisyRenderer.render

    def render_exact(self, camera, outputs=(), quality="standard", seed=0):
        frame = render(self, camera, outputs, quality, seed)
        if seed < 1_000_000:
            frame.images["electrons"] = np.full_like(frame.images["electrons"], self.level_e)
        return frame

    monkeypatch.setattr(NoisyRenderer, "render", render_exact)
    result = run_benchmark(tmp_path, NEAR, (64, 48), runs=1, quick=True)
    rows = json.loads((tmp_path / "results.json").read_text())["measured"]
    limits = [row for row in rows if row["rmse_codes"] is None]
    # Every image is the same; the product with a fixed reference is measurable in 2 % of the cases.
    assert len(limits) == len(rows)
    assert all(row["rmse_codes_limit"] > 0.0 and row["rmse_codes_uncertainty"] is None for row in limits)
    table = [line for line in result.markdown.splitlines() if line.startswith("| near")]
    assert all("| < " in line and line.endswith("| – |") for line in table)


@pytest.mark.usefixtures("noisy_scenes")
@pytest.mark.parametrize(("budget_s", "samples"), [(60.0, 32), (float("inf"), 256)])
def test_references_within_a_budget_have_small_images(tmp_path, monkeypatch, budget_s, samples):
    seen = set()
    render = NoisyRenderer.render

    def render_seen(self, camera, outputs=(), quality="standard", seed=0):
        if seed >= 1_000_000:
            seen.add(quality.samples)
        return render(self, camera, outputs, quality, seed)

    monkeypatch.setattr(NoisyRenderer, "render", render_seen)
    run_benchmark(tmp_path, NEAR, (16, 12), runs=1, budget_s=budget_s)
    assert seen == {samples}


@pytest.mark.usefixtures("noisy_scenes")
def test_interruption_leaves_the_references_only(tmp_path, monkeypatch):
    def interrupt(*args, **kwargs):
        raise KeyboardInterrupt

    monkeypatch.setattr(run, "plot_pareto", interrupt)
    with pytest.raises(KeyboardInterrupt):
        run_benchmark(tmp_path, NEAR, (16, 12), runs=1, quick=True)
    assert [path.name for path in tmp_path.iterdir()] == ["references"]


@pytest.mark.parametrize("size", [(80, 60), (400, 200)])
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


def test_scenes_have_neighbouring_frames_and_the_near_infrared_one_a_monochrome_camera():
    for scene in SCENES.values():
        recipe = scene.load()
        assert 0 < recipe.plan.frame(scene.index).step < recipe.plan.frames - 10
    assert list(SCENES) == ["flash", "daylight", "nir", "near"]
    scene = SCENES["nir"]
    recipe = scene.load()
    camera = FrameRenderer(recipe).camera(recipe.plan.frame(scene.index))
    assert camera.sensor.channels == 1
    # The filter and the lamp leave a band around 850 nm.
    nm = np.arange(400.0, 1000.0)
    response = camera.sensor.quantum_efficiency.at(nm)[0] * camera.flash.spectrum.at(nm)
    assert np.average(nm, weights=response) == pytest.approx(850.0, abs=15.0)
    assert (scene.index, scene.recipe) == (SCENES["flash"].index, SCENES["flash"].recipe)


def test_invalid_options_give_one_line_and_exit_code_2(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "file").write_text("")
    for message, *arguments in (
        ("unknown scene 'far'; allowed are flash, daylight, nir, near", "--scene", "far"),
        ("names no scene", "--scene", ","),
        ("'80' must be WIDTHxHEIGHT", "--size", "80"),
        ("must be WIDTHxHEIGHT", "--size", "80x60x3"),
        ("must be WIDTHxHEIGHT", "--size", "0x60"),
        ("each 1 to 8192", "--size", "99999x60"),
        ("--runs: 0 must be at least 1", "--runs", "0"),
        ("--budget: 0 must be above 0", "--budget", "0"),
        ("--budget: nan must be above 0", "--budget", "nan"),
        ("--all-settings: cannot be combined with --quick", "--all-settings", "--quick"),
        ("--all-settings: cannot be combined", "--all-settings", "--profile"),
        ("cannot be combined", "--profile", "--scaling"),
        ("at least 1", "--profile", "--runs", "0"),
        ("is not a folder", "--out", "file"),
    ):
        result = CliRunner().invoke(app, ["bench", "--out", "out", *arguments])
        assert result.exit_code == 2, arguments
        assert message in result.stderr
        assert result.stderr.count("\n") == 1
    assert not (tmp_path / "out").exists()


def test_defaults_of_the_command_are_those_of_the_function():
    assert [scene.name for scene in select_scenes(" near,daylight ")] == ["daylight", "near"]
    assert parse_size("80x60") == (80, 60)
    command, function = BenchCost(), inspect.signature(run_benchmark).parameters
    assert command.budget == function["budget_s"].default == 900.0
    assert command.runs == function["runs"].default
