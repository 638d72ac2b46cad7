"""Commands that fit a recipe to measured colour: `tune` to patches, `calibrate` to photographs of a chart."""

from __future__ import annotations

import json as json_text
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

import typer

from pepperscene.calibration.options import CalibrationOptions
from pepperscene.cli.application import (
    JsonOption,
    LabelOptions,
    RecipeArgument,
    SetOption,
    command,
    print_json,
    print_paths,
)
from pepperscene.cli.options import parse_numbers
from pepperscene.cli.progress import echo_progress
from pepperscene.errors import InputError
from pepperscene.options import Option

if TYPE_CHECKING:
    from pepperscene.colour import PatchSet
    from pepperscene.recipe.recipe import Recipe
    from pepperscene.tuning.bounds import Parameter
    from pepperscene.tuning.workflow import TuningResult

_HELP: Final = "help"


@dataclass(frozen=True)
class TuneOptions:
    """How a recipe is fitted; the attributes are those of `pepperscene.TuningOptions`."""

    bounds: Annotated[Path | None, Option("TOML file that overrides the default bounds.", "FILE")] = None
    hold_out: Annotated[
        str | None, Option("Images to hold out for validation, comma-separated.", "NAMES")
    ] = None
    verify: Annotated[
        int, Option("Frames of the full scene to render for verification.", "N", minimum=0, shows_range=True)
    ] = 0
    quality: Annotated[str, Option("Rendering quality: draft, standard or reference.", "NAME")] = "draft"
    starts: Annotated[
        int, Option("Maximum number of starting points.", minimum=1, maximum=100, shows_range=True)
    ] = 4
    seed: Annotated[
        int, Option("Random seed: organs, light, noise, starting points.", minimum=0, shows_range=True)
    ] = 0
    allow_code: Annotated[
        bool,
        Option('Allow the code of the recipe to run, which views of the kind "function" need.'),
    ] = False


@command
def tune(
    *,
    recipe: RecipeArgument,
    fit: Annotated[
        str,
        typer.Option(
            metavar="NAMES",
            help="Parameters to fit, comma-separated (leaf.chlorophyll,flash.colour); `help` lists them.",
        ),
    ],
    patches: Annotated[
        list[str] | None,
        typer.Option(metavar="P", help="Patches file, folder of images, or CSV of reflectances; repeatable."),
    ] = None,
    out: Annotated[
        Path | None, typer.Option(metavar="DIR", help="New or empty folder. Default: RECIPE_tuned.")
    ] = None,
    options: TuneOptions,
    meaning: LabelOptions,
    set: SetOption = None,
    json: JsonOption = False,
) -> None:
    """Fit a recipe to measured colours. Fits pigments, light and camera, and writes the tuned recipe."""
    from pepperscene.recipe.resolve.load import load_recipe, parse_changes

    changed_recipe = load_recipe(recipe, parse_changes(set or ()))
    names = _split_names(fit)
    if names == (_HELP,):
        _list_parameters(changed_recipe, json)
        return
    # Find all errors in the arguments before the fit starts.
    _select_parameters(changed_recipe, names, options.bounds)
    if not patches:
        raise InputError("--patches", "is required: a patches file, a folder of images, or a CSV file")
    folder = out or Path(f"{Path(recipe).stem}_tuned")
    _check_name(folder)
    held_out = _split_names(options.hold_out or "")
    measured = _open_patches(patches, meaning)
    _check_held_out(measured, held_out)
    chosen = {**vars(options), "hold_out": held_out}
    record = {
        **chosen, **vars(meaning), "recipe": recipe, "set": list(set or ()), "fit": list(names),
        "patches": list(patches), "hold_out": list(held_out),
        "bounds": None if options.bounds is None else str(options.bounds),
    }  # fmt: skip
    # A permission is given anew each time.
    del record["allow_code"]

    from pepperscene.tuning.workflow import TuningOptions
    from pepperscene.tuning.workflow import tune as tune_recipe

    try:
        with _progress_callback(quiet=json) as on_progress:
            result = tune_recipe(
                changed_recipe,
                measured,
                names,
                folder,
                TuningOptions(**chosen),
                extends=recipe,
                record=record,
                on_progress=on_progress,
            )
    except KeyboardInterrupt as error:
        error.add_note("nothing was written")
        raise
    if json:
        print_json(_result_record(result))
    else:
        _print_result(result)


def _check_name(folder: Path) -> None:
    try:
        str(folder.absolute()).encode()
    except UnicodeEncodeError:
        raise InputError(
            "--out", f"must be a name in UTF-8, because the tuned recipe contains it, not {str(folder)!r}"
        ) from None


def _open_patches(patches: Sequence[str], meaning: LabelOptions) -> PatchSet:
    """Merge all patches into one set; options of labels apply to those that are folders."""
    from pepperscene.colour import open_patches
    from pepperscene.tuning.workflow import merge_patches

    folders = [Path(path).is_dir() for path in patches]
    for name, value in vars(meaning).items():
        if value is not None and not any(folders):
            raise InputError(f"--{name}", "applies only to a folder of images")
    return merge_patches(
        [
            open_patches(path, **vars(meaning)) if is_folder else open_patches(path)
            for path, is_folder in zip(patches, folders, strict=True)
        ]
    )


def _check_held_out(measured: PatchSet, held_out: Sequence[str]) -> None:
    pictures = measured.pictures
    for name in held_out:
        if name not in pictures:
            known = ", ".join(pictures) or "none"
            raise InputError("--hold-out", f"no patch is of a picture {name!r}; pictures are {known}")
    if held_out and len({*held_out}) == len(pictures) and not measured.spectra:
        raise InputError("--hold-out", "leaves no data for the fit: it names all pictures")


def _select_parameters(
    recipe: Recipe, names: Sequence[str], bounds: Path | None = None
) -> tuple[Parameter, ...]:
    from pepperscene.recipe.resolve.load_camera import load_camera
    from pepperscene.recipe.resolve.resolved import load_recipe_cultivar
    from pepperscene.tuning.parameters import select_parameters

    return select_parameters(recipe, load_recipe_cultivar(recipe), load_camera(recipe), names, bounds)


def _list_parameters(recipe: Recipe, json: bool) -> None:
    """Print the parameters of a recipe that can be fitted."""
    from pepperscene.colour.comparison.tables import format_tables
    from pepperscene.recipe.resolve.load_camera import load_camera
    from pepperscene.recipe.resolve.resolved import load_recipe_cultivar
    from pepperscene.tuning.parameters import known_parameters
    from pepperscene.tuning.report import known_table

    names = known_parameters(load_recipe_cultivar(recipe), load_camera(recipe))
    if json:
        typer.echo(json_text.dumps(list(names), allow_nan=False))
        return
    # A ripening path and its two ends cannot be selected together.
    ends = [name for name in names if name.count(".") > 1]
    groups = [group for group in ([name for name in names if name not in ends], ends) if group]
    known = {parameter.name: parameter for group in groups for parameter in _select_parameters(recipe, group)}
    typer.echo(format_tables([known_table(tuple(known[name] for name in names))]))


def _result_record(result: TuningResult) -> dict[str, Any]:
    """The record of the fit, and the files written."""
    from pepperscene.dataset.store.frame_json import read_json
    from pepperscene.tuning.write import RECORD

    (record,) = (path for path in result.files if path.name == RECORD)
    return {**read_json(record), "files": [str(path) for path in result.files]}


def _print_result(result: TuningResult) -> None:
    from pepperscene.colour.comparison.tables import format_tables
    from pepperscene.tuning.report import fit_tables

    typer.echo(format_tables(fit_tables(result.fit, result.verification)))
    typer.echo()
    for line in dict.fromkeys((*result.fit.diagnostics, *result.fit.undetermined)):
        typer.echo(line)
    typer.echo()
    print_paths(result.files)


@contextmanager
def _progress_callback(quiet: bool) -> Iterator[Callable[[str], None] | None]:
    """Callback for lines of progress; a terminal also shows a spinner."""
    if quiet:
        yield None
        return
    if not sys.stderr.isatty():
        yield echo_progress
        return
    from rich.console import Console
    from rich.text import Text

    console = Console(stderr=True)
    with console.status("fitting"):
        yield lambda line: console.print(Text(line))


def _split_names(names: str) -> tuple[str, ...]:
    return tuple(name.strip() for name in names.split(",") if name.strip())


@command
def calibrate(
    photographs: Annotated[
        list[Path],
        typer.Argument(metavar="CHART...", help="Photographs of a ColorChecker Classic or a grey card."),
    ],
    *,
    out: Annotated[Path, typer.Option(metavar="FILE", help="Recipe to write, such as camera.toml.")],
    options: CalibrationOptions,
    corners: Annotated[
        str | None,
        typer.Option(
            metavar="X,Y,X,Y,X,Y,X,Y",
            help="Outer corners of the chart's four corner fields, in pixels. Default: found automatically.",
        ),
    ] = None,
    grey_card: Annotated[
        str | None,
        typer.Option(metavar="X,Y,W,H", help="Rectangle on a grey card, in pixels, instead of a chart."),
    ] = None,
) -> None:
    """Write the recipe with which frames look like a camera's photographs of a ColorChecker."""
    options = replace(
        options,
        corners=None if corners is None else parse_numbers(corners, "corners"),
        grey_card=None if grey_card is None else parse_numbers(grey_card, "grey_card"),
    )
    from pepperscene.calibration.run import calibrate as calibrate_camera
    from pepperscene.calibration.write import calibration_values

    calibration = calibrate_camera(photographs, out, options)
    for name, value in calibration_values(calibration):
        typer.echo(f"{name}: {value}")
    print_paths(calibration.files)
