"""What grows from what: a plant's organs out of a cultivar's slots, level by level, no sizes yet."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.cultivar import Cultivar, Distribution, Slot
from pepperscene.grammar.growth import Growth, chances, chosen, drawn_number
from pepperscene.grammar.hashing import Addresses, FloatArray, descended, number, shares

Indices = NDArray[np.intp]

# Chosen from photographs: how far what stands at a shoot's end strays from the even fan, in parts of the
# angle between neighbours; one that stands alone strays more.
_STRAY_ALONE: Final = 0.5
_STRAY: Final = 0.125


@dataclass(frozen=True, eq=False)
class Berths:
    """`(m,)` items of one slot of n organs, whatever will grow there.

    Attributes:
        row: which of the organs bears it.
        address: of the item.
        at: its place along the organ, 0 base to 1 tip.
        turned: its azimuth against the slot's, radians.
    """

    row: Indices
    address: Addresses
    at: FloatArray
    turned: FloatArray


def berths(slot: Slot, slots: Addresses, heights: FloatArray) -> Berths:
    """The items of a slot of n organs, organ by organ and from base to tip.

    Args:
        slot: the same of all of them.
        slots: `(n,)` addresses of theirs.
        heights: `(n,)` places of the organs along the stem.
    """
    at = np.array(slot.at)
    places = descended(slots[:, None], np.arange(at.size)).ravel()
    each = drawn_number(slot.count.numbers, shares(places, "count"))
    # Items in turn: number `item` at their place, and `rank` to their side.
    counts = each * (2 if slot.pairs else 1)
    place = np.repeat(np.arange(counts.size), counts)
    item = np.arange(place.size) - np.repeat(np.cumsum(counts) - counts, counts)
    row, spot = np.divmod(place, at.size)
    rank = item // 2 if slot.pairs else item
    address = descended(places[place], item)
    turned = np.zeros(place.size)
    if slot.spread is not None:
        turned += _fanned(slot.spread, places[place], rank, each[place], heights[row])
    if slot.aside is not None:
        # In pairs one goes to either side, otherwise from place to place; the first side is left to chance.
        first = np.where(shares(slots, "side") < 0.5, 1.0, -1.0)[row]
        turns = item if slot.pairs else spot
        angle = slot.aside.quantiles(shares(address, "aside"), heights[row])
        turned += first * np.where(turns % 2 == 0, 1.0, -1.0) * angle
    return Berths(row, address, at[spot], turned)


def _fanned(
    law: Distribution, place: Addresses, rank: Indices, each: Indices, heights: FloatArray
) -> FloatArray:
    """Azimuths of items that share a place: spread evenly, and strayed together from their parent's."""
    from scipy.special import ndtri

    spread = law.quantiles(shares(place, "spread"), heights)
    stray = np.where(each == 1, _STRAY_ALONE, _STRAY) * ndtri(shares(place, "stray"))
    return np.asarray(spread * (rank - 0.5 * (each - 1) + stray))


_MOST: Final = 200_000  # organs, chosen: a hundred times those of a sweet pepper of 200 nodes


@dataclass(frozen=True, eq=False)
class Items:
    """Organs of one kind, `(n,)` each: their addresses, and where they grow as in `KindParameters`.

    Attributes:
        before: `(n, kinds)` how many of each kind that has a depth stand on the way here, it included.
    """

    kind: str
    address: Addresses
    number: Indices
    parent: Indices
    phytomer: Indices
    at: FloatArray
    lift: FloatArray
    azimuth: FloatArray
    sideways: FloatArray
    before: Indices


def expanded(cultivar: Cultivar, growth: Growth) -> list[Items]:
    """All organs but those of the stem; parents are numbered before their children.

    The stem's internodes and nodes are numbers 0 to 2 parts - 1 in turn.

    Raises:
        ValueError: the plant has more organs than a plant can have.
    """
    return _Expansion(cultivar, growth).all()


class _Expansion:
    """The organs of one plant, as far as they have been found."""

    def __init__(self, cultivar: Cultivar, growth: Growth) -> None:
        self.organs, self.growth, self.node = cultivar.organs, growth, cultivar.stem.node
        self.depths = {
            name: model.depth for name, model in cultivar.organs.items() if model.depth is not None
        }
        self.count = 2 * growth.parts

    def all(self) -> list[Items]:
        """Breadth first, so that a level's organs of one kind are drawn together."""
        level, found = list(self._on_nodes()), list[Items]()
        while level:
            found += level
            level = [
                items
                for parents in level
                for index, slot in enumerate(self.organs[parents.kind].bears)
                for items in self._on(parents, slot, index, np.zeros(len(parents.number)))
            ]
        return found

    def _on_nodes(self) -> Iterator[Items]:
        """What the nodes bear, each slot at its azimuth around the stem."""
        addresses, around = self.growth.nodes, dict[str, FloatArray]()
        for index, slot in enumerate(self.organs[self.node].bears):
            bearing = np.flatnonzero(self.growth.bears(slot))
            share = self._around(slot, shares(descended(addresses, index), "azimuth"), around)
            around[slot.name] = share
            azimuth = 2.0 * np.pi * share
            if slot.azimuth is not None:
                azimuth = slot.azimuth.quantiles(share, self.growth.places)
            if bearing.size:
                yield from self._on(self._nodes(bearing), slot, index, azimuth[bearing])

    def _nodes(self, order: Indices) -> Items:
        """Some nodes, as parents."""
        nothing = np.zeros(order.size)
        return Items(
            kind=self.node,
            address=self.growth.nodes[order],
            number=2 * order + 1,
            parent=2 * order,
            phytomer=order,
            at=nothing,
            lift=nothing,
            azimuth=nothing,
            sideways=nothing,
            before=np.zeros((order.size, len(self.depths)), dtype=np.intp),
        )

    def _around(self, slot: Slot, own: FloatArray, others: dict[str, FloatArray]) -> FloatArray:
        """`(parts,)` shares of the slot's azimuth law, uniform at every node whatever the steps."""
        if slot.step is None:
            return own
        step = slot.step.quantiles(own, self.growth.places)
        if slot.after is not None:
            return np.asarray((others[slot.after] + step) % 1.0)
        # From the node below, whether or not anything stands there, and from anywhere at the foot.
        start = shares(descended(self.growth.key, number(slot.name)), "azimuth")
        return np.asarray((start + np.cumsum(step)) % 1.0)

    def _on(self, parents: Items, slot: Slot, index: int, azimuth: FloatArray) -> Iterator[Items]:
        """What slot number `index` of organs of one kind bears, at `(n,)` azimuths, kind by kind."""
        slots = descended(parents.address, index)
        found = berths(slot, slots, self.growth.places[parents.phytomer])
        waves = descended(descended(self.growth.key, number(parents.kind)), index)
        odds = chances(slot, slots, parents.phytomer, self._spent(parents, slot), self.growth, waves)
        outcome = chosen(odds, found.row, shares(found.address, "what"))
        for column, name in enumerate(slot.kinds):
            here = np.flatnonzero(outcome == column)
            if here.size:
                yield self._grown(name, parents, slot, azimuth, found, here)

    def _spent(self, parents: Items, slot: Slot) -> NDArray[np.bool_]:
        """`(n, kinds)` which of a slot's kinds have reached their depth."""
        spent = np.zeros((len(parents.number), len(slot.kinds)), dtype=bool)
        for column, (name, depth) in enumerate(self.depths.items()):
            if name in slot.kinds:
                spent[:, slot.kinds.index(name)] = parents.before[:, column] >= depth
        return spent

    def _grown(
        self, name: str, parents: Items, slot: Slot, azimuth: FloatArray, found: Berths, here: Indices
    ) -> Items:
        """The next organs of a kind, numbered on from those before."""
        row = found.row[here]
        # A fruit's calyx stands just before it.
        width = 2 if getattr(self.organs[name], "calyx", False) else 1
        numbers = self.count + width * np.arange(row.size) + width - 1
        self.count += width * row.size
        if self.count > _MOST:
            raise ValueError(f"the plant grows without end: more than {_MOST} organs with {name}")
        before = parents.before[row]
        if name in self.depths:
            before[:, list(self.depths).index(name)] += 1
        return Items(
            kind=name,
            address=found.address[here],
            number=numbers,
            parent=parents.number[row],
            phytomer=parents.phytomer[row],
            at=found.at[here],
            lift=np.full(row.size, slot.lift),
            azimuth=azimuth[row] + found.turned[here],
            sideways=np.full(row.size, float(slot.aside is not None)),
            before=before,
        )
