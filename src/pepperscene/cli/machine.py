"""Commands that examine and benchmark this machine."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from pepperscene.cli.application import command
from pepperscene.cli.progress import echo_progress
from pepperscene.errors import EXIT_BAD_INPUT, InputError


@command
def bench(
    out: Annotated[Path, typer.Option(help="Folder for tables and plots; created if missing.")],
    scene: Annotated[
        str | None,
        typer.Option(
            metavar="NAMES",
            help="Scenes, comma-separated: flash, daylight, nir, near. Default: all; flash with --scaling.",
        ),
    ] = None,
    runs: Annotated[int, typer.Option(help="Number of timed frames of each setting.")] = 5,
    budget: Annotated[
        float,
        typer.Option(
            metavar="SECONDS", help="Approximate time limit of the whole benchmark; inf has no limit."
        ),
    ] = 900.0,
    size: Annotated[str | None, typer.Option(metavar="WxH", help="Size of the images in pixels.")] = None,
    quick: Annotated[bool, typer.Option("--quick", help="Few settings and a coarse reference.")] = False,
    all_settings: Annotated[
        bool,
        typer.Option(
            "--all-settings", help="More settings: fixed samples, no denoiser, whole scene, other samplers."
        ),
    ] = False,
    profile: Annotated[
        bool, typer.Option("--profile", help="Instead, time the stages of a frame, including the imports.")
    ] = False,
    scaling: Annotated[
        bool,
        typer.Option(
            "--scaling", help="Instead, measure cost against plants, triangles, pixels, frames and workers."
        ),
    ] = False,
) -> None:
    """Measure rendering time against error. Writes tables and plots."""
    from pepperscene import bench as benchmark

    names = ("flash" if scaling else ",".join(benchmark.SCENES)) if scene is None else scene
    scenes, pixels = benchmark.select_scenes(names), None if size is None else benchmark.parse_size(size)
    if profile and scaling:
        raise InputError("--profile", "cannot be combined with --scaling")
    if all_settings and (profile or scaling):
        raise InputError("--all-settings", "cannot be combined with --profile or --scaling")
    if profile or scaling:
        measure = benchmark.profile_frames if profile else benchmark.measure_scaling
        files = measure(out, scenes, pixels, runs=runs, quick=quick, on_progress=echo_progress)
    else:
        files = benchmark.run_benchmark(
            out,
            scenes,
            pixels,
            runs=runs,
            budget_s=budget,
            quick=quick,
            all_settings=all_settings,
            on_progress=echo_progress,
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
