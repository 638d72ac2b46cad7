"""The benchmark: rendering time against error on each scene, with tables, plots and all single times."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from time import perf_counter
from typing import Any, Final

from pepperscene.atomic import check_can_create, write_error
from pepperscene.bench.image_errors import check_packages
from pepperscene.bench.measure import BenchResult, measure_settings, measure_variant, other_variants
from pepperscene.bench.plot import Panel, plot_pareto
from pepperscene.bench.records import (
    BenchmarkFiles,
    machine_info,
    result_json,
    results_csv,
    write_results,
)
from pepperscene.bench.reference import SMALLEST_ERROR, TARGET_FRACTION, OnProgress, render_reference
from pepperscene.bench.report import (
    CODES_OF_INTEREST,
    TimeRatio,
    format_time,
    result_table,
    time_ratios,
)
from pepperscene.bench.scenes import SCENES, BenchScene, load_subject
from pepperscene.bench.settings import Setting, settings
from pepperscene.errors import ArgumentError
from pepperscene.render import QUALITIES

DEFAULT_RUNS: Final = 5
"""Rounds of a full benchmark. Chosen: a median of fewer is unreliable."""

DEFAULT_BUDGET_S: Final = 900.0
"""Approximate time limit of a benchmark, if none is given. Chosen: standard errors are some per cent then."""

REFERENCES: Final = "references"
"""Folder of the cached converged images, inside the output folder."""

_REFERENCE_FRACTION: Final = 0.5
"""Chosen: fraction of a scene's time limit after which its reference is finished, loading included."""

_SMALL_REFERENCE: Final = dataclasses.replace(QUALITIES["reference"], samples=32, soft=32, most=32)
"""Quality of the reference's images within a time limit. Chosen: an image of `daylight` takes five minutes in
`reference` quality on two cores, and an eighth of that with these samples."""

_SMALL_TARGET_FRACTION: Final = 0.5
"""Chosen: within a time limit, target error of the reference over the smallest error of interest. The noise
of its halves cancels, so the remaining time is better spent on the settings."""


@dataclass(frozen=True, eq=False)
class _MeasuredScene:
    scene: BenchScene
    summary: dict[str, Any]  # of the scene and its reference, for the JSON file
    results: Sequence[BenchResult]

    @property
    def size(self) -> str:
        return "{} × {} pixels".format(*self.summary["size"])


def run_benchmark(
    out: str | Path,
    scenes: Sequence[BenchScene] = tuple(SCENES.values()),
    size: tuple[int, int] | None = None,
    *,
    runs: int = DEFAULT_RUNS,
    budget_s: float = DEFAULT_BUDGET_S,
    quick: bool = False,
    all_settings: bool = False,
    on_progress: OnProgress = lambda _: None,
) -> BenchmarkFiles:
    """Measure rendering time against error, and write the results.

    Args:
        out: folder; created if missing. Result files are replaced, cached references are used.
        scenes: to render.
        size: of the images, or None for the cameras'.
        runs: number of timed frames of each setting.
        budget_s: approximate time limit, divided equally among the scenes; infinity has no limit.
        quick: few settings and a coarse reference, as a test.
        all_settings: more settings; see `settings`.
        on_progress: receives progress lines.

    Raises:
        InputError: an argument is out of range, or `quick` and `all_settings` are combined.
        OutputError: the folder cannot be written.
        SetupError: the extra `bench` is missing or the machine cannot render; nothing is written.
    """
    folder = Path(out)
    check_arguments(folder, runs, budget_s)
    if quick and all_settings:
        raise ArgumentError("all_settings", "cannot be combined with --quick")
    check_packages()
    machine = machine_info()
    compared = settings(quick=quick, all_settings=all_settings)
    limit_s = budget_s / len(scenes)
    measured = [
        _measure_scene(scene, folder, size, runs, limit_s, compared, quick, on_progress) for scene in scenes
    ]
    results = [result for one in measured for result in one.results]
    ratios = {one.scene.name: time_ratios(one.results) for one in measured}
    content = {
        "asked": {
            "size": size, "runs": runs, "budget_s": budget_s, "quick": quick, "all_settings": all_settings,
        },
        "scenes": {one.scene.name: one.summary for one in measured},
        "measured": [result_json(result) for result in results],
        "ratios": {
            name: [{**asdict(ratio), "times": ratio.times} for ratio in of_scene]
            for name, of_scene in ratios.items()
        },
    }  # fmt: skip
    scene_lines = "\n".join(map(_scene_line, measured))
    chapters = [scene_lines, result_table(results), *_sentences_at_one_code(ratios)]
    panels = [Panel(f"{one.scene.name}, {one.size}", one.scene.description, one.results) for one in measured]
    plots = plot_pareto(panels, "Rendering time and error of a frame; lower left is better")
    extra_files = {"results.csv": results_csv(results).encode()} | {
        f"pareto.{suffix}": plot for suffix, plot in plots.items()
    }
    return write_results(folder, "results", machine, content, chapters, extra_files)


def check_arguments(folder: Path, runs: int, budget_s: float = math.inf) -> None:
    """Raise `InputError` if an argument is out of range, `OutputError` if the folder cannot be written."""
    if runs < 1:
        raise ArgumentError("runs", f"{runs} must be at least 1")
    if not budget_s > 0.0:
        raise ArgumentError("budget", f"{budget_s:g} must be above 0 seconds")
    check_can_create(folder)


def _measure_scene(
    scene: BenchScene,
    folder: Path,
    size: tuple[int, int] | None,
    runs: int,
    limit_s: float,
    compared: Sequence[Setting],
    quick: bool,
    on_progress: OnProgress,
) -> _MeasuredScene:
    on_progress(f"{scene.name}: {scene.description}")
    start = perf_counter()
    subject = load_subject(scene, size, runs)
    references = folder / REFERENCES
    is_limited = quick or math.isfinite(limit_s)
    reference_limit_s = 0.0 if quick else _REFERENCE_FRACTION * limit_s - (perf_counter() - start)
    try:
        reference = render_reference(
            subject,
            references,
            _SMALL_REFERENCE if is_limited else QUALITIES["reference"],
            (_SMALL_TARGET_FRACTION if is_limited else TARGET_FRACTION) * SMALLEST_ERROR,
            limit_s=reference_limit_s,
            on_progress=on_progress,
        )
    except OSError as error:
        raise write_error(error, references) from None
    variants = other_variants()
    # A reference that is finished early leaves more time for the settings; variants share the time equally.
    left_s = limit_s - (perf_counter() - start)
    results = measure_settings(
        subject, compared, reference, runs, limit_s=left_s / (1 + len(variants)), on_progress=on_progress
    )
    for number, variant in enumerate(variants):
        on_progress(f"{scene.name}: {variant}")
        left_s = limit_s - (perf_counter() - start)
        results += measure_variant(
            variant, scene.name, size, runs, references, limit_s=left_s / (len(variants) - number)
        )
    # The subject and its renderers are freed before the next scene is loaded.
    summary = {
        "recipe": scene.recipe,
        "changes": dict(scene.changes),
        "frame": scene.index,
        "meaning": scene.description,
        "size": [subject.camera.width, subject.camera.height],
        "triangles": len(subject.scene.mesh.faces),
        "of_triangles": len(subject.full_scene.mesh.faces),
        "reference": {
            "pictures": reference.renders,
            "seconds": reference.seconds,
            "error_codes": reference.error_codes,
        },
    }
    return _MeasuredScene(scene, summary, results)


def _scene_line(measured: _MeasuredScene) -> str:
    """A scene and its reference as an item of a list."""
    scene, summary = measured.scene, measured.summary
    reference = summary["reference"]
    return (
        f"- `{scene.name}`: {scene.description}; frame {scene.index} of `{scene.recipe}`, {measured.size}, "
        f"{summary['triangles']:,} of {summary['of_triangles']:,} triangles. The reference is the mean of "
        f"{reference['pictures']} images without denoiser; its own error of "
        f"{reference['error_codes']:.2g} codes is not part of the errors below."
    )


def _sentences_at_one_code(ratios: Mapping[str, Sequence[TimeRatio]]) -> list[str]:
    """Times at the error of interest, as far as they are measured."""
    lines = [
        f"- `{name}`: pepperscene {format_time(ratio.ours_s)}, {ratio.other} {format_time(ratio.other_s)}, "
        f"{ratio.times:.2g} times as long."
        for name, of_scene in ratios.items()
        for ratio in of_scene
        if ratio.error_codes == CODES_OF_INTEREST and ratio.ours == "best"
    ]
    heading = f"Time at an error of {CODES_OF_INTEREST:g} code, interpolated between measured settings:"
    return [heading, "\n".join(lines)] if lines else []
