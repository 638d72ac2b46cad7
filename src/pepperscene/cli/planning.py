"""The command `plan`: a dry run of a build."""

from __future__ import annotations

import json as json_text
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from pepperscene.cli.application import (
    DEFAULTS,
    CodeOption,
    JsonOption,
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
from pepperscene.cli.progress import echo_progress

if TYPE_CHECKING:
    from pepperscene.building.execution.job import BuildOptions
    from pepperscene.recipe.resolve.resolved import ResolvedRecipe


@app.command()
@handle_errors
def plan(
    recipe: RecipeArgument = "demo",
    frames: Annotated[
        str | None,
        typer.Option(metavar="A:B", help="Frames A to B - 1, counted from 0. Default: the recipe's."),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="PNG file for a drawing of the camera places, or a folder for RECIPE_plan.png.",
        ),
    ] = None,
    poses: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE", help="File for the poses of the selected frames: .json, .txt, .csv, or a folder."
        ),
    ] = None,
    probe: Annotated[
        bool, typer.Option(help="Render the first selected frame to estimate time, memory and disk space.")
    ] = True,
    outputs: OutputsOption = DEFAULTS,
    quality: QualityOption = "standard",
    target_error: TargetOption = None,
    seed: SeedOption = None,
    set: SetOption = None,
    allow_code: CodeOption = False,
    workers: Annotated[
        int | None,
        typer.Option(metavar="N", help="Processes of the build that is estimated. Default: one."),
    ] = None,
    json: JsonOption = False,
) -> None:
    """Describe what a build would make, what it costs and where its cameras are, without building."""
    names = parse_outputs(outputs)
    from pepperscene.building.execution.job import BuildOptions

    options = BuildOptions(quality=quality, target_error=target_error, seed=seed, workers=workers)
    selected = select_frames(recipe, set, frames, allow_code=allow_code)
    describe_build(selected, names, options, json=json, probe=probe, out=out, poses=poses)


def select_frames(
    recipe: str, changes: list[str] | None, frames: str | None = None, *, allow_code: bool = False
) -> ResolvedRecipe:
    """A recipe with changes as for `--set`, which selects frames "A:B", or those of the recipe."""
    from pepperscene.recipe.resolve.load import parse_changes, resolve_recipe

    values = parse_changes(changes or ())
    resolved = resolve_recipe(recipe, values, allow_code=allow_code)
    if frames is None:
        return resolved
    selected = list(resolved.recipe.plan.select_indices(frames))
    return resolve_recipe(recipe, {**values, "plan.select": selected}, allow_code=allow_code)


def describe_build(
    resolved: ResolvedRecipe,
    outputs: tuple[str, ...],
    options: BuildOptions,
    *,
    json: bool,
    probe: bool = True,
    out: Path | None = None,
    poses: Path | None = None,
) -> None:
    """Print what a build would make and cost; the other arguments are those of `plan`."""
    from pepperscene.review.preview.preview import preview_plan
    from pepperscene.review.preview.text import plan_lines

    options = replace(options, on_notice=_echo_notice)
    preview = preview_plan(resolved, outputs, options, probe=probe, picture=out, poses=poses)
    if json:
        typer.echo(json_text.dumps(preview.to_json(), indent=2, default=str, allow_nan=False))
        return
    for line in plan_lines(preview.summary, preview.cost):
        typer.echo(line)
    for warning in preview.summary.warnings:
        _echo_notice(warning)
    for path in preview.files:
        typer.echo(path)


def _echo_notice(text: str) -> None:
    echo_progress(f"note: {text}")
