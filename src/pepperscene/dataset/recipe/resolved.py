"""A recipe with the files that it names, loaded; errors name the recipe's key."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, TypeVar

import numpy as np
from numpy.typing import NDArray

from pepperscene.dataset.recipe.recipe import Recipe
from pepperscene.dataset.recipe.tables import NONE, CameraTable, GrowthTable
from pepperscene.errors import InputError

if TYPE_CHECKING:
    from pepperscene.camera import Camera, Sensor
    from pepperscene.cultivar import Cultivar
    from pepperscene.scene import Cover


# Of the surfaces' spectra. The step is chosen: it resolves the red edge and the pigments' bands, 20 nm wide
# and more. The pigments' absorption coefficients end at 2500 nm.
GRID_STEP_NM: Final = 5.0
MAX_WAVELENGTH_NM: Final = 2500.0
_LEAST_EFFICIENCY: Final = 1e-9
"""Electrons per photon, of the most sensitive colour. Chosen: less than any dark current leaves visible, and
far from where single precision ends."""

Content = TypeVar("Content")


@dataclass(frozen=True, eq=False)
class ResolvedRecipe:
    """A recipe and all files that it names, loaded once.

    Attributes:
        recipe: the validated recipe.
        cultivar: at the recipe's growth stage.
        camera: with the recipe's settings, without a pose.
        cover: between the sky and the crop, or None.
    """

    recipe: Recipe
    cultivar: Cultivar
    camera: Camera
    cover: Cover | None

    @cached_property
    def identity(self) -> Mapping[str, Any]:
        """`Recipe.identity` of the recipe, computed once."""
        return self.recipe.identity()

    def with_seed(self, seed: int | None) -> ResolvedRecipe:
        """The same with another seed, or itself if that is None; see `Recipe.with_seed`."""
        return self if seed is None else replace(self, recipe=self.recipe.with_seed(seed))


def load_files(recipe: Recipe, where: str | Path = "") -> ResolvedRecipe:
    """Load all files that a recipe names.

    Args:
        recipe: the validated recipe.
        where: name of the recipe in error messages; by default its own.

    Raises:
        InputError: a file is missing or not valid, or the parts do not fit together.
    """
    where = where or recipe.name
    cultivar, cover, daylight = load_recipe_cultivar(recipe, where), None, recipe.daylight
    if daylight is not None and daylight.cover != NONE:
        from pepperscene.scene import load_cover

        cover = _load_file(load_cover, where, "daylight.cover", daylight.cover)
    camera = load_camera(recipe, where)
    _check_gutters(recipe, where)
    return ResolvedRecipe(recipe, cultivar, camera, cover)


def load_recipe_cultivar(recipe: Recipe, where: str | Path = "") -> Cultivar:
    """Load a recipe's cultivar at its growth stage; arguments and errors as of `load_files`."""
    from pepperscene.cultivar import interpolate_cultivars, load_cultivar

    where, growth = where or recipe.name, recipe.growth
    first = _load_file(load_cultivar, where, "cultivar", recipe.cultivar)
    if growth is None:
        return first
    last = _load_file(load_cultivar, where, "growth.until", growth.until)
    fraction = growth.share if growth.share is not None else _fraction_of_time(growth, first, last, where)
    try:
        return interpolate_cultivars(first, last, fraction)
    except (ValueError, InputError) as error:
        raise InputError(where, str(error), key="growth.until", value=growth.until) from None


def _fraction_of_time(growth: GrowthTable, first: Cultivar, last: Cultivar, where: str | Path) -> float:
    """Position of the growth date between the dates of the two cultivars, in [0, 1]."""
    for key, cultivar in (("cultivar", first), ("growth.until", last)):
        if cultivar.date is None:
            problem = f"growth.date needs a date in the file of {cultivar.name} as well"
            raise InputError(where, problem, key=key, value=cultivar.name)
    assert growth.date is not None
    assert first.date is not None
    assert last.date is not None
    days = (last.date - first.date).days
    if days <= 0 or not first.date <= growth.date <= last.date:
        problem = f"must be between the dates of the two files, {first.date} and {last.date}"
        raise InputError(where, problem, key="growth.date", value=growth.date.isoformat())
    return (growth.date - first.date).days / days


def _check_gutters(recipe: Recipe, where: str | Path) -> None:
    """Raise `InputError` if gutters overlap, of the two rows or on both sides of an aisle."""
    greenhouse, row = recipe.greenhouse, recipe.row
    if greenhouse is None or greenhouse.gutter_width_mm == 0:
        return
    limits = {"row.gap_mm": row.gap_mm} if row.plants_back else {}
    for key, limit in {**limits, "greenhouse.aisle_mm": greenhouse.aisle_mm}.items():
        if greenhouse.gutter_width_mm > limit:
            problem = f"must be at most {key}, {limit:g}, so that no two gutters overlap"
            raise InputError(
                where, problem, key="greenhouse.gutter_width_mm", value=greenhouse.gutter_width_mm
            )


def load_camera(recipe: Recipe, where: str | Path = "") -> Camera:
    """Load the camera with the recipe's settings, without a pose; arguments and errors as of `load_files`."""
    from pepperscene.camera import Camera, Developing, load_flash, load_lens

    where, table = where or recipe.name, recipe.camera
    sensor = _load_sensor(table, where)
    lens = _load_file(load_lens, where, "camera.lens", table.lens)
    flash = None if table.flash == NONE else _load_file(load_flash, where, "camera.flash", table.flash)

    # Checks that need several parts.
    if table.focus_mm is not None and table.focus_mm <= 1e3 * lens.focal_length_m:
        problem = f"must be beyond the focal length of {lens.name}, {1e3 * lens.focal_length_m:g} mm"
        raise InputError(where, problem, key="camera.focus_mm", value=table.focus_mm)
    steps = recipe.developing.model_dump()
    if steps["white_balance"] == "flash" and flash is None and sensor.channels > 1:
        problem = f'needs a developing.white_balance of "daylight", "{NONE}" or three gains, not "flash"'
        raise InputError(where, problem, key="camera.flash", value=NONE)
    if steps["white_balance"] == NONE:
        steps["white_balance"] = None
    return Camera(
        lens=lens,
        sensor=sensor,
        exposure_s=table.exposure_us / 1e6,
        flash=flash,
        developing=Developing(**steps),
        focus_m=None if table.focus_mm is None else table.focus_mm / 1e3,
    )


def surface_wavelengths(sensor: Sensor) -> NDArray[np.float64]:
    """Wavelengths of the surfaces' spectra, nm: the range in which the sensor is sensitive.

    Raises:
        ValueError: the sensor is sensitive nowhere, only between whole nanometres, or beyond
            `MAX_WAVELENGTH_NM`.
    """
    efficiency = sensor.quantum_efficiency
    sensitive = np.flatnonzero((efficiency.values > 0).any(axis=0))
    if not efficiency.values.max() >= _LEAST_EFFICIENCY:
        raise ValueError("is not sensitive at any wavelength")
    # Light is traced at whole nanometres, so a narrower line would be missed.
    whole_nm = np.arange(np.ceil(efficiency.wavelength_nm[0]), efficiency.wavelength_nm[-1] + 0.5)
    if not efficiency.at(whole_nm).max(initial=0.0) >= _LEAST_EFFICIENCY:
        raise ValueError("is not sensitive at any whole number of nanometres")
    # The curves fall to zero at the neighbouring entries.
    limits = [max(sensitive[0] - 1, 0), min(sensitive[-1] + 1, efficiency.wavelength_nm.size - 1)]
    nm = efficiency.wavelength_nm[limits]
    first, last = GRID_STEP_NM * np.floor(nm[0] / GRID_STEP_NM), GRID_STEP_NM * np.ceil(nm[1] / GRID_STEP_NM)
    if last > MAX_WAVELENGTH_NM:
        raise ValueError(
            f"is sensitive up to {nm[1]:g} nm, but plant optics are known up to {MAX_WAVELENGTH_NM:g} nm only"
        )
    return np.arange(first, last + GRID_STEP_NM / 2, GRID_STEP_NM)


def _load_sensor(table: CameraTable, where: str | Path) -> Sensor:
    """Load the sensor with its settings, behind its filter."""
    from pepperscene.camera import load_filter, load_sensor

    sensor = _load_file(load_sensor, where, "camera.sensor", table.sensor)
    sensor = sensor.with_settings(bits=table.bits, gain=table.gain)
    key, name = "camera.sensor", table.sensor
    try:
        surface_wavelengths(sensor)
        if table.filter != NONE:
            key, name = "camera.filter", table.filter
            sensor = sensor.with_filter(_load_file(load_filter, where, key, name).transmittance)
            surface_wavelengths(sensor)
    except ValueError as error:
        behind = " behind it" if key == "camera.filter" else ""
        raise InputError(where, f"{sensor.name}{behind} {error}", key=key, value=name) from None
    return sensor


def _load_file(load: Callable[[str], Content], where: str | Path, key: str, name: str) -> Content:
    """Load a file; if there is no such file, the error names the recipe's key."""
    try:
        return load(name)
    except InputError as error:
        if error.key or error.where != name:
            raise
        raise InputError(where, error.problem, key=key, value=name) from None
