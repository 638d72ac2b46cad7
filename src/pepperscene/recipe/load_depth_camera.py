"""Loading the depth camera of a recipe: its imagers as the camera of a recipe, and its projector."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Final

from pepperscene.errors import InputError
from pepperscene.recipe.camera_tables import DevelopingTable
from pepperscene.recipe.exposure import AUTO
from pepperscene.recipe.load_camera import NamedFiles, load_camera
from pepperscene.recipe.recipe import Recipe
from pepperscene.recipe.tables import NONE

if TYPE_CHECKING:
    from pepperscene.camera import DepthCamera, Projector, Sensor

_DEVELOPING: Final = DevelopingTable(white_balance="daylight")
"""Depth cameras have no flash; everything else as by default."""

_LEAST_DETECTED: Final = 1e-3
"""Chosen: of the highest quantum efficiency; less is the leak of a filter that blocks the projector."""


def load_depth_camera(
    recipe: Recipe, where: str | Path = "", files: NamedFiles | None = None
) -> DepthCamera | None:
    """Load the depth camera with the recipe's settings, without a pose; None if the recipe has none.

    Arguments and errors are as of `load_files`.
    """
    table = recipe.depth_camera
    if table is None:
        return None
    from pepperscene.camera import DepthCamera, StereoMatching, load_projector

    where, files = where or recipe.name, files or NamedFiles()
    # The imagers are described as any camera is.
    imager = recipe.model_copy(update={"camera": table, "developing": _DEVELOPING})
    try:
        left = load_camera(imager, where, files)
    except InputError as error:
        key = f"depth_{error.key}" if error.key.startswith("camera.") else error.key
        raise InputError(error.where, error.problem, key=key, value=error.value) from None
    if left.sensor.line_scan or left.sensor.pattern == "bands":
        problem = "must take photographs: it is a line scanner or has bands"
        raise InputError(where, problem, key="depth_camera.sensor", value=table.sensor)
    if not left.lens.distortion.is_zero:
        problem = "must be without distortion, as the images of depth cameras are after rectification"
        raise InputError(where, problem, key=f"depth_camera.{table.lens_key}")
    projector = None
    if table.projector != NONE:
        key = "depth_camera.projector"
        projector = files.load(load_projector, where, key, table.projector)
        _check_detected(projector, left.sensor, where, key, table.projector)
    settings = table.matching.model_dump()
    settings["farthest_m"] = settings.pop("farthest_mm") / 1e3
    return DepthCamera(
        left=left,
        baseline_m=table.baseline_mm / 1e3,
        projector=projector,
        matching=StereoMatching(**settings),
        exposure_control=table.auto_exposure.control() if table.exposure_us == AUTO else None,
    )


def _check_detected(projector: Projector, sensor: Sensor, where: str | Path, key: str, name: str) -> None:
    """Raise `InputError` if an imager does not detect the projector."""
    efficiency = sensor.quantum_efficiency
    if not efficiency.at([projector.wavelength_nm]).max() >= _LEAST_DETECTED * efficiency.values.max():
        problem = f"emits {projector.wavelength_nm:g} nm, which the imagers do not detect"
        raise InputError(where, problem, key=key, value=name)
