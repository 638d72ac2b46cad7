"""Parameters of a fit: all that a recipe has, and those selected by name, with their prior distributions."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from difflib import get_close_matches
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.camera import Camera
from pepperscene.cultivar import Cultivar
from pepperscene.errors import ArgumentError
from pepperscene.recipe.recipe import Recipe
from pepperscene.render.gradients.renderer import FLASH_WEIGHTS
from pepperscene.render.gradients.tunable import RANGES
from pepperscene.tuning.bounds import Group, Parameter, prior_distributions
from pepperscene.tuning.pigment_paths import CONTENT_FIELDS, PATH_ENDS, state_distribution, visible_surfaces
from pepperscene.tuning.tuned import OFF_DIAGONAL, colour_steps

Array = NDArray[np.float64]
Limits = tuple[float, float]
_COLOURS: Final = ("red", "green", "blue")
_MATRIX_LABELS: Final = tuple(f"{_COLOURS[row]}_from_{_COLOURS[column]}" for row, column in OFF_DIAGONAL)
_GAINS: Final = ("red", "blue")
_FACTORS: Final = (0.01, 100.0)  # chosen: nearly seven stops to either side


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


def known_parameters(cultivar: Cultivar, camera: Camera) -> tuple[str, ...]:
    """Names of all parameters that can be fitted for a cultivar and a camera."""
    return tuple(all_parameters(cultivar, camera))


def select_parameters(
    recipe: Recipe,
    cultivar: Cultivar,
    camera: Camera,
    names: Sequence[str],
    bounds: Mapping[str, Any] | str | Path | None = None,
) -> tuple[Parameter, ...]:
    """Return the parameters of these names, in their order.

    Args:
        recipe: Recipe, for messages.
        cultivar: Cultivar of the recipe.
        camera: Camera of the recipe.
        names: Names as in `known_parameters`; `state` of fruit is an alias of its `ripeness`.
        bounds: A bounds file, or its tables, that override the shipped bounds.

    Raises:
        ArgumentError: There is no name; a name is unknown, repeated, or not available for this recipe; or two
            names change the same quantity.
        InputError: The bounds are not valid.
    """
    available = all_parameters(cultivar, camera)
    selected = [_canonical(name.strip(), available) for name in names]
    if not selected:
        raise ArgumentError("names", f"needs at least one of {_list_names(available)}")
    for i, name in enumerate(selected):
        if name not in available:
            raise ArgumentError("names", _unknown_message(name, available, recipe, cultivar, camera))
        if name in selected[:i]:
            raise ArgumentError("names", f"{name} is given twice")
    _check_overlap(selected)
    parameters = [available[name] for name in selected]
    priors = prior_distributions(parameters, available.values(), bounds)
    return tuple(replace(parameter, prior=prior) for parameter, prior in zip(parameters, priors, strict=True))


def _canonical(name: str, available: Mapping[str, Parameter]) -> str:
    """The name of the parameter: the state of fruit is called ripeness."""
    surface, _, key = name.rpartition(".")
    return f"{surface}.ripeness" if key == "state" and f"{surface}.ripeness" in available else name


def _check_overlap(names: Iterable[str]) -> None:
    """Refuse a content of the whole path together with that of one end: no data could separate them."""
    for name in names:
        surface, _, content = name.rpartition(".")
        scaled = f"{surface.rpartition('.')[0]}.{content}"
        if content in CONTENT_FIELDS and surface.rpartition(".")[2] in PATH_ENDS and scaled in names:
            raise ArgumentError(
                "names", f"{scaled} scales the whole path and cannot be fitted together with {name}"
            )


def _unknown_message(
    name: str, available: Mapping[str, Parameter], recipe: Recipe, cultivar: Cultivar, camera: Camera
) -> str:
    """Reason why a parameter does not exist, the closest names, and all names."""
    surface = name.partition(".")[0]
    if surface == "flash" and camera.flash is None:
        reason = f"{name} cannot be fitted, because {recipe.name} has no flash"
    elif name in ("white_balance", "colour_matrix"):
        reason = f"{name} cannot be fitted, because {camera.sensor.name} is monochrome"
    elif surface in cultivar.pigments and not any(
        parameter.startswith(f"{surface}.") for parameter in available
    ):
        reason = f"{name} cannot be fitted, because plants of {cultivar.name} show no {surface}"
    else:
        reason = f"there is no parameter {name!r}"
    close = get_close_matches(name, available, n=3, cutoff=0.5)
    hint = f"closest are {', '.join(close)}; " if close else ""
    return f"{reason}; {hint}parameters are {_list_names(available)}"


def _list_names(available: Mapping[str, Parameter]) -> str:
    """All names in short form: {leaf,stem}.{ior,roughness} are four."""
    surfaces: dict[str, list[str]] = {}
    others: list[str] = []
    for name, parameter in available.items():
        if parameter.group in ("pigments", "cuticle"):
            prefix, _, key = name.rpartition(".")
            surfaces.setdefault(key, []).append(prefix.partition(".")[0])
        else:
            others.append(name)
    keys_by_surfaces: dict[tuple[str, ...], list[str]] = {}
    for key, names in surfaces.items():
        keys_by_surfaces.setdefault(tuple(dict.fromkeys(names)), []).append(key)
    patterns = []
    for shared, keys in keys_by_surfaces.items():
        patterns.append(f"{_braces(shared)}.{_braces(keys)}")
        contents = [key for key in keys if key in CONTENT_FIELDS]
        patterns += [f"{_braces(shared)}.{_braces(PATH_ENDS)}.{_braces(contents)}"] * bool(contents)
    return ", ".join(patterns + others)


def _braces(names: Iterable[str]) -> str:
    words = list(names)
    return words[0] if len(words) == 1 else f"{{{','.join(words)}}}"
