"""Drawing the parameters of one plant from a cultivar's laws."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Final

import numpy as np

from pepperscene.cultivar import Cultivar, Distribution
from pepperscene.cultivar.organs import Fruit, OrganForm, OrganModel
from pepperscene.grammar.expand import Items, expanded
from pepperscene.grammar.growth import Growth, drawn_number, fruit_middle, growth_of, ripeness
from pepperscene.grammar.hashing import Addresses, FloatArray, drawn_key, several_shares, shares
from pepperscene.grammar.plant import KindParameters, PlantParameters, possible

# Chosen, as a habit of growth that photographs show and no table has:
_TWINE_PULL: Final = 0.7  # sd, rad, of a section's azimuth about the way back to the plant's own line
_THICKER: Final = 1.1  # a node is never thinner than so many times its stem

Columns = dict[str, FloatArray]


def stem_columns(cultivar: Cultivar, growth: Growth, lean: float) -> tuple[Columns, Columns]:
    """The numbers of all internodes and of all nodes, by the names of `KindParameters.values`."""
    section, swelling = (
        cultivar.organs[cultivar.stem.internode].distributions,
        cultivar.organs[cultivar.stem.node].distributions,
    )
    sections, nodes, places, sizes = growth.sections, growth.nodes, growth.places, growth.sizes
    length = sizes * section["length"].quantiles(shares(sections, "length"), places)
    length = possible("length", length)
    azimuth, inclination = _directions(cultivar, growth, length, lean)
    mean, diameters = _diameters(cultivar, growth)
    # One deviation for the whole stem, so that a section ends as the next begins.
    joints = np.minimum(np.arange(growth.parts + 1) / max(growth.grown, 1), 1.0)
    deviation = np.broadcast_to(shares(growth.key, "state"), joints.shape)
    state = possible("state", section["state"].quantiles(deviation, joints))
    spread = np.broadcast_to(shares(growth.key, "state_spread"), places.shape)
    # Grooves are in proportion to the stem.
    depth = section["groove"].quantiles(np.broadcast_to(shares(growth.key, "groove"), joints.shape), joints)
    groove = possible("groove", depth * diameters / mean)
    width = sizes * swelling["width"].quantiles(shares(nodes, "width"), places)
    return {
        "length": length,
        "azimuth": azimuth,
        "inclination": inclination,
        "diameter": diameters[:-1],
        "diameter_tip": diameters[1:],
        "groove": groove[:-1],
        "state": state[:-1],
        "state_tip": state[1:],
        "state_spread": possible("state_spread", section["state_spread"].quantiles(spread, places)),
        "seed": shares(sections, "seed"),
    }, {
        "width": np.maximum(width, _THICKER * diameters[1:]),
        "length": possible("length", sizes * swelling["length"].quantiles(shares(nodes, "length"), places)),
        "diameter": diameters[1:],
        "groove": groove[1:],
        "state": possible("state", swelling["state"].quantiles(deviation[1:], joints[1:])),
        "seed": shares(nodes, "seed"),
    }


def _diameters(cultivar: Cultivar, growth: Growth) -> tuple[float, FloatArray]:
    """The drawn mean, and `(parts + 1,)` below and above each phytomer: tapering, and thinner where young."""
    stem = cultivar.stem
    mean = possible("diameter", np.array([growth.once(stem.diameter, "stem.diameter")]))[0]
    top = possible("tip", np.array([growth.once(stem.top_diameter, "stem.top_diameter")]))[0]
    slope = 2.0 * (1.0 - top) / (1.0 + top)
    place = np.minimum(np.arange(growth.parts + 1) / max(growth.grown, 1), 1.0)
    size = np.append(growth.sizes, growth.sizes[-1])
    return float(mean), np.asarray(mean * (1.0 + slope * (0.5 - place)) * np.sqrt(size))


def _directions(
    cultivar: Cultivar, growth: Growth, length: FloatArray, lean: float
) -> tuple[FloatArray, FloatArray]:
    """Azimuth and inclination of each section: aslant, and back to the line that the twine holds it to."""
    from scipy.special import ndtri

    stem = cultivar.stem
    aslant = np.sin(stem.zigzag.quantiles(shares(growth.sections, "zigzag"), growth.places))
    pull = _TWINE_PULL * ndtri(shares(growth.sections, "pull"))
    # The plant's own line, from which the stem must not stray: it leans across the row.
    line = -math.sin(growth.once(stem.lean, "stem.lean") + lean)
    back = 2.0 * math.pi * float(shares(growth.key, "stem.side")[0])
    x = y = 0.0
    azimuths, inclinations = np.empty(growth.parts), np.empty(growth.parts)
    for i, (share, turned, step) in enumerate(
        zip(aslant.tolist(), pull.tolist(), length.tolist(), strict=True)
    ):
        azimuth = back + turned
        level_x, level_y = share * math.sin(azimuth), -share * math.cos(azimuth)
        x, y = x + step * level_x, y + step * level_y
        back = math.atan2(-x, y)
        # A section's share of the way is level, the rest of it upwards.
        level_y += line
        azimuths[i] = math.atan2(level_x, -level_y)
        inclinations[i] = math.acos(min(math.hypot(level_x, level_y), 1.0))
    return azimuths, inclinations


# Chosen, as habits of growth that photographs show and no table has:
_YOUNG_LIFT: Final = math.radians(60.0)  # young blades are held up; at size 0 by so much
_YOUNG_PALE: Final = 0.35  # young blades are paler; at size 0 by so much in state

_GROWING: Final[Mapping[OrganForm, tuple[str, ...]]] = {
    "stalk": ("length", "diameter"),
    "blade": ("length", "width", "margin_wave", "blister", "vein"),
    "peduncle": ("length", "diameter"),
    "fruit": ("diameter",),
    "cut": ("diameter",),
    "flower": ("diameter",),
}
"""What is smaller where the stem is young."""

_PLAIN: Final[Mapping[OrganForm, tuple[str, ...]]] = {"stalk": ("towards", "channel"), "flower": ("petals",)}
"""Numbers that all organs of a kind have alike."""

_RIPENING: Final = ("ripe_fraction", "ripe_descent", "breaker_fraction", "unripe", "breaker", "ripe")
_CALYX: Final = ("calyx_radius", "calyx_tooth", "calyx_state", "calyx_seed")
_PLACED: Final = ("at", "lift", "azimuth", "sideways")


def draw_parameters(cultivar: Cultivar, rng: np.random.Generator, lean: float = 0.0) -> PlantParameters:
    """All numbers of one plant; the same generator state gives the same plant.

    The generator gives one number, the plant's key; all else is looked up by it (see `hashing`), so that the
    same key and another date of the same cultivar give the same plant, younger or older.

    Args:
        cultivar: whose laws they follow.
        rng: for the key.
        lean: radians, added to the drawn lean of the stem; positive towards the aisle.

    Raises:
        ValueError: the cultivar's organs bear one another without end.
    """
    growth = growth_of(cultivar, drawn_key(rng))
    organs = _stem(cultivar, growth, lean)
    items = expanded(cultivar, growth)
    for name, model in cultivar.organs.items():
        mine = [one for one in items if one.kind == name]
        if name not in organs:
            organs[name] = _organs(cultivar, name, model, mine, growth)
    return PlantParameters(cultivar.name, organs)


def _stem(cultivar: Cultivar, growth: Growth, lean: float) -> dict[str, KindParameters]:
    """Internodes and nodes in turn, from the ground."""
    order = np.arange(growth.parts)
    sections, nodes = stem_columns(cultivar, growth, lean)
    names = cultivar.stem.internode, cultivar.stem.node
    kinds = [cultivar.organs[name].kind for name in names]
    return {
        names[0]: KindParameters(kinds[0], 2 * order, 2 * order - 1, order, sections),
        names[1]: KindParameters(kinds[1], 2 * order + 1, 2 * order, order, nodes),
    }


def _organs(
    cultivar: Cultivar, name: str, model: OrganModel, items: list[Items], growth: Growth
) -> KindParameters:
    """All organs of one kind, whatever they grow on."""
    if not items:
        nothing = np.zeros(0, dtype=np.intp)
        return KindParameters(model.kind, nothing, nothing, nothing, {})
    address, phytomer = (
        np.concatenate([getattr(one, column) for one in items]) for column in ("address", "phytomer")
    )
    values = _drawn(model, address, growth.places[phytomer])
    # Young organs are smaller, and young blades paler and held up.
    sizes = growth.sizes[phytomer]
    for column in _GROWING.get(model.form, ()):
        values[column] = sizes * values[column]
    if model.form == "blade":
        values["inclination"] = values["inclination"] + _YOUNG_LIFT * (1.0 - sizes)
        values["state"] = values["state"] - _YOUNG_PALE * (1.0 - sizes)
    if isinstance(model, Fruit):
        middle = fruit_middle(cultivar, name, growth)
        values["ripeness"] = ripeness(values, shares(address, "ripeness"), phytomer, middle, growth)
        values["lobes"] = drawn_number(model.lobes.numbers, shares(address, "lobes")).astype(float)
        values["calyx_seed"] = shares(address, "calyx_seed")
        for column in (*_RIPENING, *(() if model.calyx else _CALYX)):
            del values[column]
    values = {column: possible(column, value) for column, value in values.items()}
    for column in _PLAIN.get(model.form, ()):
        values[column] = np.full(address.size, float(getattr(model, column)))
    placed = {column: np.concatenate([getattr(one, column) for one in items]) for column in _PLACED}
    return KindParameters(
        kind=model.kind,
        number=np.concatenate([one.number for one in items]),
        parent=np.concatenate([one.parent for one in items]),
        phytomer=phytomer,
        values={"seed": shares(address, "seed"), **placed, **values},
    )


def _drawn(model: OrganModel, address: Addresses, places: FloatArray) -> dict[str, FloatArray]:
    """`(n,)` values of all of a kind's laws."""
    laws = model.distributions
    names = tuple(laws)
    share = dict(zip(names, several_shares(address, names), strict=True))
    correlation = getattr(model, "size_correlation", 0.0)
    if correlation > 0.0:
        _correlate(share, ("length", "width"), correlation, shares(address, "size"))
    return {name: _values(law, share[name], places) for name, law in laws.items()}


def _values(law: Distribution, share: FloatArray, places: FloatArray) -> FloatArray:
    if law.law == "value":
        return np.full(share.size, law.mean)
    return law.quantiles(share, places)


def _correlate(
    share: dict[str, FloatArray], names: tuple[str, ...], correlation: float, common: FloatArray
) -> None:
    """Tie some shares by a Gaussian copula, so that each value still follows its own law."""
    from scipy.special import ndtr, ndtri

    shared, own = math.sqrt(correlation) * ndtri(common), math.sqrt(1.0 - correlation)
    for name in names:
        share[name] = ndtr(shared + own * ndtri(share[name]))
