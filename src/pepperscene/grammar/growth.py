"""What all organs of a plant share: its key, its nodes, and how far each part has grown."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.cultivar import Cultivar, Descent, Distribution, Slot
from pepperscene.grammar.hashing import Addresses, FloatArray, descended, shares


@dataclass(frozen=True, eq=False)
class Growth:
    """A plant before anything is drawn.

    Attributes:
        key: `(1,)` what all addresses are hashed from.
        sections: `(parts,)` addresses of the internodes, from the ground up.
        nodes: `(parts,)` addresses of the nodes above them.
        sizes: `(parts,)` how large each phytomer has grown: 1 but for the young ones at the top, smaller one
            by one.
        places: `(parts,)` of each phytomer along the grown stem, 0 foot to 1 top; 1 where it is young.
        heights: `(parts,)` of each phytomer along the whole stem.
        grown: how many phytomers are grown.
    """

    key: Addresses
    sections: Addresses
    nodes: Addresses
    sizes: FloatArray
    places: FloatArray
    heights: FloatArray
    grown: int

    @property
    def parts(self) -> int:
        """How many phytomers the stem has."""
        return len(self.sizes)

    def bears(self, slot: Slot) -> NDArray[np.bool_]:
        """`(parts,)` which nodes a slot of theirs is at."""
        order = np.arange(self.parts)
        return np.asarray((order >= slot.first) & ((order - slot.first) % slot.every == 0))

    def descent(self, slot: Slot) -> FloatArray:
        """`(parts,)` a straight fall from 1 to -1 along the nodes that a slot is at, of mean 0."""
        here = self.bears(slot)
        return np.where(here, 1.0 - (2.0 * np.cumsum(here) - 1.0) / max(int(here.sum()), 1), 0.0)

    def once(self, law: Distribution, name: str) -> float:
        """A value that the plant has once; the law must not be a curve along the stem."""
        return float(law.quantiles(shares(self.key, name))[0])


def growth_of(cultivar: Cultivar, key: Addresses) -> Growth:
    """The phytomers of a plant of this key."""
    stem = cultivar.stem
    grown = max(stem.parts - stem.young_nodes, 0)
    order = np.arange(stem.parts)
    # The topmost has the smallest size, and below the young ones all are grown.
    from_top = order[::-1]
    young = from_top < stem.young_nodes
    sizes = np.ones(stem.parts)
    rise = (1.0 - stem.young_size) * from_top / max(stem.young_nodes, 1)
    sizes[young] = (stem.young_size + rise)[young]
    places = np.minimum((order + 0.5) / max(grown, 1), 1.0)
    return Growth(
        key=key,
        sections=descended(key, 2 * order),
        nodes=descended(key, 2 * order + 1),
        sizes=sizes,
        places=places,
        heights=(order + 0.5) / stem.parts,
        grown=grown,
    )


Indices = NDArray[np.intp]
NOTHING: Final = -1
_ROUNDING: Final = 1e-9  # a probability of nothing below this is no more than rounding


def outcomes(slot: Slot) -> tuple[tuple[str, ...], FloatArray]:
    """`(k,)` kinds that a slot can bear, and their probabilities; what is missing to 1 is nothing."""
    kinds = slot.kinds
    stated = np.array([slot.what.probabilities[kind] for kind in kinds])
    # People write probabilities with few digits.
    return kinds, stated / sum(slot.what.probabilities.values())


def chances(
    slot: Slot,
    slots: Addresses,
    phytomers: Indices,
    spent: NDArray[np.bool_],
    growth: Growth,
    flushing: Addresses,
) -> FloatArray:
    """`(n, k + 1)` probability of each kind, and last of nothing, at the same slot of n organs.

    Args:
        slot: which is theirs.
        slots: `(n,)` addresses of theirs.
        phytomers: `(n,)` where they stand.
        spent: `(n, k)` whether a kind has reached its depth there.
        growth: the plant's.
        flushing: `(1,)` address of the slot's waves in this plant.
    """
    _, stated = outcomes(slot)
    filled = stated.sum()
    found = np.empty((len(slots), len(stated) + 1))
    found[:, :-1] = stated
    if slot.descent is not None and filled > 0:
        more = slot.descent.by.quantiles(shares(slots, "descent"), growth.heights[phytomers])
        _descend(found, slot, slot.descent, more * growth.descent(slot)[phytomers])
    if slot.flush is not None:
        # The phase is uniform, so that the mean stays.
        period = max(float(slot.flush.nodes.quantiles(shares(flushing, "nodes"))[0]), 1e-3)
        phase = shares(flushing, "phase")[0]
        wave = np.cos(2.0 * np.pi * (phytomers / period + phase))
        strength = slot.flush.strength.quantiles(shares(slots, "strength"), growth.places[phytomers])
        swing = 1.0 + strength * wave
        found[:, :-1] *= np.clip(swing, 0.0, 1.0 / filled if filled > 0 else 1.0)[:, None]
    rest = 1.0 - found[:, :-1].sum(axis=1)
    found[:, -1] = np.where(rest > _ROUNDING, rest, 0.0)
    found[:, :-1][spent] = 0.0
    return found


def _descend(found: FloatArray, slot: Slot, descent: Descent, more: FloatArray) -> None:
    """Add `(n,)` to one outcome's share of all that grows."""
    kinds, stated = outcomes(slot)
    one, filled = kinds.index(descent.of), stated.sum()
    mean = stated[one] / filled
    here = np.clip(mean + more, 0.0, 1.0)
    if mean < 1.0:
        found[:, :-1] *= ((1.0 - here) / (1.0 - mean))[:, None]
        found[:, one] = here * filled


def chosen(probabilities: FloatArray, rows: Indices, share: FloatArray) -> Indices:
    """`(m,)` index of one outcome each, by a share of its row of probabilities; the last one is `NOTHING`.

    The probabilities of a row need not sum to 1: they count by their proportion.
    """
    cumulated = np.cumsum(probabilities, axis=1)
    total = cumulated[:, -1]
    cumulated /= np.where(total > 0, total, 1.0)[:, None]
    found = (share[:, None] >= cumulated[rows]).sum(axis=1)
    return np.where(found < probabilities.shape[1] - 1, found, NOTHING)


def drawn_number(numbers: dict[int, float], share: FloatArray) -> Indices:
    """How many, by shares of any shape."""
    cumulated = np.cumsum(list(numbers.values()))
    index = np.searchsorted(cumulated / cumulated[-1], share, side="right")
    return np.array(list(numbers), dtype=np.intp)[index]


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
