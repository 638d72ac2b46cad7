"""The surfaces of scenes, made beside the row by another process where there are two cores."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from contextlib import suppress
from typing import TYPE_CHECKING

import numpy as np

from pepperscene.building.scenes.scene_worker import SceneWorker
from pepperscene.recipe.resolve.load_camera import GRID_STEP_NM

if TYPE_CHECKING:
    from pepperscene.cultivar import Cultivar
    from pepperscene.materials import Surface


SurfacePreparation = Callable[[Iterable["Surface"]], None]


def prepare_for_mitsuba(surfaces: Iterable[Surface]) -> None:
    """Compute what the Mitsuba renderer needs of surfaces; scenes that share them need it once."""
    from pepperscene.render import prepare_surfaces

    prepare_surfaces(surfaces)


class SurfaceFactory:
    """Makes the surfaces of cultivars; those of the last one are kept, because scenes share it."""

    def __init__(self) -> None:
        self._kept: tuple[tuple[Cultivar, float, float], dict[str, Surface]] | None = None

    def surfaces(
        self, cultivar: Cultivar, first_nm: float, last_nm: float, worker: SceneWorker | None = None
    ) -> dict[str, Surface]:
        """The surfaces of a cultivar and of the greenhouse by name.

        Args:
            cultivar: its organs.
            first_nm: first wavelength, nanometres.
            last_nm: last wavelength, nanometres.
            worker: another process that makes them, so that threads of this one can work meanwhile.
        """
        key = cultivar, first_nm, last_nm
        if self._kept is None or self._kept[0] != key:
            # Release the old surfaces before making new ones.
            self._kept = None
            made = None
            if worker is not None:
                # If it cannot be started or fails, they are made here.
                with suppress(OSError, EOFError):
                    made = worker.call(make_surfaces, *key)
            self._kept = key, make_surfaces(*key) if made is None else made
        return self._kept[1]


def make_surfaces(cultivar: Cultivar, first_nm: float, last_nm: float) -> dict[str, Surface]:
    """The surfaces of a cultivar and of the greenhouse by name, in this process."""
    from pepperscene.materials import greenhouse_surfaces, organ_surfaces

    nm = np.arange(first_nm, last_nm + GRID_STEP_NM / 2, GRID_STEP_NM)
    return {**organ_surfaces(cultivar, nm), **greenhouse_surfaces(nm)}
