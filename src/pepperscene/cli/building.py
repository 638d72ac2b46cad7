"""Commands that build data sets, frames and plants, and list the shipped recipes and cultivars."""

from __future__ import annotations

import json as json_text
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from pepperscene.building.execution.options import BuildOptions
from pepperscene.building.scenes.light_options import LightOptions
from pepperscene.cli.application import (
    DEFAULTS,
    CodeOption,
    OutputsOption,
    QualityOption,
    RecipeArgument,
    SeedOption,
    SetOption,
    command,
    parse_outputs,
    print_paths,
)
from pepperscene.cli.options import Only
from pepperscene.cli.progress import echo_note, echo_progress
from pepperscene.errors import ArgumentError
from pepperscene.interrupts import raise_if_interrupted
from pepperscene.options import Option

if TYPE_CHECKING:
    from pepperscene.recipe.resolve.resolved import ResolvedRecipe


@dataclass(frozen=True)
class DryRun:
    """What a build describes instead of building."""

    dry_run: Annotated[
        bool, Option("Only describe the build: frames, cameras, time, memory and disk space.")
    ] = False
    drawing: Annotated[
        Path | None,
        Option(
            "With --dry-run: PNG file for a drawing of the camera places, or a folder for RECIPE_plan.png.",
            "FILE",
        ),
    ] = None
    poses: Annotated[
        Path | None,
        Option(
            "With --dry-run: file for the poses of the selected frames: .json, .txt, .csv, or a folder.",
            "FILE",
        ),
    ] = None
    probe: Annotated[
        bool,
        Option("With --dry-run: render the first selected frame to estimate time, memory and disk space."),
    ] = True

    def check(self, out: Path | None) -> None:
        """Raise `ArgumentError` for options that need others."""
        if self.dry_run:
            return
        if out is None:
            raise ArgumentError("out", "is required without --dry-run")
        for name, value in (("drawing", self.drawing), ("poses", self.poses)):
            if value is not None:
                raise ArgumentError(name, "applies only with --dry-run")
        if not self.probe:
            raise ArgumentError("no_probe", "applies only with --dry-run")


FrameOption = Annotated[
    int | None,
    typer.Option(metavar="N", help="Index of the frame, counted from 0. Default: the first selected."),
]
TablesOption = Annotated[Path, typer.Option(help="Folder of the tables; created if missing.")]
TableFormatOption = Annotated[
    str, typer.Option("--format", metavar="parquet|csv", help="Format of the files.")
]


@command
def build(
    *,
    out: Annotated[Path | None, typer.Option(help="Folder of the data set; created if missing.")] = None,
    recipe: RecipeArgument = "demo",
    frames: Annotated[
        str | None,
        typer.Option(metavar="A:B", help="Frames A to B - 1, counted from 0. Default: the recipe's."),
    ] = None,
    outputs: OutputsOption = DEFAULTS,
    options: BuildOptions,
    set: SetOption = None,
    json: Annotated[
        bool, typer.Option("--json", help="Report progress as JSON lines on standard output.")
    ] = False,
    dry: DryRun,
) -> None:
    """Build a data set. Finished frames are kept: run the same command again to resume a build."""
    names = parse_outputs(outputs)
    dry.check(out)
    from pepperscene.building.execution.build import BuildProgress
    from pepperscene.building.execution.build import build as build_dataset
    from pepperscene.cli.progress import progress_reporter
    from pepperscene.recipe.resolve.load import parse_changes, resolve_recipe

    changes = parse_changes(set or ())
    resolved = resolve_recipe(recipe, changes, allow_code=options.allow_code)
    if dry.dry_run:
        if frames is not None:
            changes["plan.select"] = list(resolved.recipe.plan.select_indices(frames))
            resolved = resolve_recipe(recipe, changes, allow_code=options.allow_code)
        _describe_build(resolved, names, options, dry, json)
        return
    assert out is not None
    try:
        with progress_reporter(json) as reporter:

            def report_frame(progress: BuildProgress) -> None:
                reporter.frame(progress)
                raise_if_interrupted()

            # Frames that the user has named need no note.
            on_start = reporter.selected if frames is None else None
            options = replace(options, on_notice=reporter.notice, on_start=on_start)
            result = build_dataset(resolved, out, frames, names, options, on_frame=report_frame)
    except KeyboardInterrupt as error:
        error.add_note("to resume the build, run the same command again")
        raise
    for note in result.notes:
        reporter.notice(note)
    reporter.end(result, out)


def _describe_build(
    resolved: ResolvedRecipe, outputs: tuple[str, ...], options: BuildOptions, dry: DryRun, json: bool
) -> None:
    """Print what a build would make and cost."""
    from pepperscene.review.preview.preview import preview_plan
    from pepperscene.review.preview.text import plan_lines

    options = replace(options, on_notice=echo_note)
    preview = preview_plan(resolved, outputs, options, probe=dry.probe, picture=dry.drawing, poses=dry.poses)
    if json:
        typer.echo(json_text.dumps(preview.to_json(), indent=2, default=str, allow_nan=False))
        return
    for line in plan_lines(preview.summary, preview.cost):
        typer.echo(line)
    for warning in preview.summary.warnings:
        echo_note(warning)
    print_paths(preview.files)


@command
def render(
    *,
    out: Annotated[Path, typer.Option(help="Folder of the frame; created if missing.")],
    recipe: RecipeArgument = "demo",
    frame: FrameOption = None,
    outputs: OutputsOption = DEFAULTS,
    options: Annotated[BuildOptions, Only("quality", "target_error", "seed", "allow_code")],
    set: SetOption = None,
) -> None:
    """Render one frame of a recipe, to preview it or to try a setting."""
    names = parse_outputs(outputs)
    from pepperscene.building.execution.single_frame import render_frame
    from pepperscene.cli.progress import render_status
    from pepperscene.recipe.resolve.load import parse_changes, resolve_recipe

    resolved = resolve_recipe(recipe, parse_changes(set or ()), allow_code=options.allow_code)
    with render_status() as on_stage:
        paths = render_frame(resolved, out, frame, names, options, on_stage)
    print_paths(paths)


@command
def scene(
    *,
    out: Annotated[
        Path,
        typer.Option(help="File of the scene; its suffix sets the format: .glb, .usd, .usda, .usdc or .sdf."),
    ],
    recipe: RecipeArgument = "demo",
    frame: FrameOption = None,
    seed: SeedOption = None,
    set: SetOption = None,
    allow_code: CodeOption = False,
) -> None:
    """Export the scene of a frame for simulators and other programs, with the poses of all organs."""
    from pepperscene.cli.progress import render_status
    from pepperscene.export import export_scene
    from pepperscene.recipe.resolve.load import parse_changes, resolve_recipe

    resolved = resolve_recipe(recipe, parse_changes(set or ()), seed, allow_code=allow_code)
    with render_status() as on_stage:
        paths = export_scene(resolved, out, frame, on_stage=on_stage)
    print_paths(paths)


@command
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


@command
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
    from pepperscene.building.scenes.plants import growth_stage

    stage = growth_stage(cultivar, until, share)
    result = export_plant(stage, out, seed, detail=detail, picture=picture, quality=quality)
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
    print_paths(result.files)


@command
def traits(
    *,
    out: TablesOption,
    recipe: RecipeArgument = "demo",
    frame: FrameOption = None,
    form: TableFormatOption = "parquet",
    seed: SeedOption = None,
    set: SetOption = None,
) -> None:
    """Write traits of each plant, leaf and fruit of a scene as tables, on all dates of a growth series."""
    from pepperscene.building.scenes.trait_tables import (
        TABLES,
        check_tables_output,
        plant_traits,
        write_traits,
    )
    from pepperscene.recipe.resolve.load import parse_changes, resolve_recipe

    check_tables_output(TABLES, out, form)
    tables = plant_traits(resolve_recipe(recipe, parse_changes(set or ()), seed), frame, echo_progress)
    plants, leaves, fruit = (table.num_rows for table in (tables.plants, tables.leaves, tables.fruit))
    typer.echo(f"{plants:,} plants, {leaves:,} leaves, {fruit:,} fruit")
    print_paths(write_traits(tables, out, form))


@command
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


@command
def light(
    *,
    out: TablesOption,
    recipe: RecipeArgument = "demo",
    frame: FrameOption = None,
    options: LightOptions,
    form: TableFormatOption = "parquet",
    seed: SeedOption = None,
    set: SetOption = None,
) -> None:
    """Write the light that each organ, plant, layer and row absorbs as tables, at a moment or over a day."""
    from pepperscene.building.scenes.light_tables import LIGHT_TABLES, light_tables, write_light
    from pepperscene.building.scenes.trait_tables import check_tables_output
    from pepperscene.recipe.resolve.load import parse_changes, resolve_recipe

    check_tables_output(LIGHT_TABLES, out, form)
    resolved = resolve_recipe(recipe, parse_changes(set or ()), seed)
    tables = light_tables(resolved, frame, options, echo_progress)
    times = tables.times.num_rows
    typer.echo(f"{times:,} time{'s' * (times != 1)}, {tables.organs.num_rows:,} rows of organs")
    print_paths(write_light(tables, out, form))
