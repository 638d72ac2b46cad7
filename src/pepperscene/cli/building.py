"""Commands that render: a data set, or one frame of it."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from pepperscene.cli.application import (
    DEFAULTS,
    OutputsOption,
    QualityOption,
    RecipeArgument,
    SeedOption,
    SetOption,
    TargetOption,
    app,
    ended_by_signals,
    handle_errors,
    names_of,
)


@app.command()
@handle_errors
def build(
    out: Annotated[Path, typer.Option(help="Folder of the data set; made when missing.")],
    recipe: RecipeArgument = "demo",
    frames: Annotated[
        str | None,
        typer.Option(
            metavar="A:B", help="Indices A to B - 1, counted from 0; by default what the recipe selects."
        ),
    ] = None,
    outputs: OutputsOption = DEFAULTS,
    quality: QualityOption = "standard",
    target_error: TargetOption = None,
    seed: SeedOption = None,
    set: SetOption = None,
    workers: Annotated[
        int | None,
        typer.Option(
            metavar="N",
            help="Processes on this machine, each with its share of the cores; without it, one with all.",
        ),
    ] = None,
    scheduler: Annotated[
        str | None, typer.Option(metavar="ADDRESS", help="Of a running Dask cluster that sees the folder.")
    ] = None,
    slurm: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Jobs to ask Slurm for, as a TOML file.")
    ] = None,
    json: Annotated[
        bool, typer.Option("--json", help="Tell of each frame as a line of JSON on standard output.")
    ] = False,
) -> None:
    """Build a data set, or what is missing of it."""
    names = names_of(outputs)
    from pepperscene.cli.progress import progress_reporter
    from pepperscene.dataset import BuildOptions, parse_changes, resolve_recipe
    from pepperscene.dataset import build as build_dataset

    resolved = resolve_recipe(recipe, parse_changes(set or ()))
    with ended_by_signals(), progress_reporter(json) as shown:
        options = BuildOptions(
            quality=quality,
            target_error=target_error,
            seed=seed,
            workers=workers,
            scheduler=scheduler,
            slurm=slurm,
            on_notice=shown.notice,
        )
        done = build_dataset(resolved, out, frames, names, options, on_frame=shown.frame)
    shown.end(done, out)


@app.command()
@handle_errors
def render(
    out: Annotated[Path, typer.Option(help="Folder of the frame; made when missing.")],
    recipe: RecipeArgument = "demo",
    frame: Annotated[
        int | None,
        typer.Option(metavar="N", help="Its index, counted from 0; by default the first that is selected."),
    ] = None,
    outputs: OutputsOption = DEFAULTS,
    quality: QualityOption = "standard",
    target_error: TargetOption = None,
    seed: SeedOption = None,
    set: SetOption = None,
) -> None:
    """Render one frame of a recipe, to look at it or to try a setting."""
    names = names_of(outputs)
    from pepperscene.dataset import BuildOptions, parse_changes, render_frame, resolve_recipe

    resolved = resolve_recipe(recipe, parse_changes(set or ()))
    options = BuildOptions(quality=quality, target_error=target_error, seed=seed)
    for path in render_frame(resolved, out, frame, names, options):
        typer.echo(path)


@app.command()
@handle_errors
def recipes() -> None:
    """List the shipped recipes."""
    from pepperscene.dataset import load_recipe
    from pepperscene.shipped import shipped_folder

    for path in sorted(shipped_folder("recipes").glob("*.toml")):
        plan = load_recipe(path.stem).plan
        chosen = len(plan.select_indices(None))
        total = f"{plan.count:,} frames: {plan.sets} sets x {plan.rotations} rotations x {plan.frames} steps"
        typer.echo(f"{path.stem:<12} {total}{f'; builds {chosen} of them' if chosen < plan.count else ''}")


@app.command()
@handle_errors
def plant(
    cultivar: Annotated[
        str, typer.Argument(help="A cultivar file, or the name of a shipped one (see `cultivars`).")
    ],
    out: Annotated[
        Path, typer.Option(help="The mesh's file: its ending tells the format, .glb, .obj, .ply or .stl.")
    ],
    seed: Annotated[int, typer.Option(help="Another seed is another plant.")] = 0,
    detail: Annotated[
        float, typer.Option(help="Fineness of the mesh: twice as much has four times the triangles.")
    ] = 1.0,
    until: Annotated[
        str | None, typer.Option(metavar="CULTIVAR", help="Of a later date; the plant stands between both.")
    ] = None,
    share: Annotated[
        float | None,
        typer.Option(help="How far from the first to the second, 0 to 1; 0.5 if left out."),
    ] = None,
    picture: Annotated[bool, typer.Option(help="Render a picture beside the mesh, of the same name.")] = True,
    quality: QualityOption = "standard",
) -> None:
    """Grow one plant and write its mesh for other programs, with a picture of it."""
    from pepperscene.dataset.scenes.plant_export import export_plant

    done = export_plant(
        cultivar, out, seed, detail=detail, until=until, share=share, picture=picture, quality=quality
    )
    typer.echo(
        f"{done.cultivar}, seed {seed}: {sum(done.organs.values()):,} organs, {done.triangles:,} triangles, "
        f"{done.height_m:.2f} m tall, grown in {done.seconds:.2f} s"
    )
    for kind, count in done.organs.items():
        typer.echo(f"  {count:>4} {kind}")
    left = done.contacts
    typer.echo(
        f"  {left.fruit_touching} of {left.fruit} fruit still touch another organ, "
        f"{left.blades_touching} of {left.blades} blades a stem"
    )
    for path in done.files:
        typer.echo(path)


@app.command()
@handle_errors
def cultivars() -> None:
    """List the shipped cultivars."""
    from pepperscene.cultivar import load_cultivar
    from pepperscene.shipped import shipped_folder

    names = [path.stem for path in sorted(shipped_folder("plants").glob("*.toml"))]
    for name in names:
        one = load_cultivar(name)
        dated = f", {one.date}" if one.date is not None else ""
        typer.echo(
            f"{name:<{max(map(len, names))}}  {one.name}, {one.species}: {one.stem.parts} nodes{dated}"
        )
