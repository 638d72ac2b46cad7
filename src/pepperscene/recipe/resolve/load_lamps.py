"""Loading the lamps of a recipe: those that stand in the scene, and those that move with the main camera."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Final

from pepperscene.errors import InputError
from pepperscene.recipe.camera_tables import AUTO
from pepperscene.recipe.lamp_tables import MOST_LAMPS
from pepperscene.recipe.recipe import Recipe
from pepperscene.recipe.resolve.named_files import NamedFiles

if TYPE_CHECKING:
    from pepperscene.camera import Lamp

_MOST_FILES: Final = 8  # chosen: as many spectra as the renderer takes


def load_lamps(
    recipe: Recipe, fixed: str, where: str | Path = "", files: NamedFiles | None = None
) -> tuple[Lamp, ...]:
    """Load the lamps that are fixed in the "world" or to the "camera", in its axes.

    Other arguments and errors are as in `load_files`.
    """
    if not recipe.lamps:
        return ()
    from pepperscene.camera.lamps.lamp_files import load_lamp

    where, files = where or recipe.name, files or NamedFiles()
    if (count := sum(table.lamps for table in recipe.lamps)) > MOST_LAMPS:
        raise InputError(where, f"must be at most {MOST_LAMPS} lamps, not {count}", key="lamps")
    if len({table.lamp for table in recipe.lamps}) > _MOST_FILES:
        raise InputError(where, f"must name at most {_MOST_FILES} different files", key="lamps")
    placed: list[Lamp] = []
    for number, table in enumerate(recipe.lamps):
        key = f"lamps.{number}.lamp"
        lamp = files.load(load_lamp, where, key, table.lamp)
        if lamp.pulse_s is not None and recipe.camera.exposure_s == AUTO:
            problem = "is flashed, which needs an exposure in microseconds"
            raise InputError(where, problem, key=key, value=table.lamp)
        try:
            lamps = table.placed(lamp)
        except ValueError as error:
            raise InputError(where, str(error), key=f"lamps.{number}") from None
        placed += lamps if table.fixed == fixed else []
    return tuple(placed)
