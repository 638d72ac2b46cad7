"""Commands about cultivars and single plants."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from pepperscene.cli.application import QualityOption, app, explained


@app.command()
@explained
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
@explained
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
