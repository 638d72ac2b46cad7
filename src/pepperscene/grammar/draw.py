"""Drawing the parameters of one plant from a cultivar's laws."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Final

import numpy as np

from pepperscene.cultivar import Cultivar, Distribution
from pepperscene.cultivar.forms import Form
from pepperscene.cultivar.organs import Fruit, OrganModel
from pepperscene.grammar.choose import drawn_number
from pepperscene.grammar.expand import Items, expanded
from pepperscene.grammar.growth import Growth, growth_of
from pepperscene.grammar.hashing import Addresses, FloatArray, drawn_key, several_shares, shares
from pepperscene.grammar.limits import possible
from pepperscene.grammar.parameters import KindParameters, PlantParameters
from pepperscene.grammar.ripening import fruit_middle, ripeness
from pepperscene.grammar.stem import stem_columns

# Chosen, as habits of growth that photographs show and no table has:
_YOUNG_LIFT: Final = math.radians(60.0)  # young blades are held up; at size 0 by so much
_YOUNG_PALE: Final = 0.35  # young blades are paler; at size 0 by so much in state

_GROWING: Final[Mapping[Form, tuple[str, ...]]] = {
    "stalk": ("length", "diameter"),
    "blade": ("length", "width", "margin_wave", "blister", "vein"),
    "peduncle": ("length", "diameter"),
    "fruit": ("diameter",),
    "cut": ("diameter",),
    "flower": ("diameter",),
}
"""What is smaller where the stem is young."""

_PLAIN: Final[Mapping[Form, tuple[str, ...]]] = {"stalk": ("towards", "channel"), "flower": ("petals",)}
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
    laws = model.laws
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
