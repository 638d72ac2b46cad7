"""Draw the parameters of one plant from a cultivar's distributions."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Final

import numpy as np

from pepperscene.cultivar import Cultivar, Distribution, Fruit, OrganForm, OrganModel, Slot
from pepperscene.grammar.hashing import Addresses, FloatArray, draw_key, uniforms
from pepperscene.grammar.plant import Indices, KindParameters, PlantParameters, clip_to_limits
from pepperscene.grammar.topology import OrganGroup, Phytomers, TopologyBuilder, draw_numbers

Columns = dict[str, FloatArray]

# Chosen, as growth habits that photographs show and no table has:
_TWINE_PULL: Final = 0.7  # sd, rad, of an internode's azimuth about the direction back to the plant's axis
_MIN_NODE_WIDTH: Final = 1.1  # of a node, in stem diameters
_YOUNG_LIFT: Final = math.radians(60.0)  # rise of a young blade's inclination, at size 0
_YOUNG_PALE: Final = 0.35  # fall of a young blade's state, at size 0

_SIZE_PARAMETERS: Final[Mapping[OrganForm, tuple[str, ...]]] = {
    "stalk": ("length", "diameter"),
    "blade": ("length", "width", "margin_wave", "blister", "vein", "tooth_depth"),
    "peduncle": ("length", "diameter"),
    "fruit": ("diameter",),
    "cut": ("diameter",),
    "flower": ("diameter",),
}
"""Parameters that are smaller where the stem is young."""

_CONSTANTS: Final[Mapping[OrganForm, tuple[str, ...]]] = {
    "stalk": ("towards", "channel"),
    "blade": ("palmate",),
    "flower": ("petals",),
}
"""Parameters that are equal for all organs of a kind."""

_WITH_SIZE: Final = {"length": 1, "width": 1}
_WITH_AGE: Final = {"residue": 1, "ageing": 1, "bites": 1, "tears": 1, "droop": 1, "inclination": -1}
"""Parameters of a blade that change with its size or its age, and whether they rise or fall."""

_RIPENESS: Final = ("ripe_fraction", "ripe_descent", "breaker_fraction", "unripe", "breaker", "ripe")
_CALYX: Final = ("calyx_radius", "calyx_tooth", "calyx_state", "calyx_seed")
_MAX_DEPTH: Final = 8  # chosen: fruit has fewer organs between it and its node


def draw_parameters(cultivar: Cultivar, rng: np.random.Generator, lean: float = 0.0) -> PlantParameters:
    """Draw all numbers of one plant; the same generator state gives the same plant.

    The generator gives one number, the plant's key; all others are hashed from it (see `hashing`), so that
    the same key and another date of the same cultivar give the same plant, younger or older.

    Args:
        cultivar: has the distributions.
        rng: for the key.
        lean: radians, added to the drawn lean of the stem; positive towards the aisle.

    Raises:
        InputError: the cultivar's organs bear one another until a plant has more than 200,000 of them.
    """
    phytomers = Phytomers.of(cultivar, draw_key(rng))
    organs = _draw_stem(cultivar, phytomers, lean)
    groups = TopologyBuilder(cultivar, phytomers).build()
    for name, model in cultivar.organs.items():
        if name not in organs:
            kind_groups = [group for group in groups if group.kind == name]
            organs[name] = _draw_kind(cultivar, name, model, kind_groups, phytomers)
    return PlantParameters(cultivar.name, organs, cultivar)


def _draw_stem(cultivar: Cultivar, phytomers: Phytomers, lean: float) -> dict[str, KindParameters]:
    """Internodes and nodes, numbered alternately from the ground."""
    internode, node = (cultivar.organs[name] for name in (cultivar.stem.internode, cultivar.stem.node))
    section, swelling = internode.distributions, node.distributions
    positions, sizes = phytomers.positions, phytomers.sizes
    length = sizes * section["length"].quantiles(uniforms(phytomers.internodes, "length"), positions)
    length = clip_to_limits("length", length)
    azimuth, inclination = _draw_directions(cultivar, phytomers, length, lean)

    # One deviation per plant for all boundaries between phytomers, so that internodes end as the next begin.
    boundaries = np.minimum(np.arange(len(phytomers) + 1) / max(phytomers.mature, 1), 1.0)
    mean_diameter, diameters = _draw_diameters(cultivar, phytomers, boundaries)

    def along_stem(kind: Mapping[str, Distribution], name: str, positions: FloatArray) -> FloatArray:
        uniform = np.broadcast_to(uniforms(phytomers.key, name), positions.shape)
        return clip_to_limits(name, kind[name].quantiles(uniform, positions))

    state = along_stem(section, "state", boundaries)
    # Grooves are proportional to the stem.
    groove = along_stem(section, "groove", boundaries) * diameters / mean_diameter
    width = sizes * swelling["width"].quantiles(uniforms(phytomers.nodes, "width"), positions)
    node_length = sizes * swelling["length"].quantiles(uniforms(phytomers.nodes, "length"), positions)
    internode_values = {
        "length": length,
        "azimuth": azimuth,
        "inclination": inclination,
        "diameter": diameters[:-1],
        "diameter_tip": diameters[1:],
        "groove": groove[:-1],
        "state": state[:-1],
        "state_tip": state[1:],
        "state_spread": along_stem(section, "state_spread", positions),
        "seed": uniforms(phytomers.internodes, "seed"),
    }
    node_values = {
        "width": np.maximum(width, _MIN_NODE_WIDTH * diameters[1:]),
        "length": clip_to_limits("length", node_length),
        "diameter": diameters[1:],
        "groove": groove[1:],
        "state": along_stem(swelling, "state", boundaries[1:]),
        "seed": uniforms(phytomers.nodes, "seed"),
    }
    order = np.arange(len(phytomers))
    return {
        cultivar.stem.internode: KindParameters(
            internode.kind, 2 * order, 2 * order - 1, order, internode_values
        ),
        cultivar.stem.node: KindParameters(node.kind, 2 * order + 1, 2 * order, order, node_values),
    }


def _draw_diameters(
    cultivar: Cultivar, phytomers: Phytomers, boundaries: FloatArray
) -> tuple[float, FloatArray]:
    """The mean, and `(parts + 1,)` below and above each phytomer: tapering, and thinner where young."""
    stem, key = cultivar.stem, phytomers.key
    mean = clip_to_limits("diameter", stem.diameter.quantiles(uniforms(key, "stem.diameter")))[0]
    top = clip_to_limits("tip", stem.top_diameter.quantiles(uniforms(key, "stem.top_diameter")))[0]
    slope = 2.0 * (1.0 - top) / (1.0 + top)
    size = np.append(phytomers.sizes, phytomers.sizes[-1])
    return float(mean), np.asarray(mean * (1.0 + slope * (0.5 - boundaries)) * np.sqrt(size))


def _draw_directions(
    cultivar: Cultivar, phytomers: Phytomers, length: FloatArray, lean: float
) -> tuple[FloatArray, FloatArray]:
    """Azimuth and inclination of each internode: oblique, and back to the plant's axis along the twine."""
    from scipy.special import ndtri

    stem = cultivar.stem
    zigzag = stem.zigzag.quantiles(uniforms(phytomers.internodes, "zigzag"), phytomers.positions)
    pull = _TWINE_PULL * ndtri(uniforms(phytomers.internodes, "pull"))
    # The axis leans across the row.
    axis_y = -math.sin(stem.lean.quantiles(uniforms(phytomers.key, "stem.lean"))[0] + lean)
    back = 2.0 * math.pi * float(uniforms(phytomers.key, "stem.side")[0])
    x = y = 0.0
    azimuths, inclinations = np.empty(len(phytomers)), np.empty(len(phytomers))
    steps = zip(np.sin(zigzag).tolist(), pull.tolist(), length.tolist(), strict=True)
    for i, (horizontal, deviation, step) in enumerate(steps):
        azimuth = back + deviation
        direction_x, direction_y = horizontal * math.sin(azimuth), -horizontal * math.cos(azimuth)
        x, y = x + step * direction_x, y + step * direction_y
        back = math.atan2(-x, y)
        direction_y += axis_y
        azimuths[i] = math.atan2(direction_x, -direction_y)
        inclinations[i] = math.acos(min(math.hypot(direction_x, direction_y), 1.0))
    return azimuths, inclinations


def _draw_kind(
    cultivar: Cultivar, name: str, model: OrganModel, groups: list[OrganGroup], phytomers: Phytomers
) -> KindParameters:
    """All organs of one kind, whatever they grow on."""
    if not groups:
        empty = np.zeros(0, dtype=np.intp)
        return KindParameters(model.kind, empty, empty, empty, {})

    def join(column: str) -> np.ndarray:
        return np.concatenate([getattr(group, column) for group in groups])

    address, phytomer = join("address"), join("phytomer")
    values = _draw_values(model, address, phytomers.positions[phytomer])
    # Young organs are smaller, and young blades paler and more upright.
    sizes = phytomers.sizes[phytomer]
    for column in _SIZE_PARAMETERS.get(model.form, ()):
        values[column] = sizes * values[column]
    if model.form == "blade":
        values["inclination"] = values["inclination"] + _YOUNG_LIFT * (1.0 - sizes)
        values["state"] = values["state"] - _YOUNG_PALE * (1.0 - sizes)
        # Leaves that still grow have had no time to be damaged, and hardly any to become dusty.
        for column in ("ageing", "bites", "tears"):
            values[column] = np.where(sizes < 1.0, 0.0, values[column])
        values["residue"] = sizes**2 * values["residue"]
    if isinstance(model, Fruit):
        centre = _expected_fruit_height(cultivar, name, phytomers)
        values["ripeness"] = _ripeness(values, uniforms(address, "ripeness"), phytomer, centre, phytomers)
        values["lobes"] = draw_numbers(model.lobes.numbers, uniforms(address, "lobes")).astype(float)
        values["calyx_seed"] = uniforms(address, "calyx_seed")
        for column in (*_RIPENESS, *(() if model.calyx else _CALYX)):
            del values[column]
    values = {column: clip_to_limits(column, value) for column, value in values.items()}
    for column in _CONSTANTS.get(model.form, ()):
        values[column] = np.full(address.size, float(getattr(model, column)))
    placement = {column: join(column) for column in ("at", "lift", "azimuth", "sideways")}
    values = {"seed": uniforms(address, "seed"), **placement, **values}
    return KindParameters(model.kind, join("number"), join("parent"), phytomer, values)


def _draw_values(model: OrganModel, address: Addresses, positions: FloatArray) -> Columns:
    """`(n,)` values from each distribution of a kind."""
    distributions = model.distributions
    # Many parameters are constants: skip their random numbers and quantile functions for speed.
    drawn = tuple(name for name, distribution in distributions.items() if distribution.family != "value")
    uniform = dict(zip(drawn, uniforms(address, drawn), strict=True)) if drawn else {}
    # Gaussian copulas: each value still follows its own distribution.
    for common, signs in (("size", _WITH_SIZE), ("age", _WITH_AGE)):
        correlation = getattr(model, f"{common}_correlation", 0.0)
        if correlation > 0.0:
            from scipy.special import ndtr, ndtri

            shared = math.sqrt(correlation) * ndtri(uniforms(address, common))
            for name in signs.keys() & uniform.keys():
                own = math.sqrt(1.0 - correlation) * ndtri(uniform[name])
                uniform[name] = ndtr(signs[name] * shared + own)
    return {
        name: distribution.quantiles(uniform[name], positions)
        if name in uniform
        else np.full(address.size, distribution.mean)
        for name, distribution in distributions.items()
    }


def _ripeness(
    drawn: Columns, uniform: FloatArray, phytomer: Indices, centre: float, phytomers: Phytomers
) -> FloatArray:
    """`(n,)` ripeness, 0 green to 1 ripe.

    Args:
        drawn: the `(n,)` values of the fruit's distributions.
        uniform: `(n,)` decides whether each is ripe, at the breaker stage or unripe.
        phytomer: `(n,)` of the fruit.
        centre: expected mean height of such fruit, about which ripeness is balanced.
        phytomers: of the plant.
    """
    rise = 2.0 * (centre - phytomers.heights[phytomer])
    ripe = drawn["ripe_fraction"] + drawn["ripe_descent"] * rise
    below, above = ripe - 0.5 * drawn["breaker_fraction"], ripe + 0.5 * drawn["breaker_fraction"]
    unripe_or_breaker = np.where(uniform < above, drawn["breaker"], drawn["unripe"])
    mature = np.where(uniform < below, drawn["ripe"], unripe_or_breaker)
    return np.where(phytomers.sizes[phytomer] < 1.0, drawn["unripe"], mature)


def _expected_fruit_height(cultivar: Cultivar, kind: str, phytomers: Phytomers) -> float:
    """Expected mean height of a kind of fruit on the mature part of the stem."""
    expected = np.zeros(len(phytomers))
    fruits = _expected_fruits(cultivar, kind)
    for slot in cultivar.organs[cultivar.stem.node].bears:
        items = _mean_items(slot) * phytomers.with_slot(slot)
        for name in slot.kinds:
            expected += items * _mean_probability(slot, name, phytomers) * fruits[name]
    expected[phytomers.sizes < 1.0] = 0.0
    total = expected.sum()
    return float(expected @ phytomers.heights / total) if total > 0 else 0.5


def _expected_fruits(cultivar: Cultivar, kind: str) -> dict[str, float]:
    """Kind -> expected number of fruits of one kind on it, up to `_MAX_DEPTH` organs away."""
    fruits = {name: float(name == kind) for name in cultivar.organs}
    for _ in range(_MAX_DEPTH):
        fruits = {
            name: float(name == kind)
            + sum(
                _mean_items(slot) * slot.what.probabilities[below] * fruits[below]
                for slot in model.bears
                for below in slot.kinds
            )
            for name, model in cultivar.organs.items()
        }
    return fruits


def _mean_items(slot: Slot) -> float:
    """Expected number of items in a slot."""
    number = sum(count * chance for count, chance in slot.count.numbers.items())
    return number * len(slot.at) * (2 if slot.pairs else 1)


def _mean_probability(slot: Slot, name: str, phytomers: Phytomers) -> FloatArray | float:
    """Probability of an outcome along the stem; flushes leave it unchanged on average over plants."""
    probability = slot.what.probabilities[name]
    if slot.descent is None or slot.filled == 0:
        return probability
    fraction = slot.what.probabilities[slot.descent.of] / slot.filled
    excess = slot.descent.by.mean * phytomers.descent(slot)
    if name == slot.descent.of:
        return np.asarray(probability + slot.filled * excess)
    return np.asarray(probability * (1.0 - excess / (1.0 - fraction))) if fraction < 1.0 else probability
