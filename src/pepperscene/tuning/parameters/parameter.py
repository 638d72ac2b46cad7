"""Parameters of a fit: selection by name, with default values and prior distributions."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from difflib import get_close_matches
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pepperscene.errors import ArgumentError
from pepperscene.tuning.parameters.bounds import prior_distributions
from pepperscene.tuning.parameters.surface import CONTENT_FIELDS, PATH_ENDS
from pepperscene.tuning.parameters.tunables import Parameter, all_parameters

if TYPE_CHECKING:
    from pepperscene.camera import Camera
    from pepperscene.cultivar import Cultivar
    from pepperscene.recipe.recipe import Recipe


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
