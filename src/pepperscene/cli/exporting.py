"""The command that writes a data set in another format."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Final

import typer

from pepperscene.cli.application import app, explained, told

_FEW: Final = 200  # chosen: frames that are told a line each
_EVERY_S: Final = 5.0  # chosen: of more frames, how often a line is told


@app.command()
@explained
def export(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Folder of a data set.")],
    form: Annotated[
        str,
        typer.Option("--format", metavar="NAME", help="published, coco, yolo, webdataset or huggingface."),
    ],
    out: Annotated[Path, typer.Option(help="A new or an empty folder.")],
    split: Annotated[
        str | None,
        typer.Option(
            metavar="TEXT",
            help="Shares, train=.8,val=.1,test=.1, or ranges, train=0:8750,val=8750:8800; if left out, all "
            "frames are for training.",
        ),
    ] = None,
    frames: Annotated[
        str | None,
        typer.Option(
            metavar="A:B", help="Indices A to B - 1, counted from 0; by default all that are there."
        ),
    ] = None,
    smallest: Annotated[
        int | None,
        typer.Option(
            metavar="N",
            help="Pixels that must be seen of an organ to be an object; coco 1, yolo 12 if left out.",
        ),
    ] = None,
) -> None:
    """Write a data set in the format that training code reads."""
    from pepperscene.dataset import export as export_dataset

    with _progress() as on_frame:
        done = export_dataset(folder, form, out, split, frames, on_frame, smallest)
    parts = ", ".join(f"{count} {name}" for name, count in done.splits.items())
    typer.echo(f"{done.frames} frame{'' if done.frames == 1 else 's'} as {form} ({parts}): {out}")


@contextmanager
def _progress() -> Iterator[Callable[[int, int, int], None]]:
    """What to call after every frame: a bar on a terminal, a line now and then elsewhere."""
    if not sys.stderr.isatty():
        yield _plain()
        return
    from rich.console import Console
    from rich.progress import Progress

    with Progress(console=Console(stderr=True)) as bar:
        task = bar.add_task("exporting", total=None)

        def step(index: int, done: int, total: int) -> None:
            bar.update(task, completed=done, total=total, description=f"frame {index:06d}")

        yield step


def _plain() -> Callable[[int, int, int], None]:
    last = float("-inf")

    def step(index: int, done: int, total: int) -> None:
        nonlocal last
        now = time.monotonic()
        if total <= _FEW or done == total or now - last >= _EVERY_S:
            last = now
            told(f"frame {index:06d} ({done} of {total})")

    return step
