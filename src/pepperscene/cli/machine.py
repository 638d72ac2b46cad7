"""Commands that examine and benchmark this machine."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import typer

from pepperscene.cli.application import command
from pepperscene.cli.progress import echo_progress
from pepperscene.errors import EXIT_BAD_INPUT, InputError
from pepperscene.options import Option


@dataclass(frozen=True)
class BenchCost:
    """How much is measured."""

    runs: Annotated[int, Option("Number of timed frames of each setting.")] = 5
    budget: Annotated[
        float, Option("Approximate time limit of the whole benchmark; inf has no limit.", "SECONDS")
    ] = 900.0
    size: Annotated[str | None, Option("Size of the images in pixels.", "WxH")] = None
    quick: Annotated[bool, Option("Few settings and a coarse reference.")] = False


@dataclass(frozen=True)
class BenchMode:
    """What is measured."""

    all_settings: Annotated[
        bool, Option("More settings: fixed samples, no denoiser, whole scene, other samplers.")
    ] = False
    profile: Annotated[bool, Option("Instead, time the stages of a frame, including the imports.")] = False
    scaling: Annotated[
        bool, Option("Instead, measure cost against plants, triangles, pixels, frames and workers.")
    ] = False


@command
def bench(
    *,
    out: Annotated[Path, typer.Option(help="Folder for tables and plots; created if missing.")],
    scene: Annotated[
        str | None,
        typer.Option(
            metavar="NAMES",
            help="Scenes, comma-separated: flash, daylight, nir, near. Default: all; flash with --scaling.",
        ),
    ] = None,
    cost: BenchCost,
    mode: BenchMode,
) -> None:
    """Measure rendering time against error. Writes tables and plots."""
    from pepperscene import bench as benchmark

    names = ("flash" if mode.scaling else ",".join(benchmark.SCENES)) if scene is None else scene
    scenes = benchmark.select_scenes(names)
    pixels = None if cost.size is None else benchmark.parse_size(cost.size)
    if mode.profile and mode.scaling:
        raise InputError("--profile", "cannot be combined with --scaling")
    if mode.all_settings and (mode.profile or mode.scaling):
        raise InputError("--all-settings", "cannot be combined with --profile or --scaling")
    shared: dict[str, Any] = {"runs": cost.runs, "quick": cost.quick, "on_progress": echo_progress}
    if mode.profile or mode.scaling:
        measure = benchmark.profile_frames if mode.profile else benchmark.measure_scaling
        files = measure(out, scenes, pixels, **shared)
    else:
        files = benchmark.run_benchmark(
            out, scenes, pixels, budget_s=cost.budget, all_settings=mode.all_settings, **shared
        )
    typer.echo(files.markdown)
    for path in files.files:
        typer.echo(path, err=True)


@command
def doctor() -> None:
    """Check the installation: can this machine render?"""
    from pepperscene.render.doctor import diagnose

    diagnosis = diagnose()
    width = max(len(line.what) for line in diagnosis.lines)
    for line in diagnosis.lines:
        mark = typer.style("ok  ", fg="green") if line.good else typer.style("BAD ", fg="red", bold=True)
        typer.echo(f"{mark} {line.what:<{width}}  {line.found}")
        if line.advice:
            typer.echo(f"     {'':<{width}}  -> {line.advice}")
    if not diagnosis.healthy:
        raise typer.Exit(EXIT_BAD_INPUT)
    typer.echo("This machine can render.")
