"""Parameters of a recipe that can be fitted, at the recipe's values."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, Literal

import numpy as np
from numpy.typing import NDArray

from pepperscene.render.gradients.pigment_models import RANGES
from pepperscene.render.gradients.renderer import FLASH_WEIGHTS
from pepperscene.tuning.parameters.surface import (
    CONTENT_FIELDS,
    PATH_ENDS,
    state_distribution,
    visible_surfaces,
)
from pepperscene.tuning.parameters.tuned import OFF_DIAGONAL, colour_steps

if TYPE_CHECKING:
    from pepperscene.camera import Camera
    from pepperscene.cultivar import Cultivar, Distribution

Array = NDArray[np.float64]
Limits = tuple[float, float]
Group = Literal["pigments", "cuticle", "light", "exposure", "camera"]

_COLOURS: Final = ("red", "green", "blue")
_MATRIX_LABELS: Final = tuple(f"{_COLOURS[row]}_from_{_COLOURS[column]}" for row, column in OFF_DIAGONAL)
_GAINS: Final = ("red", "blue")
_FACTORS: Final = (0.01, 100.0)  # chosen: nearly seven stops to either side


@dataclass(frozen=True, eq=False)
class Parameter:
    """One parameter of a fit, with one or more entries.

    Attributes:
        name: Such as "leaf.chlorophyll" or "flash.colour".
        unit: Unit of its values; "" if dimensionless.
        meaning: Short description.
        group: Group that it belongs to.
        default: `(k,)` values of the recipe.
        low, high: Limits set by physics and by the file formats.
        floor: Value that means "none": 1 for PROSPECT's N and for a refractive index, else 0.
        labels: `(k,)` names of its entries; `("",)` for a single one.
        prior: `(k,)` prior distributions with mean, sd and bounds; empty until it is selected for a fit.
    """

    name: str
    unit: str
    meaning: str
    group: Group
    default: Array
    low: float = 0.0
    high: float = np.inf
    floor: float = 0.0
    labels: tuple[str, ...] = ("",)
    prior: tuple[Distribution, ...] = ()

    @property
    def entry_labels(self) -> tuple[str, ...]:
        """`(k,)` the name of each entry, with its label if it has one: "flash.colour (warmth)"."""
        return tuple(f"{self.name} ({label})" if label else self.name for label in self.labels)


def all_parameters(cultivar: Cultivar, camera: Camera) -> dict[str, Parameter]:
    """Everything that can be fitted for a cultivar and a camera, by name: surfaces first, in file order."""
    parameters = [
        parameter for name in visible_surfaces(cultivar) for parameter in _surface_parameters(cultivar, name)
    ]
    return {parameter.name: parameter for parameter in (*parameters, *_camera_parameters(camera))}


def _surface_parameters(cultivar: Cultivar, surface: str) -> list[Parameter]:
    path, states = cultivar.pigments[surface], state_distribution(cultivar, surface)
    parameters: list[Parameter] = []

    def add(
        key: str, meaning: str, value: float, low: float, high: float, floor: float = 0.0, unit: str = ""
    ) -> None:
        group: Group = "cuticle" if key in ("ior", "roughness") else "pigments"
        values = np.array([value], float)
        parameters.append(Parameter(f"{surface}.{key}", unit, meaning, group, values, low, high, floor))

    for name, (field, unit) in CONTENT_FIELDS.items():
        (low, high) = RANGES[field]
        contents = [getattr(pigments, field) for state, pigments in path.knots if state >= 0.0]
        add(name, f"{name}, maximum along the path", max(contents), low, high, low, unit)
        for end, knot in PATH_ENDS.items():
            add(f"{end}.{name}", f"{name} at the {end} end of the path", contents[knot], low, high, low, unit)
    if states is not None and states.mean_ripeness is not None:
        add("ripeness", "mean ripeness of ripe fruit", states.mean_ripeness, 0.0, 1.0)
    elif states is not None:
        add("state", "mean state of the organs", states.mean, 0.0, 1.0)
    if states is not None and states.sd > 0.0:
        add("spread", "standard deviation of the organs' states", states.sd, 0.0, 1.0)
    if path.flesh_reflectance is not None:
        add("flesh", "reflectance of the flesh", path.flesh_reflectance, *RANGES["flesh_reflectance"])
    add("ior", "refractive index of the cuticle", path.ior, *RANGES["ior"], floor=1.0)
    # The back is scaled by the same factor and has to stay within its range as well.
    (front, back), (low, high) = path.roughness, RANGES["roughness"]
    low, high = low * max(1.0, front / back), high * min(1.0, front / back)
    add("roughness", "GGX alpha of the cuticle's front", front, low, high)
    return parameters


def _camera_parameters(camera: Camera) -> list[Parameter]:
    """Light and camera; without a flash none of the flash, for a monochrome sensor none of colour."""
    parameters: list[Parameter] = []

    def add(
        name: str, meaning: str, group: Group, values: Array, limits: Limits, labels: tuple[str, ...] = ("",)
    ) -> None:
        parameters.append(Parameter(name, "", meaning, group, values, *limits, labels=labels))

    if camera.flash is not None:
        nodes, colour = tuple(str(i + 1) for i in range(FLASH_WEIGHTS)), ("warmth", "green")
        meaning = "factors on the flash spectrum at evenly spaced wavelengths"
        add("flash.power", "factor on the power of the flash", "light", np.ones(1), _FACTORS)
        add("flash.colour", "exponents of the flash spectrum", "light", np.zeros(2), (-5.0, 5.0), colour)
        add("flash.spectrum", meaning, "light", np.ones(FLASH_WEIGHTS), _FACTORS, nodes)
    meaning = "factor on the sensor gain; without a flash, on the exposure time"
    add("exposure", meaning, "exposure", np.ones(1), _FACTORS)
    if camera.sensor.channels > 1:
        _, matrix = colour_steps(camera)
        entries = np.array([matrix[at] for at in OFF_DIAGONAL])
        meaning = "off-diagonal entries; row sums are kept"
        add("white_balance", "factors on the gains of red and blue", "camera", np.ones(2), _FACTORS, _GAINS)
        add("colour_matrix", meaning, "camera", entries, (-20.0, 20.0), _MATRIX_LABELS)
    return parameters
