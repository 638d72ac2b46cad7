"""Contents at moved states, as a smooth function of how far they are moved.

A path is linear between its knots and ends at 0 and 1, so contents read off at a moved state have a kink
wherever that state passes a knot or an end; all of them do at the recipe's own values, where nothing is moved
yet. There derivatives would be those of one side. Contents are therefore taken from the path averaged over a
short interval, which has none, and the little by which the average differs from the path at a state that is
not moved fades out as it moves.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

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
