"""The command `light`."""

from __future__ import annotations

import typer

from pepperscene.building.scenes.light_options import LightOptions
from pepperscene.cli.application import RecipeArgument, SeedOption, SetOption, command
from pepperscene.cli.building import FrameOption, TableFormatOption, TablesOption
from pepperscene.cli.progress import echo_progress


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
    for path in write_light(tables, out, form):
        typer.echo(path)
