"""The comparison with Cycles (benchmarks/cycles/run.py) on frames with known noise, without Blender."""

from __future__ import annotations

import dataclasses
import importlib.util
import json
import sys
from pathlib import Path

import numpy as np
import pytest

from pepperscene.bench import run_benchmark
from pepperscene.bench.image_errors import develop_codes, rms
from pepperscene.bench.scenes import SCENES, resize_camera
from pepperscene.errors import InputError

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "benchmarks" / "cycles"))

from cycles_process import CyclesRun
from cycles_settings import CyclesSetting

SCRIPT = Path(__file__).resolve().parents[2] / "benchmarks" / "cycles" / "run.py"
LEVEL_E, NOISE_E = 2_000.0, 200.0


@pytest.fixture(scope="module")
def script():
    """The script as a module of another name: `run` is too general."""
    spec = importlib.util.spec_from_file_location("cycles_run", SCRIPT)
    module = importlib.util.module_from_spec(spec)
    sys.modules["cycles_run"] = module
    spec.loader.exec_module(module)
    return module


def noisy_run(setting, camera, frames, seed):
    """Frames of a constant; noise falls with the root of the samples."""
    rng = np.random.default_rng(seed)
    shape = (frames, camera.height, camera.width, 3)
    images = (LEVEL_E + NOISE_E / setting.spp**0.5 * rng.standard_normal(shape)).astype(np.float32)
    return CyclesRun(setting, (0.1 * setting.spp,) * frames, 1.0, 500.0, images, "4.5")


@pytest.mark.parametrize("frames", [5])
def test_error_is_that_of_the_frames_although_the_reference_is_as_noisy(script, full_camera, frames):
    camera = resize_camera(full_camera, (96, 64))
    settings = [CyclesSetting(f"raw {spp}", spp, denoise=False) for spp in (16, 64)]
    runs = [noisy_run(setting, camera, 2, seed) for seed, setting in enumerate(settings)]
    reference_run = noisy_run(CyclesSetting("reference", 64, denoise=False), camera, frames, 9)
    reference = script.make_reference(reference_run, camera)
    assert (reference.renders, reference.halves.shape) == (frames, (2, 64, 96, 3))
    results = script.evaluate(runs, reference, "flash")
    exact = np.full((64, 96, 3), LEVEL_E)
    for result, run in zip(results, runs, strict=True):
        noise = 1e-3 * (run.images - LEVEL_E)
        expected = 1e3 * rms(
            [develop_codes(exact + image, reference.camera) - develop_codes(exact, camera) for image in noise]
        )
        uncertainty = result.errors.codes.root_uncertainty
        assert result.errors.codes.root == pytest.approx(expected, abs=4 * uncertainty)
        assert uncertainty < 0.1 * expected
        assert result.seconds == run.seconds
        # 0.1 s for each sample, and 1 s once.
        assert result.first_s == pytest.approx(0.1 * run.setting.spp + 1.0)


def test_scenes_with_one_channel_are_rejected(script, tmp_path):
    with pytest.raises(InputError, match="'nir' has a monochrome sensor"):
        script.measure("nir", None, tmp_path, [], script.REFERENCE, 1, 1, None)
    with pytest.raises(InputError, match="a single scene"):
        script.measure("flash,near", None, tmp_path, [], script.REFERENCE, 1, 1, None)
    assert script.CYCLES_SCENES == ["flash", "daylight", "near"]


@pytest.mark.usefixtures("noisy_scenes")
def test_results_of_the_benchmark_are_read_as_they_were(script, tmp_path):
    run_benchmark(tmp_path, [SCENES["near"]], (16, 12), runs=2, quick=True)
    file = tmp_path / "results.json"
    content = json.loads(file.read_text())
    results = script.read_results(tmp_path, "near", (16, 12))
    for result, row in zip(results, content["measured"], strict=True):
        assert dataclasses.asdict(result.errors) == row["errors"]
        assert result.errors.codes.root == row["rmse_codes"]
        assert (result.family, list(result.seconds)) == (row["family"], row["seconds"])
    with pytest.raises(InputError, match="no results for the scene flash"):
        script.read_results(tmp_path, "flash", (16, 12))
    file.write_text(json.dumps({**content, "format": "pepperscene bench 1"}))
    with pytest.raises(InputError, match="another version"):
        script.read_results(tmp_path, "near", (16, 12))


@pytest.mark.usefixtures("noisy_scenes")
def test_nothing_is_compared_beyond_the_measured_errors(script, tmp_path, monkeypatch):
    def render(scene, camera, settings, folder, frames, threads):
        return [
            noisy_run(setting, camera, setting.frames or frames, seed)
            for seed, setting in enumerate(settings)
        ]

    monkeypatch.setattr(script, "render_cycles", render)
    bench, out = tmp_path / "bench", tmp_path / "out"
    run_benchmark(bench, [SCENES["near"]], (48, 36), runs=1, quick=True)
    settings = [CyclesSetting(f"raw {spp}", spp, denoise=False) for spp in (1, 16)]
    markdown = script.measure("near", (48, 36), out, settings, script.REFERENCE, 1, 1, bench)
    content = json.loads((out / "cycles.json").read_text())
    reached = [row["rmse_codes"] for row in content["measured"]]
    assert all(reached)
    assert content["ratios"]
    for ratio in content["ratios"]:
        assert min(reached) <= ratio["error_codes"] <= max(reached)
    assert "extrapolated" not in markdown
    assert " ± " in markdown
    assert (out / "pareto_near.png").is_file()
