"""The parameters of surfaces: what a cultivar has of them, and what values make of a path."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pepperscene.cultivar import PigmentPath, Pigments
from pepperscene.render.bodies import CONTENTS, RANGES
from pepperscene.tuning.laws import StateLaw, state_law, surfaces_of
from pepperscene.tuning.own import Group, Own
from pepperscene.tuning.shifted import shifted

if TYPE_CHECKING:
    from pepperscene.cultivar import Cultivar

Array = NDArray[np.float64]
Values = Mapping[str, ArrayLike]

NAMES: Final[Mapping[str, tuple[str, str]]] = {
    "chlorophyll": ("chlorophyll_ug_cm2", "µg/cm²"),
    "carotenoid": ("carotenoid_ug_cm2", "µg/cm²"),
    "capsanthin": ("capsanthin_ug_cm2", "µg/cm²"),
    "anthocyanin": ("anthocyanin_ug_cm2", "µg/cm²"),
    "brown": ("brown", ""),
    "structure": ("structure_n", ""),
}
"""Each content as a fit calls it: its field of `Pigments`, and its unit."""

ENDS: Final = {"unripe": 0, "ripe": -1}
"""The knots at either end of a path. The words are fruit's, and so are those of leaves, pale and dark."""


def surface_side(cultivar: Cultivar) -> dict[str, Own]:
    """What can be fitted of the surfaces that plants show, in the order of the cultivar's file."""
    found = [one for surface in surfaces_of(cultivar) for one in _of_surface(cultivar, surface)]
    return {one.name: one for one in found}


def _of_surface(cultivar: Cultivar, surface: str) -> list[Own]:
    path, law, found = cultivar.pigments[surface], state_law(cultivar, surface), []

    def add(what: str, meaning: str, value: float, low: float, high: float, floor: float = 0.0) -> None:
        unit = NAMES[what.rpartition(".")[2]][1] if what.rpartition(".")[2] in NAMES else ""
        group: Group = "cuticle" if what in ("ior", "roughness") else "pigments"
        value_of = np.array([value], float)
        found.append(Own(f"{surface}.{what}", unit, meaning, group, value_of, low, high, floor))

    for name, (field, _) in NAMES.items():
        (low, high), values = RANGES[field], [getattr(pigments, field) for _, pigments in path.knots]
        add(name, f"{name}, largest along the path", max(values), low, high, low)
        for end, at in ENDS.items():
            add(f"{end}.{name}", f"{name} at the {end} end of the path", values[at], low, high, low)
    if law is not None and law.ripe is not None:
        add("ripeness", "mean ripeness of ripe fruit", law.ripe, 0.0, 1.0)
    elif law is not None:
        add("state", "mean state of the organs", law.mean, 0.0, 1.0)
    if law is not None and law.sd > 0.0:
        add("spread", "standard deviation of the organs' states", law.sd, 0.0, 1.0)
    if path.flesh_reflectance is not None:
        add("flesh", "reflectance of the flesh", path.flesh_reflectance, *RANGES["flesh_reflectance"])
    add("ior", "refractive index of the cuticle", path.ior, *RANGES["ior"], floor=1.0)
    # The back scales alike and has to stay within its range as well.
    (front, back), (least, most) = path.roughness, RANGES["roughness"]
    least, most = least * max(1.0, front / back), most * min(1.0, front / back)
    add("roughness", "GGX alpha of the cuticle's front", front, least, most)
    return found


def path_at(surface: str, path: PigmentPath, law: StateLaw | None, values: Values) -> PigmentPath:
    """The path of a surface at some values, with its own knots.

    Contents change first, along the path as it stands, and then organs move along the changed path. Scaling
    and moving commute; for `unripe` and `ripe` the order makes the value that of the path's own end, and
    keeps contents at 0 or above whatever the values.
    """
    given = {
        name.removeprefix(f"{surface}."): np.asarray(value, dtype=float).ravel()
        for name, value in values.items()
        if name.startswith(f"{surface}.")
    }
    states = np.array([state for state, _ in path.knots])
    table = {what: np.array([getattr(p, what) for _, p in path.knots]) for what in CONTENTS}
    rising = law is not None and law.ripe is not None
    for name, (field, _) in NAMES.items():
        table[field] = _content(name, given, states, table[field], RANGES[field][0], rising)

    moved = _moved(given, states, law)
    if moved is not None:
        floors = np.array([RANGES[field][0] for field in CONTENTS])
        above = np.stack([table[field] for field in CONTENTS], axis=1) - floors
        table = dict(zip(CONTENTS, (floors + shifted(states, above, moved)).T, strict=True))

    table = {what: np.clip(content, *RANGES[what]) for what, content in table.items()}
    knots = [Pigments(**{what: float(table[what][i]) for what in CONTENTS}) for i in range(len(states))]
    between = tuple(zip(states[1:-1].tolist(), knots[1:-1], strict=True))
    changes: dict[str, Any] = {"start": knots[0], "end": knots[-1], "path": between}
    fields = {name: getattr(path, name) for name in PigmentPath.model_fields}
    return PigmentPath(**fields | changes | _cuticle(given, path))


def _content(
    name: str, given: Mapping[str, Array], states: Array, content: Array, floor: float, rising: bool
) -> Array:
    """`(k,)` of one content at the knots."""
    own = content - floor
    if name in given:
        wanted, most = float(given[name][0]) - floor, float(own.max())
        # What is nowhere is added evenly; the red of fruit comes as it ripens.
        shape = own / most if most > 0.0 else states if rising and name == "capsanthin" else np.ones_like(own)
        return floor + np.maximum(wanted * shape, 0.0)
    changed = own
    for end, at in ENDS.items():
        if f"{end}.{name}" in given:
            change = float(given[f"{end}.{name}"][0]) - floor - own[at]
            changed = changed + change * _fading(states, own, at)
    return content if changed is own else floor + np.maximum(changed, 0.0)


def _fading(states: Array, own: Array, at: int) -> Array:
    """`(k,)` shares of a change at one end: linear to none at the other, less where there is less to change.

    So both ends can be taken down to nothing, and nowhere is less than nothing left.
    """
    line = states if at else 1.0 - states
    return line * np.minimum(1.0, own / own[at]) if own[at] > 0.0 else line


def _moved(given: Mapping[str, Array], states: Array, law: StateLaw | None) -> Array | None:
    """`(k,)` states whose contents the knots take; None where organs stay where they are."""
    if law is None or not {"state", "ripeness", "spread"} & set(given):
        return None
    stretch = float(given["spread"][0]) / law.sd if "spread" in given else 1.0
    off = stretch * (states - law.mean)
    if law.ripe is not None:
        return (law.mean + off) * (float(given["ripeness"][0]) / law.ripe if "ripeness" in given else 1.0)
    return (float(given["state"][0]) if "state" in given else law.mean) + off


def _cuticle(given: Mapping[str, Array], path: PigmentPath) -> dict[str, Any]:
    """What changes of flesh and cuticle; a step of a difference may lead out of what is possible."""
    found: dict[str, Any] = {}
    if "flesh" in given:
        found["flesh_reflectance"] = float(np.clip(given["flesh"][0], *RANGES["flesh_reflectance"]))
    if "ior" in given:
        found["ior"] = float(np.clip(given["ior"][0], *RANGES["ior"]))
    if "roughness" in given:
        alphas = np.array(path.roughness)
        front, back = np.clip(given["roughness"][0] / alphas[0] * alphas, *RANGES["roughness"])
        found["roughness"] = (float(front), float(back))
    return found
