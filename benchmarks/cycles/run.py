"""Compare this program with Blender Cycles: time against error of Cycles' settings on a benchmark scene.

    export PEPPERSCENE_BPY_PYTHON=~/venv_bpy/bin/python
    python benchmarks/cycles/run.py --out out/cycles --bench out/bench

Errors are root mean squares in 8-bit codes of the developed, noise-free picture, against Cycles' own
reference; the error of the reference itself, estimated from the spread of its frames, is subtracted in
squares. With `--bench`, the results of `pepperscene bench` in that folder are compared at equal error, and
plotted as well.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import math
import os
import statistics
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from cycles_process import CyclesRun, render_cycles
from cycles_scene import undistorted
from cycles_settings import REFERENCE, STANDARD_SETTINGS, CyclesSetting

from pepperscene.bench.measure import BenchResult
from pepperscene.bench.records import describe_machine, machine_info, result_json, write_results
from pepperscene.bench.reference import Errors, check_packages, develop_codes, measure_errors, relative_mse
from pepperscene.bench.report import markdown_table, plot_pareto, ratio_table, time_ratios
from pepperscene.bench.scenes import SCENES, parse_size, resize_camera, select_scenes
from pepperscene.camera import Camera
from pepperscene.dataset import FrameRenderer
from pepperscene.errors import ArgumentError, InputError, PepperError

FAMILIES = {
    "Cycles, raw": "Cycles, raw",
    "Cycles, denoised": "Cycles, denoised",
    "Cycles, best setting": "Cycles",
}
"""Families of settings that are compared with pepperscene at equal error."""


def plot_family(setting: CyclesSetting) -> str:
    """Line of the plot that a setting belongs to."""
    parts = ["adaptive"] if setting.adaptive is not None else ["clamped"] if setting.clamp else []
    return f"Cycles, {' '.join([*parts, 'denoised' if setting.denoise else 'raw'])}"


def reference_error(reference: CyclesRun, camera: Camera) -> tuple[float, float]:
    """RMSE in codes and relative MSE of the mean of a run's frames (two at least), from their spread."""
    codes = np.stack([develop_codes(image, undistorted(camera)) for image in reference.images])
    mean = reference.images.mean(axis=0, dtype=float)
    first, second = (reference.images[half::2].mean(axis=0, dtype=float) for half in (0, 1))
    error = float(np.sqrt(codes.var(axis=0, ddof=1).mean() / len(codes)))
    return error, relative_mse(mean + (first - second) / 2, mean)


def evaluate(
    runs: Sequence[CyclesRun], reference: CyclesRun, camera: Camera, scene: str
) -> list[BenchResult]:
    """Errors of each setting's frames against the mean of the reference, averaged as squares."""
    mean = reference.images.mean(axis=0, dtype=float).astype(np.float32)
    reference_codes, reference_relative = reference_error(reference, camera)
    results = []
    for run in runs:
        errors = [measure_errors(image, mean, undistorted(camera)) for image in run.images]
        mean_errors = Errors(
            math.sqrt(statistics.fmean(error.rmse_codes**2 for error in errors)),
            statistics.fmean(error.relative_mse for error in errors),
            statistics.fmean(error.flip for error in errors),
        )
        results.append(
            BenchResult(
                scene,
                plot_family(run.setting),
                run.setting.name,
                dataclasses.asdict(run.setting),
                mean_errors.subtract(reference_codes, reference_relative),
                run.seconds,
                statistics.median(run.seconds) + run.fixed_seconds,
                variant=f"Blender {run.blender}",
            )
        )
    return results


def cycles_table(results: Sequence[BenchResult], runs: Sequence[CyclesRun], reference: CyclesRun) -> str:
    """Time, error, mean brightness relative to the reference, and memory of each setting."""
    rows = [
        (
            result.name,
            f"{result.median_s:.1f}",
            f"{result.errors.rmse_codes:.2f}",
            f"{run.images.mean(dtype=float) / reference.images.mean(dtype=float):.4f}",
            f"{run.peak_mib:.0f}",
        )
        for result, run in zip(results, runs, strict=True)
    ]
    return markdown_table(("setting", "s per frame", "codes", "brightness", "MiB"), rows)


def read_results(folder: Path, scene: str, size: tuple[int, int]) -> list[BenchResult]:
    """Results of `pepperscene bench` for a scene.

    Raises:
        InputError: there are none for the scene at this size.
    """
    file = folder / "results.json"
    if not file.is_file():
        raise InputError(file, "does not exist; run `pepperscene bench` first")
    content = json.loads(file.read_text(encoding="utf-8"))
    if content["scenes"].get(scene, {}).get("size") != list(size):
        raise InputError(file, f"has no results for the scene {scene} with {size[0]}x{size[1]} pixels")
    return [
        BenchResult(
            scene,
            row["family"],
            row["name"],
            row["effort"],
            Errors(row["rmse_codes"], row["relative_mse"], row["flip"]),
            tuple(row["seconds"]),
            row["first_s"],
        )
        for row in content["measured"]
        if row["scene"] == scene
    ]


def measure(
    scene_name: str,
    size: tuple[int, int] | None,
    folder: Path,
    settings: Sequence[CyclesSetting],
    reference_setting: CyclesSetting,
    frames: int,
    threads: int,
    bench: Path | None,
) -> str:
    """Render a benchmark scene with Cycles, write `cycles.*`, and return the tables as Markdown."""
    (bench_scene,) = select_scenes(scene_name)
    recipe = bench_scene.load()
    renderer, frame = FrameRenderer(recipe), recipe.plan.frame(bench_scene.index)
    camera = resize_camera(renderer.camera(frame), size)
    pixels = (camera.width, camera.height)
    ours = [] if bench is None else read_results(bench, scene_name, pixels)
    machine = machine_info()

    *runs, reference = render_cycles(
        renderer.scene(frame), camera, [*settings, reference_setting], folder / "blender", frames, threads
    )
    results = evaluate(runs, reference, camera, scene_name)
    error, _ = reference_error(reference, camera)
    introduction = (
        f"Cycles (Blender {reference.blender}) on `{scene_name}`, {pixels[0]}x{pixels[1]}, "
        f"{threads or os.cpu_count()} threads. The first frame of a scene takes "
        f"{reference.fixed_seconds:.1f} s more. Errors are against Cycles' own reference, whose error is "
        f"{error:.2f} codes."
    )
    parts = [describe_machine(machine), introduction, cycles_table(results, runs, reference)]
    ratios = time_ratios([*ours, *results], FAMILIES) if ours else []
    if ratios:
        parts += ["Time at equal error (*: extrapolated):", ratio_table(ratios)]
    markdown = "\n\n".join(parts) + "\n"
    content: dict[str, Any] = {
        "machine": machine,
        "scene": scene_name,
        "size": pixels,
        "reference_error_codes": error,
        "measured": [
            {**result_json(result), "peak_mib": run.peak_mib}
            for result, run in zip(results, runs, strict=True)
        ],
        "ratios": [{**dataclasses.asdict(ratio), "times": ratio.times} for ratio in ratios],
    }
    plots = plot_pareto([*ours, *results], f"Cycles: {scene_name}", bench_scene.description, error)
    others = {f"pareto_{scene_name}.{suffix}": plot for suffix, plot in plots.items()}
    write_results(folder, "cycles", content, markdown, others)
    return markdown


def select_settings(names: str) -> list[CyclesSetting]:
    """The settings of a comma-separated list, all if it is empty.

    Raises:
        InputError: a name is unknown.
    """
    by_name = {setting.name: setting for setting in STANDARD_SETTINGS}
    selected = [name.strip() for name in names.split(",") if name.strip()] or list(by_name)
    for name in selected:
        if name not in by_name:
            raise ArgumentError("settings", f"unknown setting {name!r}; allowed are {', '.join(by_name)}")
    return [by_name[name] for name in selected]


def main() -> int:
    """Run the command; return its exit code."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--out", type=Path, required=True, help="folder for the results")
    parser.add_argument("--scene", default="standard", help=f"one of {', '.join(SCENES)} (default: standard)")
    parser.add_argument("--size", default="", help="WIDTHxHEIGHT (default: the camera's own)")
    parser.add_argument("--settings", default="", help="comma-separated names of settings (default: all)")
    parser.add_argument("--frames", type=int, default=1, help="frames of each setting (default: 1)")
    parser.add_argument("--threads", type=int, default=0, help="threads of Cycles (default: all cores)")
    parser.add_argument(
        "--reference-s", type=float, default=REFERENCE.limit_s, help="time limit of the reference in seconds"
    )
    parser.add_argument("--bench", type=Path, help="output folder of `pepperscene bench` to compare with")
    options = parser.parse_args()
    try:
        check_packages()
        settings = select_settings(options.settings)
        size = parse_size(options.size) if options.size else None
        reference = dataclasses.replace(REFERENCE, limit_s=options.reference_s)
        sys.stdout.write(
            measure(
                options.scene,
                size,
                options.out,
                settings,
                reference,
                options.frames,
                options.threads,
                options.bench,
            )
        )
    except PepperError as error:
        sys.stderr.write(f"error: {error}\n")
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
