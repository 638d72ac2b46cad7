"""Commands that build data sets, frames and plants, and list the shipped recipes and cultivars."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from pepperscene.cli.application import (
    DEFAULTS,
    CodeOption,
    OutputsOption,
    QualityOption,
    RecipeArgument,
    SeedOption,
    SetOption,
    TargetOption,
    app,
    handle_errors,
    parse_outputs,
)
from pepperscene.cli.interrupts import raise_if_interrupted
from pepperscene.cli.planning import describe_build, select_frames


@app.command()
@handle_errors
def build(
    out: Annotated[Path, typer.Option(help="Folder of the data set; created if missing.")],
    recipe: RecipeArgument = "demo",
    frames: Annotated[
        str | None,
        typer.Option(metavar="A:B", help="Frames A to B - 1, counted from 0. Default: the recipe's."),
    ] = None,
    outputs: OutputsOption = DEFAULTS,
    quality: QualityOption = "standard",
    target_error: TargetOption = None,
    seed: SeedOption = None,
    set: SetOption = None,
    allow_code: CodeOption = False,
    workers: Annotated[
        int | None,
        typer.Option(metavar="N", help="Processes on this machine, which share its cores. Default: one."),
    ] = None,
    scheduler: Annotated[
        str | None,
        typer.Option(metavar="ADDRESS", help="Scheduler of a Dask cluster that can access the folder."),
    ] = None,
    slurm: Annotated[
        Path | None, typer.Option(metavar="FILE", help="TOML file that describes the Slurm jobs to submit.")
    ] = None,
    json: Annotated[
        bool, typer.Option("--json", help="Report progress as JSON lines on standard output.")
    ] = False,
    dry_run: Annotated[
        bool,
        typer.Option(
            "--dry-run", help="Only describe the build, as `plan` does: frames, time, memory and disk space."
        ),
    ] = False,
) -> None:
    """Build a data set. Finished frames are kept: run the same command again to resume a build."""
    names = parse_outputs(outputs)
    from pepperscene.building.execution.build import BuildProgress
    from pepperscene.building.execution.build import build as build_dataset
    from pepperscene.building.execution.job import BuildOptions
    from pepperscene.cli.progress import progress_reporter
    from pepperscene.recipe.resolve.load import parse_changes, resolve_recipe

    if dry_run:
        options = BuildOptions(quality=quality, target_error=target_error, seed=seed, workers=workers)
        selected = select_frames(recipe, set, frames, allow_code=allow_code)
        describe_build(selected, names, options, json=json)
        return
    resolved = resolve_recipe(recipe, parse_changes(set or ()), allow_code=allow_code)
    try:
        with progress_reporter(json) as reporter:

            def report_frame(progress: BuildProgress) -> None:
                reporter.frame(progress)
                raise_if_interrupted()

            options = BuildOptions(
                quality=quality,
                target_error=target_error,
                seed=seed,
                workers=workers,
                scheduler=scheduler,
                slurm=slurm,
                on_notice=reporter.notice,
                # Frames that the user has named need no note.
                on_start=reporter.selected if frames is None else None,
            )
            result = build_dataset(resolved, out, frames, names, options, on_frame=report_frame)
    except KeyboardInterrupt as error:
        error.add_note("to resume the build, run the same command again")
        raise
    for note in result.notes:
        reporter.notice(note)
    reporter.end(result, out)


@app.command()
@handle_errors
def render(
    out: Annotated[Path, typer.Option(help="Folder of the frame; created if missing.")],
    recipe: RecipeArgument = "demo",
    frame: Annotated[
        int | None,
        typer.Option(metavar="N", help="Index of the frame, counted from 0. Default: the first selected."),
    ] = None,
    outputs: OutputsOption = DEFAULTS,
    quality: QualityOption = "standard",
    target_error: TargetOption = None,
    seed: SeedOption = None,
    set: SetOption = None,
    allow_code: CodeOption = False,
) -> None:
    """Render one frame of a recipe, to preview it or to try a setting."""
    names = parse_outputs(outputs)
    from pepperscene.building.execution.job import BuildOptions
    from pepperscene.building.execution.single_frame import render_frame
    from pepperscene.cli.progress import render_status
    from pepperscene.recipe.resolve.load import parse_changes, resolve_recipe

    resolved = resolve_recipe(recipe, parse_changes(set or ()), allow_code=allow_code)
    options = BuildOptions(quality=quality, target_error=target_error, seed=seed)
    with render_status() as on_stage:
        paths = render_frame(resolved, out, frame, names, options, on_stage)
    for path in paths:
        typer.echo(path)


@app.command()
@handle_errors
def recipes() -> None:
    """List the shipped recipes."""
    from pepperscene.recipe.resolve.load import load_recipe
    from pepperscene.shipped import shipped_folder

    for path in sorted(shipped_folder("recipes").glob("*.toml")):
        plan = load_recipe(path.stem).plan
        selected = len(plan.select_indices(None))
        total = f"{plan.count:,} frames: {plan.sets} sets x {plan.rotations} rotations x {plan.frames} steps"
        total += f" x {plan.twins} twins" if plan.twins > 1 else ""
        total += f" x {plan.cameras} cameras" if plan.cameras > 1 else ""
        typer.echo(f"{path.stem:<12} {total}{f'; {selected} selected' if selected < plan.count else ''}")


@app.command()
@handle_errors
def plant(
    cultivar: Annotated[
        str, typer.Argument(help="Cultivar file, or name of a shipped cultivar (see `cultivars`).")
    ],
    out: Annotated[
        Path, typer.Option(help="Mesh file; its suffix sets the format: .glb, .obj, .ply or .stl.")
    ],
    seed: Annotated[int, typer.Option(help="Random seed; each seed gives a different plant.")] = 0,
    detail: Annotated[
        float, typer.Option(help="Mesh resolution; doubling it gives four times as many triangles.")
    ] = 1.0,
    until: Annotated[
        str | None,
        typer.Option(metavar="CULTIVAR", help="Second cultivar, of a later date, to interpolate towards."),
    ] = None,
    share: Annotated[
        float | None,
        typer.Option(help="Position between the two cultivars, 0 to 1. Default: 0.5."),
    ] = None,
    picture: Annotated[bool, typer.Option(help="Render an image of the same name as well.")] = True,
    quality: QualityOption = "standard",
) -> None:
    """Grow one plant and export its mesh, with an image."""
    from pepperscene.building.scenes.plant_export import export_plant

    result = export_plant(
        cultivar, out, seed, detail=detail, until=until, share=share, picture=picture, quality=quality
    )
    typer.echo(
        f"{result.cultivar}, seed {seed}: {sum(result.organs.values()):,} organs, "
        f"{result.triangles:,} triangles, {result.height_m:.2f} m tall, grown in {result.seconds:.2f} s"
    )
    for kind, count in result.organs.items():
        typer.echo(f"  {count:>4} {kind}")
    contacts = result.contacts
    typer.echo(
        f"  {contacts.fruit_touching} of {contacts.fruit} fruit still touch another organ, "
        f"{contacts.blades_touching} of {contacts.blades} blades a stem"
    )
    for path in result.files:
        typer.echo(path)


@app.command()
@handle_errors
def cultivars() -> None:
    """List the shipped cultivars."""
    from pepperscene.cultivar import load_cultivar
    from pepperscene.shipped import shipped_folder

    names = [path.stem for path in sorted(shipped_folder("plants").glob("*.toml"))]
    for name in names:
        model = load_cultivar(name)
        date = f", {model.date}" if model.date is not None else ""
        typer.echo(
            f"{name:<{max(map(len, names))}}  {model.name}, {model.species}: {model.stem.parts} nodes{date}"
        )
