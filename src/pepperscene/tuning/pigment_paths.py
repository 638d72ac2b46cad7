"""Pigment paths: the distribution of organ states along a path, and the path at tuned parameter values."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pepperscene.cultivar import CALYX, DEFAULT_KINDS, Cultivar, Distribution, Fruit, PigmentPath, Pigments
from pepperscene.render.gradients.tunable import CONTENTS, RANGES

Array = NDArray[np.float64]
Component = tuple[float, float, float]  # weight, mean and standard deviation in a mixture
CONTENT_FIELDS: Final[Mapping[str, tuple[str, str]]] = {
    "chlorophyll": ("chlorophyll_ug_cm2", "µg/cm²"),
    "carotenoid": ("carotenoid_ug_cm2", "µg/cm²"),
    "capsanthin": ("capsanthin_ug_cm2", "µg/cm²"),
    "anthocyanin": ("anthocyanin_ug_cm2", "µg/cm²"),
    "brown": ("brown", ""),
    "structure": ("structure_n", ""),
}
"""Parameter name of each content -> its field of `Pigments` and its unit."""
PATH_ENDS: Final = {"unripe": 0, "ripe": -1}
"""Index of the knot at either end of a path; for a leaf, its palest and its darkest tissue."""
SMOOTHING_RADIUS: Final = 0.04
"""Half-width of the moving average of a path, in state. Chosen: less than organs of one kind differ by (about
0.1), so that no colour of the path is lost, and far more than any finite-difference step."""
_QUANTILES, _STEM_POSITIONS = 256, 64  # samples of a distribution that varies along the stem


@dataclass(frozen=True)
class StateDistribution:
    """Distribution of the states of organs that share a surface; each kind that grows has equal weight."""

    mean: float
    sd: float
    mean_ripeness: float | None = None  # of ripe fruit; None if no fruit has the surface or none ripens


def state_distribution(cultivar: Cultivar, surface: str) -> StateDistribution | None:
    """Distribution of a surface's states, or None if no grown kind of organ has both surface and states.

    For fruit, the mixture of unripe, turning and ripe fruit in the cultivar's fractions. Variation within an
    organ (mottling) is not included.
    """
    kinds = [_components(cultivar, kind, surface) for kind in cultivar.present_kinds]
    mixture = [(weight / len(parts), mean, sd) for parts in kinds for weight, mean, sd in parts]
    if not mixture:
        return None
    weights, means, sds = np.array(mixture).T
    weights /= weights.sum()
    mean = float(weights @ means)
    sd = float(np.sqrt(weights @ (sds**2 + (means - mean) ** 2)))
    organs = [cultivar.organs[kind] for kind in cultivar.present_kinds if kind != CALYX]
    fruits = [organ for organ in organs if isinstance(organ, Fruit) and organ.kind.surface == surface]
    ripe = float(np.mean([fruit.ripe.mean for fruit in fruits])) if fruits else 0.0
    return StateDistribution(mean, sd, ripe if ripe > 0.0 else None)


def visible_surfaces(cultivar: Cultivar) -> tuple[str, ...]:
    """Surfaces whose pigments grown organs show, in the order of the cultivar's file; not measured ones."""
    surfaces = {cultivar.kinds[kind].surface for kind in cultivar.present_kinds}
    return tuple(name for name in cultivar.pigments if name in surfaces - cultivar.spectra.keys())


def _components(cultivar: Cultivar, kind: str, surface: str) -> list[Component]:
    """Components that one kind of organ adds to the mixture of a surface's states."""
    if kind == CALYX:
        # The state of a calyx is defined in the table of its fruit.
        bearers = [cultivar.organs[name] for name in cultivar.present_kinds if name != CALYX]
        states = [organ.calyx_state for organ in bearers if isinstance(organ, Fruit) and organ.calyx]
        return [
            _component(state, 1.0 / len(states))
            for state in states
            if DEFAULT_KINDS["calyx"].surface == surface
        ]
    organ = cultivar.organs[kind]
    if organ.kind.surface != surface:
        return []
    if isinstance(organ, Fruit):
        turning = organ.breaker_fraction.mean
        ripe = max(organ.ripe_fraction.mean - 0.5 * turning, 0.0)
        unripe = max(1.0 - ripe - turning, 0.0)
        stages = ((organ.unripe, unripe), (organ.breaker, turning), (organ.ripe, ripe))
        return [_component(state, fraction) for state, fraction in stages]
    state = getattr(organ, "state", None)
    return [] if state is None else [_component(state, 1.0)]


def _component(state: Distribution, weight: float) -> Component:
    return weight, state.mean, _sd_along_stem(state) if state.follows_height else state.sd


@lru_cache(maxsize=256)
def _sd_along_stem(state: Distribution) -> float:
    """Standard deviation over quantiles and positions along the stem; cached, as every fit step needs it."""
    quantiles = (np.arange(_QUANTILES) + 0.5) / _QUANTILES
    positions = (np.arange(_STEM_POSITIONS) + 0.5) / _STEM_POSITIONS
    return float(state.quantiles(quantiles[:, None], positions).std())


def tuned_path(
    surface: str, path: PigmentPath, states: StateDistribution | None, values: Mapping[str, ArrayLike]
) -> PigmentPath:
    """Return the path of a surface at parameter values, on the same knots.

    Contents change first, then organs move along the changed path. Scaling and moving commute; for `unripe`
    and `ripe` the order makes the value that of the path's own end, and keeps all contents at 0 or above.
    """
    given = {
        name.removeprefix(f"{surface}."): np.asarray(value, dtype=float).ravel()
        for name, value in values.items()
        if name.startswith(f"{surface}.")
    }
    # Tissue that ages keeps its contents: states below 0 are not tuned.
    healthy = [(state, pigments) for state, pigments in path.knots if state >= 0.0]
    knots = np.array([state for state, _ in healthy])
    table = {field: np.array([getattr(p, field) for _, p in healthy]) for field in CONTENTS}
    ripens = states is not None and states.mean_ripeness is not None
    for name, (field, _) in CONTENT_FIELDS.items():
        table[field] = _tuned_content(name, given, knots, table[field], RANGES[field][0], ripens)

    moved = _moved_states(given, knots, states)
    if moved is not None:
        floors = np.array([RANGES[field][0] for field in CONTENTS])
        contents = np.stack([table[field] for field in CONTENTS], axis=1) - floors
        table = dict(
            zip(CONTENTS, (floors + contents_at_moved_states(knots, contents, moved)).T, strict=True)
        )

    table = {field: np.clip(content, *RANGES[field]) for field, content in table.items()}
    pigments = [Pigments(**{field: float(table[field][i]) for field in CONTENTS}) for i in range(len(knots))]
    between = tuple(zip(knots[1:-1].tolist(), pigments[1:-1], strict=True))
    changes: dict[str, Any] = {"start": pigments[0], "end": pigments[-1], "path": between}
    fields = {name: getattr(path, name) for name in PigmentPath.model_fields}
    return PigmentPath(**fields | changes | _tuned_cuticle(given, path))


def _tuned_content(
    name: str, given: Mapping[str, Array], knots: Array, content: Array, floor: float, ripens: bool
) -> Array:
    """`(k,)` one content at the knots."""
    original = content - floor
    if name in given:
        largest, maximum = float(given[name][0]) - floor, float(original.max())
        # A content that the path lacks is added evenly; the red of fruit in proportion to ripeness.
        if maximum > 0.0:
            profile = original / maximum
        else:
            profile = knots if ripens and name == "capsanthin" else np.ones_like(original)
        return floor + np.maximum(largest * profile, 0.0)
    changed = original
    for end, knot in PATH_ENDS.items():
        if f"{end}.{name}" in given:
            change = float(given[f"{end}.{name}"][0]) - floor - original[knot]
            changed = changed + change * _fade_weights(knots, original, knot)
    return content if changed is original else floor + np.maximum(changed, 0.0)


def _fade_weights(knots: Array, content: Array, knot: int) -> Array:
    """`(k,)` weights of a change at one end: linear to 0 at the other end, smaller where less is left.

    So both ends can be reduced to nothing, and no knot falls below 0.
    """
    line = knots if knot else 1.0 - knots
    return line * np.minimum(1.0, content / content[knot]) if content[knot] > 0.0 else line


def _moved_states(given: Mapping[str, Array], knots: Array, states: StateDistribution | None) -> Array | None:
    """`(k,)` states whose contents the knots take; None if organs do not move."""
    if states is None or not {"state", "ripeness", "spread"} & set(given):
        return None
    stretch = float(given["spread"][0]) / states.sd if "spread" in given else 1.0
    deviation = stretch * (knots - states.mean)
    if states.mean_ripeness is not None:
        factor = float(given["ripeness"][0]) / states.mean_ripeness if "ripeness" in given else 1.0
        return (states.mean + deviation) * factor
    return (float(given["state"][0]) if "state" in given else states.mean) + deviation


def _tuned_cuticle(given: Mapping[str, Array], path: PigmentPath) -> dict[str, Any]:
    """Changed fields of flesh and cuticle, clipped: a finite-difference step may leave the valid range."""
    fields: dict[str, Any] = {}
    if "flesh" in given:
        fields["flesh_reflectance"] = float(np.clip(given["flesh"][0], *RANGES["flesh_reflectance"]))
    if "ior" in given:
        fields["ior"] = float(np.clip(given["ior"][0], *RANGES["ior"]))
    if "roughness" in given:
        alphas = np.array(path.roughness)
        front, back = np.clip(given["roughness"][0] / alphas[0] * alphas, *RANGES["roughness"])
        fields["roughness"] = (float(front), float(back))
    return fields


def contents_at_moved_states(knots: Array, contents: Array, moved: Array) -> Array:
    """Contents of a path at moved states.

    They are those of the moving average of the path, and so continuously differentiable. The difference to
    the path itself fades in towards `moved == knots`, where the result is exact. It is nowhere below 0.
    Knots `(k,)` are states from 0 to 1 with contents `(k, c)`, constant beyond the ends; each takes the
    contents of its state in `moved`.
    """
    smooth = _moving_average(knots, contents, knots)
    # A ratio, because subtracting a difference could give values below 0 near the zeros of a path.
    ratio = np.divide(contents, smooth, out=np.ones_like(smooth), where=smooth > 0.0)
    # A bump with a continuous slope: 1 where nothing moves, 0 from a radius on.
    distance = np.clip((moved - knots) / SMOOTHING_RADIUS, -1.0, 1.0)
    weight = (1.0 - distance**2) ** 2
    return np.asarray(_moving_average(knots, contents, moved) * (1.0 + weight[:, None] * (ratio - 1.0)))


def _moving_average(knots: Array, contents: Array, at: Array) -> Array:
    """`(n, c)` means of the path over `SMOOTHING_RADIUS` to either side of states `(n,)`."""
    above, below = (_integral(knots, contents, at + side * SMOOTHING_RADIUS) for side in (1.0, -1.0))
    return np.maximum((above - below) / (2.0 * SMOOTHING_RADIUS), 0.0)  # rounding


def _integral(knots: Array, contents: Array, to: Array) -> Array:
    """`(n, c)` integrals of the piecewise linear path from state 0; it is constant beyond its ends."""
    # Trapezoids up to each knot, then the part within a segment, then what is beyond the ends.
    steps = np.diff(knots)[:, None]
    slopes = np.diff(contents, axis=0) / steps
    areas = 0.5 * (contents[1:] + contents[:-1]) * steps
    sums = np.concatenate([np.zeros((1, contents.shape[1])), np.cumsum(areas, axis=0)])
    inside = np.clip(to, 0.0, 1.0)
    knot = np.clip(np.searchsorted(knots, inside, side="right") - 1, 0, len(slopes) - 1)
    step = (inside - knots[knot])[:, None]
    within = sums[knot] + step * (contents[knot] + 0.5 * slopes[knot] * step)
    before, beyond = np.minimum(to, 0.0)[:, None], np.maximum(to - 1.0, 0.0)[:, None]
    return np.asarray(within + contents[0] * before + contents[-1] * beyond)
