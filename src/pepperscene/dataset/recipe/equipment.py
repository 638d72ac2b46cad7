"""What a recipe names in other files, loaded: cultivar, camera and cover; faults name the recipe's key."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Final, TypeVar

import numpy as np
from numpy.typing import NDArray

from pepperscene.dataset.recipe.recipe import Recipe
from pepperscene.dataset.recipe.tables import NONE, CameraTable, GrowthTable
from pepperscene.errors import InputError

if TYPE_CHECKING:
    from pepperscene.camera import Camera, Sensor
    from pepperscene.cultivar import Cultivar
    from pepperscene.scene import Cover


GRID_STEP_NM: Final = 5.0
"""Of the surfaces' spectra. Chosen: it resolves the red edge and the pigments' bands, 20 nm wide and more."""

LONGEST_NM: Final = 2500.0
"""Where the pigments' absorption coefficients end."""

Thing = TypeVar("Thing")


def load_recipe_cultivar(recipe: Recipe, where: str | Path = "") -> Cultivar:
    """The plants' cultivar, at the growth stage that the recipe says.

    Args:
        recipe: that names it.
        where: what to call the recipe in a message; its name if left out.

    Raises:
        InputError: it is not found or not valid, or nothing lies between it and the later stage.
    """
    from pepperscene.cultivar import interpolate_cultivars, load_cultivar

    where, growth = where or recipe.name, recipe.growth
    first = _loaded(load_cultivar, where, "cultivar", recipe.cultivar)
    if growth is None:
        return first
    last = _loaded(load_cultivar, where, "growth.until", growth.until)
    share = growth.share if growth.share is not None else _share(growth, first, last, where)
    try:
        return interpolate_cultivars(first, last, share)
    except (ValueError, InputError) as fault:
        raise InputError(where, str(fault), key="growth.until", value=growth.until) from None


def _share(growth: GrowthTable, first: Cultivar, last: Cultivar, where: str | Path) -> float:
    """How far the date lies between those of the two files."""
    assert growth.date is not None
    for key, one in (("cultivar", first), ("growth.until", last)):
        if one.date is None:
            allowed = f"growth.date needs a date in the file of {one.name} as well"
            raise InputError(where, allowed, key=key, value=one.name)
    assert first.date is not None
    assert last.date is not None
    days = (last.date - first.date).days
    if days <= 0 or not first.date <= growth.date <= last.date:
        allowed = f"must lie between the dates of the two files, {first.date} and {last.date}"
        raise InputError(where, allowed, key="growth.date", value=growth.date.isoformat())
    return (growth.date - first.date).days / days


def check_greenhouse(recipe: Recipe, where: str | Path = "") -> None:
    """Refuse a greenhouse that the row does not fit into.

    Raises:
        InputError: the gutters of the two rows, or those on either side of an aisle, overlap.
    """
    house, row = recipe.greenhouse, recipe.row
    if house is None or house.gutter_width_mm == 0:
        return
    limits = {"row.gap_mm": row.gap_mm} if row.plants_back else {}
    for key, limit in {**limits, "greenhouse.aisle_mm": house.aisle_mm}.items():
        if house.gutter_width_mm > limit:
            allowed = f"must be at most {key}, {limit:g}, so that no two gutters overlap"
            where = where or recipe.name
            raise InputError(where, allowed, key="greenhouse.gutter_width_mm", value=house.gutter_width_mm)


def load_recipe_cover(recipe: Recipe, where: str | Path = "") -> Cover | None:
    """What lies between the sky and the crop, or None.

    Raises:
        InputError: it is not found or not valid.
    """
    if recipe.daylight is None or recipe.daylight.cover == NONE:
        return None
    from pepperscene.scene import load_cover

    return _loaded(load_cover, where or recipe.name, "daylight.cover", recipe.daylight.cover)


def load_camera(recipe: Recipe, where: str | Path = "") -> Camera:
    """The camera, set as the recipe says, not yet at any place of the path.

    Raises:
        InputError: a part is not found or not valid, or the parts do not go together.
    """
    from pepperscene.camera import Camera, Developing, load_flash, load_lens

    where, table = where or recipe.name, recipe.camera
    sensor = _sensor(table, where)
    lens = _loaded(load_lens, where, "camera.lens", table.lens)
    flash = None if table.flash == NONE else _loaded(load_flash, where, "camera.flash", table.flash)

    # What only the parts together show.
    if table.focus_mm is not None and table.focus_mm <= 1e3 * lens.focal_length_m:
        allowed = f"must be beyond the focal length of {lens.name}, {1e3 * lens.focal_length_m:g} mm"
        raise InputError(where, allowed, key="camera.focus_mm", value=table.focus_mm)
    steps = recipe.developing.model_dump()
    if steps["white_balance"] == "flash" and flash is None and sensor.channels > 1:
        allowed = f'needs a developing.white_balance of "daylight", "{NONE}" or three gains, not "flash"'
        raise InputError(where, allowed, key="camera.flash", value=NONE)
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
    """Wavelengths of the surfaces' spectra, nm: those that the sensor sees and no more.

    Raises:
        ValueError: it sees nothing, or beyond `LONGEST_NM`.
    """
    efficiency = sensor.quantum_efficiency
    seen = np.flatnonzero((efficiency.values > 0).any(axis=0))
    if not seen.size:
        raise ValueError("sees no light at all")
    # The curves go down to zero at the entries beside.
    nm = efficiency.wavelength_nm[[max(seen[0] - 1, 0), min(seen[-1] + 1, efficiency.wavelength_nm.size - 1)]]
    first, last = GRID_STEP_NM * np.floor(nm[0] / GRID_STEP_NM), GRID_STEP_NM * np.ceil(nm[1] / GRID_STEP_NM)
    if last > LONGEST_NM:
        raise ValueError(
            f"sees up to {nm[1]:g} nm, but what plants do to light is known to {LONGEST_NM:g} nm"
        )
    return np.arange(first, last + GRID_STEP_NM / 2, GRID_STEP_NM)


def _sensor(table: CameraTable, where: str | Path) -> Sensor:
    """The sensor as it is set, behind the filter."""
    from pepperscene.camera import load_filter, load_sensor

    sensor = _loaded(load_sensor, where, "camera.sensor", table.sensor)
    sensor = sensor.with_settings(bits=table.bits, gain=table.gain)
    key, name = "camera.sensor", table.sensor
    try:
        surface_wavelengths(sensor)
        if table.filter != NONE:
            key, name = "camera.filter", table.filter
            sensor = sensor.with_filter(_loaded(load_filter, where, key, name).transmittance)
            surface_wavelengths(sensor)
    except ValueError as fault:
        behind = " behind it" if key == "camera.filter" else ""
        raise InputError(where, f"{sensor.name}{behind} {fault}", key=key, value=name) from None
    return sensor


def _loaded(load: Callable[[str], Thing], where: str | Path, key: str, name: str) -> Thing:
    """A file's content; where there is no such file, the fault is the recipe's."""
    try:
        return load(name)
    except InputError as fault:
        if fault.key or fault.where != name:
            raise
        raise InputError(where, fault.problem, key=key, value=name) from None
