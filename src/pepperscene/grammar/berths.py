"""Where the items of one slot stand on the organs that have it: how many at each place, and how turned."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.cultivar import Distribution, Slot
from pepperscene.grammar.choose import drawn_number
from pepperscene.grammar.hashing import Addresses, FloatArray, descended, shares

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
