"""Which outcome of a slot grows: probabilities swing with the place along the stem, and end at a depth."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.cultivar import Descent, Slot
from pepperscene.grammar.growth import Growth
from pepperscene.grammar.hashing import Addresses, FloatArray, shares

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
