"""The benchmark: rendering time against error on each scene, with tables, plots and all single times."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from time import perf_counter
from typing import Any, Final

from pepperscene.bench.measure import BenchResult, measure_settings, measure_variant, other_variants
from pepperscene.bench.records import (
    describe_machine,
    machine_info,
    result_json,
    results_csv,
    write_results,
)
from pepperscene.bench.reference import OnProgress, Reference, check_packages, render_reference
from pepperscene.bench.report import error_table, plot_pareto, ratio_table, time_ratios
from pepperscene.bench.scenes import SCENES, BenchScene, load_subject
from pepperscene.bench.settings import settings
from pepperscene.camera import Camera
from pepperscene.dataset.store.atomic import check_can_create
from pepperscene.errors import ArgumentError, OutputError
from pepperscene.render import QUALITIES

DEFAULT_RUNS: Final = 5
"""Rounds of a full benchmark. Chosen: a median of fewer is unreliable."""

REFERENCES: Final = "references"
"""Folder of the cached converged images, inside the output folder."""

_REFERENCE_FRACTION: Final = 0.5
"""Chosen: fraction of a time limit for a reference that is not cached."""

_QUICK_REFERENCE: Final = dataclasses.replace(QUALITIES["reference"], samples=64, soft=64, most=64)
"""Quality of the two images that are averaged for the reference of a quick benchmark."""


@dataclass(frozen=True)
class BenchmarkFiles:
    """Results of a benchmark.

    Attributes:
        files: paths of the written files.
        markdown: the tables.
    """

    files: tuple[Path, ...]
    markdown: str


@dataclass(frozen=True, eq=False)
class _SceneResults:
    scene: BenchScene
    camera: Camera
    triangles: int
    full_triangles: int
    reference: Reference
    results: tuple[BenchResult, ...]


def run_benchmark(
    out: str | Path,
    scenes: Sequence[BenchScene] = tuple(SCENES.values()),
    size: tuple[int, int] | None = None,
    *,
    runs: int = DEFAULT_RUNS,
    budget_s: float | None = None,
    quick: bool = False,
    on_progress: OnProgress = lambda _: None,
) -> BenchmarkFiles:
    """Measure rendering time against error, and write the results.

    Args:
        out: folder; created if missing. Result files are replaced, cached references are used.
        scenes: to render.
        size: of the images, or None for the cameras'.
        runs: number of timed frames of each setting.
        budget_s: approximate time limit, divided equally among the scenes; None has no limit.
        quick: few settings and a coarse reference, as a test.
        on_progress: receives progress lines.

    Raises:
        InputError: an argument is out of range.
        OutputError: the folder cannot be written.
        SetupError: the extra `bench` is missing or the machine cannot render; nothing is written.
    """
    folder = Path(out)
    check_arguments(folder, runs, budget_s)
    check_packages()
    machine = machine_info()
    limit_s = None if budget_s is None else budget_s / len(scenes)
    measured = [_measure_scene(scene, folder, size, runs, limit_s, quick, on_progress) for scene in scenes]
    results = [result for scene in measured for result in scene.results]
    content = {
        "machine": machine,
        "asked": {"size": size, "runs": runs, "budget_s": budget_s, "quick": quick},
        "scenes": {scene.scene.name: _scene_json(scene) for scene in measured},
        "measured": [result_json(result) for result in results],
        "ratios": {
            scene.scene.name: [
                {**asdict(ratio), "times": ratio.times} for ratio in time_ratios(scene.results)
            ]
            for scene in measured
        },
    }
    markdown = (
        "\n\n".join([describe_machine(machine), *(_scene_markdown(scene) for scene in measured)]) + "\n"
    )
    extra_files = {"results.csv": results_csv(results).encode()}
    for scene in measured:
        plots = plot_pareto(
            scene.results,
            f"Rendering time against error: {scene.scene.name}",
            f"{scene.scene.description}; {scene.camera.width}x{scene.camera.height}",
            scene.reference.error_codes,
        )
        extra_files |= {f"pareto_{scene.scene.name}.{suffix}": plot for suffix, plot in plots.items()}
    return BenchmarkFiles(write_results(folder, "results", content, markdown, extra_files), markdown)


def check_arguments(folder: Path, runs: int, budget_s: float | None = None) -> None:
    """Check the arguments before anything is measured.

    Raises:
        InputError: one is out of range.
        OutputError: the folder cannot be written.
    """
    if runs < 1:
        raise ArgumentError("runs", f"{runs} must be at least 1")
    if budget_s is not None and not budget_s > 0.0:
        raise ArgumentError("budget", f"{budget_s:g} must be above 0 seconds")
    check_can_create(folder)


def _measure_scene(
    scene: BenchScene,
    folder: Path,
    size: tuple[int, int] | None,
    runs: int,
    limit_s: float | None,
    quick: bool,
    on_progress: OnProgress,
) -> _SceneResults:
    on_progress(f"{scene.name}: {scene.description}")
    start = perf_counter()
    subject = load_subject(scene, size, runs)
    references = folder / REFERENCES
    reference_limit = 0.0 if quick else None if limit_s is None else _REFERENCE_FRACTION * limit_s
    quality = _QUICK_REFERENCE if quick else QUALITIES["reference"]
    try:
        reference = render_reference(
            subject, references, quality, limit_s=reference_limit, on_progress=on_progress
        )
    except OSError as error:
        path = error.filename or references
        raise OutputError(f"{path}: cannot be written ({error.strerror})") from None
    if limit_s is not None:
        # A cached reference leaves more time for the measurements.
        limit_s = max(limit_s - (perf_counter() - start), _REFERENCE_FRACTION * limit_s)
    results = measure_settings(
        subject, settings(quick=quick), reference, runs, limit_s=limit_s, on_progress=on_progress
    )
    for variant in other_variants():
        on_progress(f"{scene.name}: {variant}")
        results += measure_variant(variant, scene.name, size, runs, references, quick=quick)
    # The subject and its renderers are freed before the next scene is loaded.
    triangles, full_triangles = len(subject.scene.mesh.faces), len(subject.full_scene.mesh.faces)
    return _SceneResults(scene, subject.camera, triangles, full_triangles, reference, tuple(results))


def _scene_json(results: _SceneResults) -> dict[str, Any]:
    return {
        "recipe": results.scene.recipe,
        "changes": dict(results.scene.changes),
        "frame": results.scene.index,
        "meaning": results.scene.description,
        "size": [results.camera.width, results.camera.height],
        "triangles": results.triangles,
        "of_triangles": results.full_triangles,
        "reference": {
            "pictures": results.reference.renders,
            "seconds": results.reference.seconds,
            "error_codes": results.reference.error_codes,
            "relative_mse": results.reference.relative_mse,
        },
    }


def _scene_markdown(results: _SceneResults) -> str:
    """The tables of a scene with an introduction."""
    scene, reference = results.scene, results.reference
    introduction = (
        f"{scene.description[0].upper()}{scene.description[1:]} (frame {scene.index} of `{scene.recipe}`), "
        f"{results.camera.width}x{results.camera.height}, {results.triangles:,} of the full scene's "
        f"{results.full_triangles:,} triangles. The reference, of the full scene, is the mean of "
        f"{reference.renders} images without denoiser; its error is {reference.error_codes:.3f} codes."
    )
    parts = [f"#### {scene.name.capitalize()}", introduction, error_table(results.results)]
    if ratios := time_ratios(results.results):
        parts += ["Time at equal error:", ratio_table(ratios)]
    if any(ratio.beyond for ratio in ratios):
        parts.append("\\* extrapolated along the line through the two outermost points.")
    return "\n\n".join(parts)
