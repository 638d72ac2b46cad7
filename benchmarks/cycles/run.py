"""Compare this program with Blender Cycles: time against error of Cycles' settings on a benchmark scene.

    export PEPPERSCENE_BPY_PYTHON=~/venv_bpy/bin/python
    python benchmarks/cycles/run.py --out out/cycles --bench out/bench

Errors are root mean squares in 8-bit codes of the developed, noise-free picture, against two independent
halves of Cycles' own reference, whose noise cancels (see `pepperscene.bench.reference`). With `--bench`, the
results of `pepperscene bench` in that folder are compared at equal error, as far as both programs have
measured it, and plotted as well. The scene `nir` cannot be rendered: Cycles has three channels.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
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

from pepperscene.bench.image_errors import Errors, Reference, check_packages, measure_errors
from pepperscene.bench.measure import BenchResult
from pepperscene.bench.plot import Panel, plot_pareto
from pepperscene.bench.records import FORMAT, machine_info, result_json, write_results
from pepperscene.bench.report import (
    format_error,
    markdown_table,
    ratio_table,
    time_ratios,
)
from pepperscene.bench.scenes import SCENES, BenchScene, parse_size, resize_camera, select_scenes
from pepperscene.building.scenes.frame_renderer import FrameRenderer
from pepperscene.camera import Camera
from pepperscene.errors import ArgumentError, InputError, PepperError

CYCLES_SCENES = [name for name in SCENES if name != "nir"]
"""Benchmark scenes whose camera has three channels."""

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


def make_reference(run: CyclesRun, camera: Camera) -> Reference:
    """Two halves of a run's frames, of which there are at least two."""
    halves = np.stack([run.images[half::2].mean(axis=0, dtype=float) for half in (0, 1)])
    return Reference(halves, undistorted(camera), len(run.images), sum(run.seconds))


def evaluate(runs: Sequence[CyclesRun], reference: Reference, scene: str) -> list[BenchResult]:
    """Errors of each setting's frames against the reference, averaged as squares."""
    return [
        BenchResult(
            scene,
            plot_family(run.setting),
            run.setting.name,
            dataclasses.asdict(run.setting),
            measure_errors(run.images, reference),
            run.seconds,
            statistics.median(run.seconds) + run.fixed_seconds,
            variant=f"Blender {run.blender}",
        )
        for run in runs
    ]


def cycles_table(results: Sequence[BenchResult], runs: Sequence[CyclesRun], reference: Reference) -> str:
    """Time, error, mean brightness relative to the reference, and memory of each setting."""
    rows = [
        (
            result.name,
            f"{result.median_s:.1f}",
            format_error(result.errors.codes),
            f"{run.images.mean(dtype=float) / reference.electrons.mean():.4f}",
            f"{run.peak_mib:.0f}",
        )
        for result, run in zip(results, runs, strict=True)
    ]
    return markdown_table(("setting", "s per frame", "error, codes", "brightness", "MiB"), rows)


def read_results(folder: Path, scene: str, size: tuple[int, int]) -> list[BenchResult]:
    """Results of `pepperscene bench` for a scene.

    Raises:
        InputError: there are none for the scene at this size, or of another version of the file format.
    """
    file = folder / "results.json"
    if not file.is_file():
        raise InputError(file, "does not exist; run `pepperscene bench` first")
    content = json.loads(file.read_text(encoding="utf-8"))
    if content.get("format") != FORMAT:
        raise InputError(file, "was written by another version; run `pepperscene bench` again")
    if content["scenes"].get(scene, {}).get("size") != list(size):
        raise InputError(file, f"has no results for the scene {scene} with {size[0]}x{size[1]} pixels")
    return [
        BenchResult(
            scene,
            row["family"],
            row["name"],
            row["effort"],
            Errors.from_json(row["errors"]),
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
    """Render a benchmark scene with Cycles, write `cycles.*`, and return the tables as Markdown.

    Raises:
        InputError: the scene is unknown or monochrome, or `bench` has no results for it.
        OutputError: the folder cannot be written.
        SetupError: bpy is missing, or Blender failed.
    """
    bench_scene = select_scene(scene_name)
    recipe = bench_scene.load()
    renderer, frame = FrameRenderer(recipe), recipe.plan.frame(bench_scene.index)
    camera = resize_camera(renderer.camera(frame), size)
    if camera.sensor.channels != 3:
        raise ArgumentError("scene", f"{scene_name!r} has a monochrome sensor; Cycles renders three channels")
    pixels = (camera.width, camera.height)
    ours = [] if bench is None else read_results(bench, scene_name, pixels)
    machine = machine_info()

    *runs, reference_run = render_cycles(
        renderer.scene(frame), camera, [*settings, reference_setting], folder / "blender", frames, threads
    )
    reference = make_reference(reference_run, camera)
    results = evaluate(runs, reference, scene_name)
    introduction = (
        f"Cycles (Blender {reference_run.blender}) on `{scene_name}`, {pixels[0]} × {pixels[1]} pixels, "
        f"{threads or os.cpu_count()} threads. The first frame of a scene takes "
        f"{reference_run.fixed_seconds:.1f} s more. Errors are against two halves of Cycles' own reference, "
        f"whose noise cancels; the error of their mean is {reference.error_codes:.2g} codes."
    )
    parts = [introduction, cycles_table(results, runs, reference)]
    ratios = time_ratios([*ours, *results], FAMILIES) if ours else []
    if ratios:
        parts += ["Time at equal error, interpolated between measured settings:", ratio_table(ratios)]
    content: dict[str, Any] = {
        "scene": scene_name,
        "size": pixels,
        "reference_error_codes": reference.error_codes,
        "measured": [
            {**result_json(result), "peak_mib": run.peak_mib}
            for result, run in zip(results, runs, strict=True)
        ],
        "ratios": [{**dataclasses.asdict(ratio), "times": ratio.times} for ratio in ratios],
    }
    panel = Panel(
        f"{scene_name}, {pixels[0]} × {pixels[1]} pixels", bench_scene.description, [*ours, *results]
    )
    plots = plot_pareto([panel], "Rendering time and error of a frame; lower left is better")
    others = {f"pareto_{scene_name}.{suffix}": plot for suffix, plot in plots.items()}
    return write_results(folder, "cycles", machine, content, parts, others).markdown


def select_scene(name: str) -> BenchScene:
    """The benchmark scene of a name.

    Raises:
        InputError: the name is unknown, or several are given.
    """
    scenes = select_scenes(name)
    if len(scenes) != 1:
        raise ArgumentError("scene", "must be a single scene")
    return scenes[0]


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
    parser.add_argument(
        "--scene", default="flash", help=f"one of {', '.join(CYCLES_SCENES)} (default: flash)"
    )
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
