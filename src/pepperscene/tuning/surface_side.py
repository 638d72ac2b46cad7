"""The parameters of surfaces: what a cultivar has of them, and what values make of a path."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pepperscene.cultivar import PigmentPath, Pigments
from pepperscene.render.bodies import CONTENTS, RANGES
from pepperscene.tuning.laws import StateLaw, state_law, surfaces_of
from pepperscene.tuning.own import Own
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
    path, found = cultivar.pigments[surface], []
    for name, (field, unit) in NAMES.items():
        low, high = RANGES[field]
        values = np.array([getattr(pigments, field) for _, pigments in path.knots])
        limits = {"low": low, "high": high, "floor": low}
        places = {"": values.max()} | {f"{end}.": values[at] for end, at in ENDS.items()}
        words = ("largest along the path", "at state 0", "at state 1")
        found += [
            Own(f"{surface}.{end}{name}", unit, f"{name}, {place}", "pigments", np.array([value]), **limits)
            for (end, value), place in zip(places.items(), words, strict=True)
        ]
    law = state_law(cultivar, surface)
    if law is not None and law.ripe is not None and law.ripe > 0.0:
        ripe = np.array([law.ripe])
        found.append(
            Own(f"{surface}.ripeness", "", "mean ripeness of ripe fruit", "pigments", ripe, 0.0, 1.0)
        )
    elif law is not None:
        mean = np.array([law.mean])
        found.append(Own(f"{surface}.state", "", "mean state of the organs", "pigments", mean, 0.0, 1.0))
    if law is not None and law.sd > 0.0:
        sd = np.array([law.sd])
        found.append(Own(f"{surface}.spread", "", "sd of the organs' states", "pigments", sd, 0.0, 1.0))
    if path.flesh_reflectance is not None:
        flesh = np.array([path.flesh_reflectance])
        high = RANGES["flesh_reflectance"][1]
        found.append(Own(f"{surface}.flesh", "", "reflectance of the flesh", "pigments", flesh, 0.0, high))
    front, back = path.roughness
    least, most = RANGES["roughness"]
    return [
        *found,
        Own(
            f"{surface}.ior", "", "refractive index of the cuticle", "cuticle", np.array([path.ior]),
            *RANGES["ior"], floor=1.0,
        ),
        # The back scales alike and has to stay within its range as well.
        Own(
            f"{surface}.roughness", "", "GGX alpha of the cuticle's front", "cuticle", np.array([front]),
            least * max(1.0, front / back), most * min(1.0, front / back),
        ),
    ]  # fmt: skip


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
        for field in CONTENTS:
            floor = RANGES[field][0]
            table[field] = floor + shifted(states, table[field] - floor, moved)

    knots = [Pigments(**{what: float(table[what][i]) for what in CONTENTS}) for i in range(len(states))]
    between = tuple(zip(states[1:-1].tolist(), knots[1:-1], strict=True))
    changes = {"start": knots[0], "end": knots[-1], "path": between, **_cuticle(given, path)}
    return PigmentPath(**{name: changes.get(name, getattr(path, name)) for name in PigmentPath.model_fields})


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
    """`(k,)` shares of a change at one end: linearly to none at the other, less where there is less to change.

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


def _cuticle(given: Mapping[str, Array], path: PigmentPath) -> dict[str, object]:
    """What changes of flesh and cuticle."""
    found: dict[str, object] = {}
    if "flesh" in given:
        found["flesh_reflectance"] = float(given["flesh"][0])
    if "ior" in given:
        found["ior"] = float(given["ior"][0])
    if "roughness" in given:
        front, back = path.roughness
        wanted = float(given["roughness"][0])
        found["roughness"] = (wanted, wanted * back / front)
    return found
