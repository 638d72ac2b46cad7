"""The command line: parse, call, show progress, exit code.

Exit codes: 0 done, 2 something that the user can mend (one line tells what), 130 interrupted.
"""

from __future__ import annotations

import functools
import sys
from collections.abc import Callable
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final, ParamSpec, TypeVar

import typer

from pepperscene.errors import EXIT_BAD_INPUT, InputError, PepperError
from pepperscene.frame import DEFAULT_OUTPUTS, OUTPUTS, check_outputs
from pepperscene.version import __version__

if TYPE_CHECKING:
    from collections.abc import Iterator

    from pepperscene.dataset import Progress

EXIT_INTERRUPTED: Final = 130
"""As shells report a process that was ended by Ctrl-C."""

_DEFAULTS: Final = ",".join(DEFAULT_OUTPUTS)

P = ParamSpec("P")
R = TypeVar("R")

app = typer.Typer(
    name="pepperscene",
    help="Labelled, radiometrically calibrated images of sweet-pepper plants, by spectral light transport.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)


def main() -> None:
    """Run the command line."""
    app()


def _explained(command: Callable[P, R]) -> Callable[P, R]:
    """The command with every foreseeable error as one line on standard error, without a traceback."""

    @functools.wraps(command)
    def run(*args: P.args, **kwargs: P.kwargs) -> R:
        try:
            return command(*args, **kwargs)
        except PepperError as fault:
            typer.echo(f"error: {' '.join(str(fault).split())}", err=True)
            raise typer.Exit(EXIT_BAD_INPUT) from None
        except KeyboardInterrupt:
            typer.echo("interrupted; a build keeps whole frames and goes on with the same command", err=True)
            raise typer.Exit(EXIT_INTERRUPTED) from None

    return run


def _show_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"pepperscene {__version__}")
        raise typer.Exit


@app.callback()
def _options(
    version: Annotated[
        bool, typer.Option("--version", callback=_show_version, is_eager=True, help="Print the version.")
    ] = False,
) -> None:
    pass


RecipeArgument = Annotated[
    str, typer.Argument(help="A recipe file, or the name of a shipped one (see `recipes`).")
]
OutputsOption = Annotated[
    str, typer.Option(metavar="NAMES", help=f"Of {', '.join(OUTPUTS)}; separated by commas.")
]
QualityOption = Annotated[
    str, typer.Option(metavar="NAME", help="draft, standard or reference: how much light is traced.")
]
TargetOption = Annotated[
    float | None,
    typer.Option(
        help="Light's error over the sensor's noise at which sampling stops; the quality's own otherwise."
    ),
]
SeedOption = Annotated[int | None, typer.Option(help="Instead of the recipe's.")]
SetOption = Annotated[
    list[str] | None,
    typer.Option(
        metavar="KEY=VALUE", help="Change one value of the recipe, as camera.flash=none; can be repeated."
    ),
]


@app.command()
@_explained
def build(
    out: Annotated[Path, typer.Option(help="Folder of the data set; made when missing.")],
    recipe: RecipeArgument = "demo",
    frames: Annotated[
        str | None,
        typer.Option(
            metavar="A:B", help="Indices A to B - 1, counted from 0; by default what the recipe selects."
        ),
    ] = None,
    outputs: OutputsOption = _DEFAULTS,
    quality: QualityOption = "standard",
    target_error: TargetOption = None,
    seed: SeedOption = None,
    set: SetOption = None,
) -> None:
    """Build a data set, or what is missing of it."""
    names = _names(outputs)
    from pepperscene.dataset import build as build_dataset
    from pepperscene.dataset import load_recipe, read_changes

    told = load_recipe(recipe, read_changes(set or ()))
    with _progress() as on_frame:
        done = build_dataset(
            told, out, frames, names, quality, seed, on_frame=on_frame, target_error=target_error
        )
    kept = f", {len(done.kept)} were there already" if done.kept else ""
    typer.echo(f"{len(done.made)} frame{'' if len(done.made) == 1 else 's'} built{kept}: {out}")


@app.command()
@_explained
def render(
    out: Annotated[Path, typer.Option(help="Folder of the frame; made when missing.")],
    recipe: RecipeArgument = "demo",
    frame: Annotated[
        int | None,
        typer.Option(metavar="N", help="Its index, counted from 0; by default the first that is selected."),
    ] = None,
    outputs: OutputsOption = _DEFAULTS,
    quality: QualityOption = "standard",
    target_error: TargetOption = None,
    seed: SeedOption = None,
    set: SetOption = None,
) -> None:
    """Render one frame of a recipe, to look at it or to try a setting."""
    names = _names(outputs)
    from pepperscene.dataset import load_recipe, read_changes, render_frame

    told = load_recipe(recipe, read_changes(set or ()))
    for path in render_frame(told, out, frame, names, quality, seed, target_error=target_error):
        typer.echo(path)


@app.command()
@_explained
def report(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Folder of a data set.")],
    limit: Annotated[int, typer.Option(min=1, max=200, help="Most frames shown.")] = 12,
) -> None:
    """Write a contact sheet and a web page into a data set's folder."""
    from pepperscene.dataset import report as write_report

    done = write_report(folder, limit)
    typer.echo(f"{done.shown} of {done.frames} frames shown:\n  {done.sheet}\n  {done.page}")


@app.command()
@_explained
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
    from pepperscene.dataset.specimen import write_specimen

    done = write_specimen(
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
@_explained
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
        raise InputError("--profile", "", None, "goes without --scaling; one at a time")
    if profile or scaling:
        measure = room.profile if profile else room.scaling
        done = measure(out, *asked, runs=runs, quick=quick, told=_told)
    else:
        done = room.bench(out, *asked, runs=runs, budget_s=budget, quick=quick, peers=peers, told=_told)
    typer.echo(done.markdown)
    for path in done.files:
        typer.echo(path, err=True)


@app.command()
@_explained
def cultivars() -> None:
    """List the shipped cultivars."""
    from pepperscene.cultivar import load_cultivar
    from pepperscene.shipped import shelf

    names = [path.stem for path in sorted(shelf("plants").glob("*.toml"))]
    for name in names:
        one = load_cultivar(name)
        dated = f", {one.date}" if one.date is not None else ""
        typer.echo(
            f"{name:<{max(map(len, names))}}  {one.name}, {one.species}: {one.stem.parts} nodes{dated}"
        )


@app.command()
@_explained
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


@app.command()
@_explained
def recipes() -> None:
    """List the shipped recipes."""
    from pepperscene.dataset import load_recipe
    from pepperscene.shipped import shelf

    for path in sorted(shelf("recipes").glob("*.toml")):
        plan = load_recipe(path.stem).plan
        chosen = len(plan.chosen(None))
        total = f"{plan.count:,} frames: {plan.sets} sets x {plan.rotations} rotations x {plan.frames} steps"
        typer.echo(f"{path.stem:<12} {total}{f'; builds {chosen} of them' if chosen < plan.count else ''}")


def _names(outputs: str) -> tuple[str, ...]:
    """Output names out of a list with commas."""
    return check_outputs(name.strip() for name in outputs.split(",") if name.strip())


@contextmanager
def _progress() -> Iterator[Callable[[Progress], None]]:
    """What to call after every frame: a bar on a terminal, a line each elsewhere."""
    if not sys.stderr.isatty():
        yield _plain_line
        return
    from rich import progress
    from rich.console import Console

    columns: tuple[Any, ...] = (
        progress.TextColumn("{task.description}"),
        progress.BarColumn(),
        progress.MofNCompleteColumn(),
        progress.TimeElapsedColumn(),
        progress.TimeRemainingColumn(),
    )
    with progress.Progress(*columns, console=Console(stderr=True)) as bar:
        task = bar.add_task("growing plants", total=None)

        def step(told: Progress) -> None:
            bar.update(task, completed=told.done, total=told.total, description=f"frame {told.index:06d}")

        yield step


def _told(text: str) -> None:
    """A line of progress, beside what is printed for keeps."""
    typer.echo(text, err=True)


def _plain_line(told: Progress) -> None:
    state = "built" if told.made else "kept"
    typer.echo(f"frame {told.index:06d} {state} ({told.done} of {told.total})", err=True)
