"""The command `calibrate`."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from pepperscene.calibration.options import CalibrationOptions
from pepperscene.cli.application import command
from pepperscene.errors import ArgumentError


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
    given = replace(options, corners=_numbers(corners, "corners"), grey_card=_numbers(grey_card, "grey_card"))
    from pepperscene.calibration.run import calibrate as calibrate_camera
    from pepperscene.calibration.write import calibration_values

    calibration = calibrate_camera(photographs, out, given)
    for name, value in calibration_values(calibration):
        typer.echo(f"{name}: {value}")
    for path in calibration.files:
        typer.echo(path)


def _numbers(text: str | None, option: str) -> tuple[float, ...] | None:
    if text is None:
        return None
    try:
        return tuple(float(part) for part in text.split(","))
    except ValueError:
        raise ArgumentError(option, f"must be numbers separated by commas, not {text!r}") from None
