"""The parameters of a fit: what can be fitted of a recipe, what it is there, and how far it may go."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from pepperscene.cultivar import Distribution
from pepperscene.errors import ArgumentError
from pepperscene.tuning.parameters.bounds import priors
from pepperscene.tuning.parameters.camera import camera_side
from pepperscene.tuning.parameters.surface import ENDS, NAMES, surface_side
from pepperscene.tuning.parameters.tunables import Group, Tunables

if TYPE_CHECKING:
    from pepperscene.camera import Camera
    from pepperscene.cultivar import Cultivar
    from pepperscene.dataset import Recipe


@dataclass(frozen=True, eq=False)
class Parameter:
    """One parameter of a fit, of one or more entries.

    Attributes:
        name: "leaf.chlorophyll", "flash.colour".
        unit: of its numbers; "" for plain ones.
        meaning: in a few words.
        labels: `(k,)` of its entries, `("",)` for a single one.
        default: `(k,)` what the recipe has.
        prior: `(k,)` what is known of it beforehand: mean, sd, and bounds that hold the default.
        group: "pigments", "cuticle", "light", "exposure" or "camera".
    """

    name: str
    unit: str
    meaning: str
    labels: tuple[str, ...]
    default: NDArray[np.float64]
    prior: tuple[Distribution, ...]
    group: Group


def known_parameters(cultivar: Cultivar, camera: Camera) -> tuple[str, ...]:
    """Every name that can be fitted of plants of this cultivar before this camera."""
    return tuple(_everything(cultivar, camera))


def select_parameters(
    recipe: Recipe,
    cultivar: Cultivar,
    camera: Camera,
    names: Sequence[str],
    bounds: Mapping[str, Any] | str | Path | None = None,
) -> tuple[Parameter, ...]:
    """The parameters of these names, in their order.

    Args:
        recipe: for messages.
        cultivar: the recipe's.
        camera: the recipe's.
        names: such as `known_parameters` gives; `state` of fruit is another word for its `ripeness`.
        bounds: a bounds file, or its tables, that go before the shipped ones.

    Raises:
        ArgumentError: no name at all, an unknown name or one twice, one that this recipe cannot have, two
            that move the same thing, or a fault in the bounds.
    """
    every = _everything(cultivar, camera)
    wanted = [_canonical(name.strip(), every) for name in names]
    if not wanted:
        raise ArgumentError("names", f"needs at least one of {_listed(every)}")
    for i, name in enumerate(wanted):
        if name not in every:
            raise ArgumentError("names", _unknown(name, every, recipe, cultivar, camera))
        if name in wanted[:i]:
            raise ArgumentError("names", f"{name} is named twice")
    _check_overlap(wanted)
    laws = priors([every[name] for name in wanted], every.values(), bounds)
    return tuple(
        Parameter(one.name, one.unit, one.meaning, one.labels, one.value.copy(), law, one.group)
        for one, law in zip((every[name] for name in wanted), laws, strict=True)
    )


def _everything(cultivar: Cultivar, camera: Camera) -> dict[str, Tunables]:
    return surface_side(cultivar) | camera_side(camera)


def _canonical(name: str, every: Mapping[str, Tunables]) -> str:
    """The name that the parameter is known by: a fruit's state is called its ripeness."""
    surface, _, what = name.rpartition(".")
    return f"{surface}.ripeness" if what == "state" and f"{surface}.ripeness" in every else name


def _check_overlap(names: Iterable[str]) -> None:
    """Refuse to move a content as a whole and at one end: no data could tell the two apart."""
    for name in names:
        surface, _, what = name.rpartition(".")
        whole = f"{surface.rpartition('.')[0]}.{what}"
        if what in NAMES and surface.rpartition(".")[2] in ENDS and whole in names:
            allowed = f"{whole} moves the whole path, so it cannot be fitted beside {name}"
            raise ArgumentError("names", allowed)


def _unknown(
    name: str, every: Mapping[str, Tunables], recipe: Recipe, cultivar: Cultivar, camera: Camera
) -> str:
    """Why there is no such parameter, and what there is, the closest first."""
    surface = name.partition(".")[0]
    if surface == "flash" and camera.flash is None:
        why = f"{name} cannot be fitted, since {recipe.name} has no flash"
    elif name in ("white_balance", "colour_matrix"):
        why = f"{name} cannot be fitted, since {camera.sensor.name} sees no colours"
    elif surface in cultivar.pigments and not any(one.startswith(f"{surface}.") for one in every):
        why = f"{name} cannot be fitted, since plants of {cultivar.name} show no {surface}"
    else:
        why = f"there is no parameter {name!r}"
    close = get_close_matches(name, every, n=3, cutoff=0.5)
    closest = f"closest are {', '.join(close)}; " if close else ""
    return f"{why}; {closest}there are {_listed(every)}"


def _listed(every: Mapping[str, Tunables]) -> str:
    """All names in few words: {leaf,stem}.{ior,roughness} are four."""
    surfaces: dict[str, list[str]] = {}
    for own in every.values():
        if own.group in ("pigments", "cuticle"):
            surface, _, what = own.name.rpartition(".")
            surfaces.setdefault(what, []).append(surface.partition(".")[0])
    alike: dict[tuple[str, ...], list[str]] = {}
    for what, names in surfaces.items():
        alike.setdefault(tuple(dict.fromkeys(names)), []).append(what)
    found = []
    for shared, whats in alike.items():
        found.append(f"{_braced(shared)}.{_braced(whats)}")
        contents = [what for what in whats if what in NAMES]
        found += [f"{_braced(shared)}.{_braced(ENDS)}.{_braced(contents)}"] * bool(contents)
    return ", ".join(found + [own.name for own in every.values() if own.group not in ("pigments", "cuticle")])


def _braced(names: Iterable[str]) -> str:
    words = list(names)
    return words[0] if len(words) == 1 else f"{{{','.join(words)}}}"
