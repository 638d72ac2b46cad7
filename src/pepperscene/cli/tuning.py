"""The command that tunes a recipe to patches of measured colour."""

from __future__ import annotations

import json as json_text
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

import typer

from pepperscene.cli.application import (
    EXIT_INTERRUPTED,
    QualityOption,
    RecipeArgument,
    SetOption,
    app,
    handle_errors,
    told,
)
from pepperscene.errors import InputError

if TYPE_CHECKING:
    from pepperscene.colour import PatchSet
    from pepperscene.dataset import Recipe
    from pepperscene.tuning.parameters.parameter import Parameter
    from pepperscene.tuning.workflow import TuningResult


_HELP: Final = "help"


@app.command()
@handle_errors
def tune(
    recipe: RecipeArgument,
    fit: Annotated[
        str,
        typer.Option(
            metavar="NAMES",
            help="What to fit, as leaf.chlorophyll,fruit.ripeness,flash.colour; `help` lists what there is.",
        ),
    ],
    patches: Annotated[
        list[str] | None,
        typer.Option(
            metavar="P", help="A patches file, a folder of images, or a CSV of reflectances; can be repeated."
        ),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR", help="A new or an empty folder; the recipe's name and _tuned if left out."
        ),
    ] = None,
    bounds: Annotated[
        Path | None, typer.Option(metavar="FILE", help="How far parameters may go, over what is shipped.")
    ] = None,
    hold_out: Annotated[
        str | None,
        typer.Option(metavar="NAMES", help="Pictures that the fit does not see; separated by commas."),
    ] = None,
    verify: Annotated[
        int, typer.Option(metavar="N", min=0, help="Frames of the whole scene to hold the fit against.")
    ] = 0,
    quality: QualityOption = "draft",
    starts: Annotated[int, typer.Option(min=1, max=100, help="Most points that the fit starts from.")] = 4,
    seed: Annotated[int, typer.Option(min=0, help="Of the fit's organs, light, noise and starts.")] = 0,
    labels: Annotated[
        str | None,
        typer.Option(metavar="NAME", help="What masks mean, where P is a folder of images."),
    ] = None,
    half: Annotated[
        str | None,
        typer.Option(metavar="NAME", help="synthetic or empirical, where P is the published data set."),
    ] = None,
    set: SetOption = None,
    json: Annotated[bool, typer.Option("--json", help="Print what was found as JSON.")] = False,
) -> None:
    """Fit pigments, light and camera of a recipe to measured colour, and write the tuned recipe."""
    from pepperscene.dataset import load_recipe, parse_changes

    wanted = load_recipe(recipe, parse_changes(set or ()))
    names = _split(fit)
    if names == (_HELP,):
        _list(wanted, json)
        return
    # All that can be wrong comes to light before light is traced.
    _parameters(wanted, names, bounds)
    if not patches:
        raise InputError("--patches", "is needed: a patches file, a folder of images, or a CSV file")
    folder = out or Path(f"{Path(recipe).stem}_tuned")
    measured, held = _opened(patches, labels, half), _split(hold_out or "")
    _check_held_out(measured, held)
    options = {
        "recipe": recipe, "set": list(set or ()), "fit": list(names), "patches": list(patches),
        "bounds": None if bounds is None else str(bounds), "hold_out": list(held), "starts": starts,
        "seed": seed, "labels": labels, "half": half, "verify": verify, "quality": quality,
    }  # fmt: skip

    from pepperscene.tuning.workflow import tune as tune_recipe

    try:
        with _progress(quiet=json) as tell:
            done = tune_recipe(
                wanted,
                measured,
                names,
                folder,
                bounds=bounds,
                hold_out=held,
                starts=starts,
                seed=seed,
                verify=verify,
                quality=quality,
                options=options,
                extends=recipe,
                on_progress=tell,
            )
    except KeyboardInterrupt:
        told("interrupted; nothing was written")
        raise typer.Exit(EXIT_INTERRUPTED) from None
    if json:
        typer.echo(json_text.dumps(_record(done), indent=1, allow_nan=False))
    else:
        _tell(done)


def _opened(patches: Sequence[str], labels: str | None, half: str | None) -> PatchSet:
    """All patches in one set; labels and half go with those that are folders."""
    from pepperscene.colour import open_patches
    from pepperscene.tuning.workflow import merge_patches

    folders = [Path(one).is_dir() for one in patches]
    for option, value in (("--labels", labels), ("--half", half)):
        if value is not None and not any(folders):
            raise InputError(option, "goes only with a folder of images")
    return merge_patches(
        [
            open_patches(one, labels=labels, half=half) if folder else open_patches(one)
            for one, folder in zip(patches, folders, strict=True)
        ]
    )


def _check_held_out(measured: PatchSet, held: Sequence[str]) -> None:
    pictures = measured.pictures
    for name in held:
        if name not in pictures:
            there = ", ".join(pictures) or "none"
            raise InputError("--hold-out", f"no patch is of a picture {name!r}; pictures are {there}")
    if held and len({*held}) == len(pictures) and not measured.spectra:
        raise InputError("--hold-out", "leaves nothing to fit to: it names all pictures")


def _parameters(recipe: Recipe, names: Sequence[str], bounds: Path | None = None) -> tuple[Parameter, ...]:
    from pepperscene.dataset.recipe.resolved import load_camera, load_recipe_cultivar
    from pepperscene.tuning.parameters.parameter import select_parameters

    return select_parameters(recipe, load_recipe_cultivar(recipe), load_camera(recipe), names, bounds)


def _list(recipe: Recipe, json: bool) -> None:
    """All that can be fitted of a recipe."""
    from pepperscene.colour.comparison.tables import format_tables
    from pepperscene.dataset.recipe.resolved import load_camera, load_recipe_cultivar
    from pepperscene.tuning.output.report import known_table
    from pepperscene.tuning.parameters.parameter import known_parameters

    names = known_parameters(load_recipe_cultivar(recipe), load_camera(recipe))
    if json:
        typer.echo(json_text.dumps(list(names)))
        return
    # A path as a whole and its two ends cannot be fitted together.
    ends = [name for name in names if name.count(".") > 1]
    found = [_parameters(recipe, some) for some in ([n for n in names if n not in ends], ends) if some]
    known = {one.name: one for some in found for one in some}
    typer.echo(format_tables([known_table(tuple(known[name] for name in names))]))


def _record(done: TuningResult) -> dict[str, Any]:
    """What stands in the record, and which files there are."""
    from pepperscene.tuning.output.write import RECORD

    (record,) = (path for path in done.files if path.name == RECORD)
    told: dict[str, Any] = json_text.loads(record.read_text(encoding="utf-8"))
    return {**told, "files": [str(path) for path in done.files]}


def _tell(done: TuningResult) -> None:
    from pepperscene.colour.comparison.tables import format_tables
    from pepperscene.tuning.output.report import fit_tables

    typer.echo(format_tables(fit_tables(done.fit, done.verification)))
    typer.echo()
    for line in dict.fromkeys((*done.fit.diagnostics, *done.fit.undetermined)):
        typer.echo(line)
    typer.echo()
    for path in done.files:
        typer.echo(path)


@contextmanager
def _progress(quiet: bool) -> Iterator[Callable[[str], None] | None]:
    """What to call with a line now and then; on a terminal there is a sign of life below."""
    if quiet:
        yield None
        return
    if not sys.stderr.isatty():
        yield told
        return
    from rich.console import Console
    from rich.text import Text

    console = Console(stderr=True)
    with console.status("fitting"):
        yield lambda line: console.print(Text(line))


def _split(names: str) -> tuple[str, ...]:
    return tuple(name.strip() for name in names.split(",") if name.strip())
