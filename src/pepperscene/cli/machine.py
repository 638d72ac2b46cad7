"""Commands that examine and measure this machine."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from pepperscene.cli.application import app, handle_errors, told
from pepperscene.errors import EXIT_BAD_INPUT, InputError


@app.command()
@handle_errors
def bench(
    out: Annotated[Path, typer.Option(help="Folder of tables and plots; made when missing.")],
    scene: Annotated[
        str | None,
        typer.Option(
            metavar="NAMES", help="Of near, standard and dense; all, with --scaling standard, if left out."
        ),
    ] = None,
    runs: Annotated[int, typer.Option(help="Timed frames of each setting.")] = 5,
    budget: Annotated[
        float | None, typer.Option(metavar="SECONDS", help="About how long it may take.")
    ] = None,
    size: Annotated[
        str | None, typer.Option(metavar="WxH", help="Of the pictures, instead of the cameras' own.")
    ] = None,
    quick: Annotated[bool, typer.Option("--quick", help="Few settings, a coarse reference.")] = False,
    peers: Annotated[bool, typer.Option("--peers", help="Measure Blender Cycles as well.")] = False,
    profile: Annotated[
        bool, typer.Option("--profile", help="Instead: a frame by stage, from the import on.")
    ] = False,
    scaling: Annotated[
        bool,
        typer.Option("--scaling", help="Instead: against plants, triangles, pixels, frames and workers."),
    ] = False,
) -> None:
    """Measure run time against error on this machine, with a plot and tables."""
    from pepperscene import bench as room

    names = ("standard" if scaling else ",".join(room.SCENES)) if scene is None else scene
    asked = room.scenes_named(names), None if size is None else room.size_of(size)
    if profile and scaling:
        raise InputError("--profile", "goes without --scaling; one at a time")
    if profile or scaling:
        measure = room.profile_frames if profile else room.measure_scaling
        done = measure(out, *asked, runs=runs, quick=quick, told=told)
    else:
        done = room.run_benchmark(
            out, *asked, runs=runs, budget_s=budget, quick=quick, peers=peers, told=told
        )
    typer.echo(done.markdown)
    for path in done.files:
        typer.echo(path, err=True)


@app.command()
@handle_errors
def doctor() -> None:
    """Find out what this machine has and lacks for rendering."""
    from pepperscene.render.doctor import diagnose

    found = diagnose()
    width = max(len(line.what) for line in found.lines)
    for line in found.lines:
        mark = typer.style("ok  ", fg="green") if line.good else typer.style("BAD ", fg="red", bold=True)
        typer.echo(f"{mark} {line.what:<{width}}  {line.found}")
        if line.advice:
            typer.echo(f"     {'':<{width}}  -> {line.advice}")
    if not found.healthy:
        raise typer.Exit(EXIT_BAD_INPUT)
    typer.echo("All is well: this machine can render.")
