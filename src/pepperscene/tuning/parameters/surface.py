"""How organs of one surface are spread along their path through pigment space: the laws of their states."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pepperscene.cultivar import CALYX, USUAL, Fruit, PigmentPath, Pigments
from pepperscene.render.gradients.pigment_models import CONTENTS, RANGES
from pepperscene.tuning.parameters.tunables import Group, Tunables

if TYPE_CHECKING:
    from pepperscene.cultivar import Cultivar, Distribution


Array = NDArray[np.float64]
Part = tuple[float, float, float]
"""Weight, mean and standard deviation of one law in a mixture."""

_SHARES: Final = 256
_PLACES: Final = 64
"""At the middles of so many equal shares, and of so many parts of the stem, a law's spread is summed up."""


@dataclass(frozen=True)
class StateDistribution:
    """Where the organs of one surface lie on its path.

    Attributes:
        mean: of the state over organs; kinds that plants grow count alike, however many a plant has.
        sd: of the same.
        ripe: mean ripeness of ripe fruit, kinds alike; None where no fruit has this surface, or none ripens.
    """

    mean: float
    sd: float
    ripe: float | None = None


def state_law(cultivar: Cultivar, surface: str) -> StateDistribution | None:
    """The law of one surface's states; None where no kind that grows has it, or none has such a law.

    Fruit has its stages instead: unripe, turning and ripe, in the shares that the cultivar states. The
    mottling within an organ is not counted.
    """
    kinds = [_parts(cultivar, kind, surface) for kind in cultivar.grown]
    mixture = [(weight / len(found), mean, sd) for found in kinds for weight, mean, sd in found if found]
    if not mixture:
        return None
    weights, means, sds = np.array(mixture).T
    weights /= weights.sum()
    mean = float(weights @ means)
    sd = float(np.sqrt(weights @ (sds**2 + (means - mean) ** 2)))
    fruits = _fruits(cultivar, surface)
    ripe = float(np.mean([organ.ripe.mean for organ in fruits])) if fruits else 0.0
    return StateDistribution(mean, sd, ripe if ripe > 0.0 else None)


def surfaces_of(cultivar: Cultivar) -> tuple[str, ...]:
    """Those that pigments make and plants show, in the order of the cultivar's file."""
    shown = {cultivar.kinds[kind].surface for kind in cultivar.grown}
    return tuple(name for name in cultivar.pigments if name in shown)


def _fruits(cultivar: Cultivar, surface: str) -> list[Fruit]:
    organs = [cultivar.organs[kind] for kind in cultivar.grown if kind != CALYX]
    return [organ for organ in organs if isinstance(organ, Fruit) and organ.kind.surface == surface]


def _parts(cultivar: Cultivar, kind: str, surface: str) -> list[Part]:
    """One kind's share of the mixture."""
    if kind == CALYX:
        # The calyx is its fruit's, whose table states how green it is.
        bearers = [cultivar.organs[name] for name in cultivar.grown if name != CALYX]
        laws = [organ.calyx_state for organ in bearers if isinstance(organ, Fruit) and organ.calyx]
        return [_moments(law, 1.0 / len(laws)) for law in laws if USUAL["calyx"].surface == surface]
    organ = cultivar.organs[kind]
    if organ.kind.surface != surface:
        return []
    if isinstance(organ, Fruit):
        turning = organ.breaker_fraction.mean
        ripe = max(organ.ripe_fraction.mean - 0.5 * turning, 0.0)
        unripe = max(1.0 - ripe - turning, 0.0)
        stages = ((organ.unripe, unripe), (organ.breaker, turning), (organ.ripe, ripe))
        return [_moments(law, share) for law, share in stages]
    law = getattr(organ, "state", None)
    return [] if law is None else [_moments(law, 1.0)]


def _moments(law: Distribution, weight: float) -> Part:
    """Mean and standard deviation over all places along the stem."""
    return weight, law.mean, _spread_along(law) if law.follows_height else law.sd


@lru_cache(maxsize=256)
def _spread_along(law: Distribution) -> float:
    """Standard deviation over shares and places together; a fit asks for it again and again."""
    shares = (np.arange(_SHARES) + 0.5) / _SHARES
    places = (np.arange(_PLACES) + 0.5) / _PLACES
    return float(law.quantiles(shares[:, None], places).std())


REACH: Final = 0.04
"""Half of that interval. Chosen: less than organs of one kind differ by (about 0.1), so that no colour of a
path is lost, and far more than the steps of any difference."""


def shifted(states: Array, contents: Array, moved: Array) -> Array:
    """Contents of a path at moved states: continuously differentiable, nowhere below 0, exact if none moves.

    Args:
        states: `(k,)` of the knots, from 0 to 1.
        contents: `(k, c)` at the knots, at least 0; beyond the ends those of the ends hold.
        moved: `(k,)` where each knot takes its contents from.
    """
    smooth = _averaged(states, contents, states)
    # A ratio, since a difference could lead below 0 where the path comes down to it.
    ratio = np.divide(contents, smooth, out=np.ones_like(smooth), where=smooth > 0.0)
    off = np.clip((moved - states) / REACH, -1.0, 1.0)
    kept = (1.0 - off**2) ** 2
    return np.asarray(_averaged(states, contents, moved) * (1.0 + kept[:, None] * (ratio - 1.0)))


def _averaged(states: Array, contents: Array, at: Array) -> Array:
    """`(n, c)` the path's means over intervals of twice `REACH` about states `(n,)`."""
    above, below = (_integral(states, contents, at + side * REACH) for side in (1.0, -1.0))
    return np.maximum((above - below) / (2.0 * REACH), 0.0)  # rounding


def _integral(states: Array, contents: Array, to: Array) -> Array:
    """`(n, c)` of the path from state 0 on, with its ends held beyond."""
    steps = np.diff(states)[:, None]
    slopes = np.diff(contents, axis=0) / steps
    parts = 0.5 * (contents[1:] + contents[:-1]) * steps
    sums = np.concatenate([np.zeros((1, contents.shape[1])), np.cumsum(parts, axis=0)])
    inside = np.clip(to, 0.0, 1.0)
    knot = np.clip(np.searchsorted(states, inside, side="right") - 1, 0, len(slopes) - 1)
    step = (inside - states[knot])[:, None]
    within = sums[knot] + step * (contents[knot] + 0.5 * slopes[knot] * step)
    before, behind = np.minimum(to, 0.0)[:, None], np.maximum(to - 1.0, 0.0)[:, None]
    return np.asarray(within + contents[0] * before + contents[-1] * behind)


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


def surface_side(cultivar: Cultivar) -> dict[str, Tunables]:
    """What can be fitted of the surfaces that plants show, in the order of the cultivar's file."""
    found = [one for surface in surfaces_of(cultivar) for one in _of_surface(cultivar, surface)]
    return {one.name: one for one in found}


def _of_surface(cultivar: Cultivar, surface: str) -> list[Tunables]:
    path, law, found = cultivar.pigments[surface], state_law(cultivar, surface), []

    def add(what: str, meaning: str, value: float, low: float, high: float, floor: float = 0.0) -> None:
        unit = NAMES[what.rpartition(".")[2]][1] if what.rpartition(".")[2] in NAMES else ""
        group: Group = "cuticle" if what in ("ior", "roughness") else "pigments"
        value_of = np.array([value], float)
        found.append(Tunables(f"{surface}.{what}", unit, meaning, group, value_of, low, high, floor))

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


def path_at(surface: str, path: PigmentPath, law: StateDistribution | None, values: Values) -> PigmentPath:
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


def _moved(given: Mapping[str, Array], states: Array, law: StateDistribution | None) -> Array | None:
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
