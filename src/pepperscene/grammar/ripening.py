"""How ripe each fruit is: ripe more often low on the plant, never where the plant still grows."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.cultivar import Cultivar, Slot
from pepperscene.grammar.growth import Growth
from pepperscene.grammar.hashing import FloatArray

_ROUNDS: Final = 8  # chosen: fruit stands fewer organs away from its node


def ripeness(
    drawn: dict[str, FloatArray],
    share: FloatArray,
    phytomers: NDArray[np.intp],
    middle: float,
    growth: Growth,
) -> FloatArray:
    """`(n,)` ripeness, 0 green to 1 ripe.

    Args:
        drawn: the `(n,)` values of the fruit's laws.
        share: `(n,)` by which each is ripe, turning or green.
        phytomers: `(n,)` where they hang.
        middle: mean height of such fruit, about which ripeness is balanced; see `fruit_middle`.
        growth: the plant's.
    """
    rise = 2.0 * (middle - growth.heights[phytomers])
    ripe = drawn["ripe_fraction"] + drawn["ripe_descent"] * rise
    below, above = ripe - 0.5 * drawn["breaker_fraction"], ripe + 0.5 * drawn["breaker_fraction"]
    coloured = np.where(
        share < below, drawn["ripe"], np.where(share < above, drawn["breaker"], drawn["unripe"])
    )
    return np.where(growth.sizes[phytomers] < 1.0, drawn["unripe"], coloured)


def fruit_middle(cultivar: Cultivar, kind: str, growth: Growth) -> float:
    """Mean height at which a kind of fruit is to be expected on the grown part of the stem."""
    expected = np.zeros(growth.parts)
    per_kind = _fruit_of_each(cultivar, kind)
    for slot in cultivar.organs[cultivar.stem.node].bears:
        bearing = _items(slot) * growth.bears(slot)
        for name in slot.kinds:
            expected += bearing * _chance(slot, name, growth) * per_kind[name]
    expected[growth.sizes < 1.0] = 0.0
    total = expected.sum()
    return float(expected @ growth.heights / total) if total > 0 else 0.5


def _fruit_of_each(cultivar: Cultivar, kind: str) -> dict[str, float]:
    """Kind -> how many fruits of one kind are to be expected on it; without end, as far as counts here."""
    found = {name: float(name == kind) for name in cultivar.organs}
    for _ in range(_ROUNDS):
        found = {
            name: float(name == kind)
            + sum(
                _items(slot) * slot.what.probabilities[below] * found[below]
                for slot in model.bears
                for below in slot.kinds
            )
            for name, model in cultivar.organs.items()
        }
    return found


def _items(slot: Slot) -> float:
    """How many items a slot has, on average."""
    each = sum(count * chance for count, chance in slot.count.numbers.items())
    return each * len(slot.at) * (2 if slot.pairs else 1)


def _chance(slot: Slot, name: str, growth: Growth) -> FloatArray | float:
    """Probability of an outcome along the stem; flushes leave it as it is, on average over plants."""
    stated = slot.what.probabilities[name]
    if slot.descent is None or slot.filled == 0:
        return stated
    of = slot.what.probabilities[slot.descent.of] / slot.filled
    more = slot.descent.by.mean * growth.descent(slot)
    if name == slot.descent.of:
        return np.asarray(stated + slot.filled * more)
    return np.asarray(stated * (1.0 - more / (1.0 - of))) if of < 1.0 else stated
