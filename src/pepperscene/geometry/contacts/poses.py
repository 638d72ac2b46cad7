"""Poses that units might take, and which of them cost least with all that they run into."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np

from pepperscene.geometry.contacts.cost import ContactCosts
from pepperscene.geometry.contacts.joints import Joint
from pepperscene.geometry.contacts.organs import Indices, Vectors
from pepperscene.geometry.contacts.pairs import Turns

# Chosen: while poses are compared by all that they run into, one of so many points is looked at.
_EVERY: Final = 4
_FIRST: Final = 4  # chosen: of the cheapest, those that are looked at first
_SMALL: Final = 20.0  # weighted degrees, chosen: a turn that is taken without asking what else could turn
_PARTS: Final = np.array([0.0, 0.2, 0.4, 0.55, 0.7, 0.8, 0.9, 1.0])  # chosen: shares of a turn


@dataclass(frozen=True, eq=False)
class Poses:
    """Poses that some units might take, each alone; the first of each is how it stands.

    Attributes:
        angles: `(u, k, 2)` radians.
        spent: `(u, 1, 2)` radians at which the units stand.
        weights: `(u, 1, 2)` how much a degree of either turn weighs.
        effort: `(u, k)`, in weighted degrees.
        left: `(u, k)` cost of what is left of the contacts at hand.
        way: how the units turn.
    """

    angles: Vectors
    spent: Vectors
    weights: Vectors
    effort: Vectors
    left: Vectors
    way: Joint

    def turns(self, angles: Vectors) -> Turns:
        """The turns that lead to angles `(u, k, 2)`."""
        return Turns(*self.way.turns(angles - self.spent))

    def cheapest(self, rows: Indices, count: int) -> Poses:
        """Of some units the poses that cost least at the least, the cheapest first, behind how they stand."""
        least = (self.effort + self.left)[rows]
        order = 1 + np.argsort(least[:, 1:], axis=1, kind="stable")[:, :count]
        order = np.concatenate([np.zeros((len(rows), 1), dtype=np.intp), order], axis=1)
        return Poses(
            np.take_along_axis(self.angles[rows], order[:, :, None], axis=1),
            self.spent[rows],
            self.weights[rows],
            np.take_along_axis(self.effort[rows], order, axis=1),
            np.take_along_axis(self.left[rows], order, axis=1),
            self.way.some(rows),
        )

    def cost(self, around: ContactCosts) -> Vectors:
        """`(u, k)` cost with all that the units run into; infinite where it cannot be the least of a unit."""
        turns, cost = self.turns(self.angles), self.effort + self.left
        # A few at first, as one of these may be free.
        first = np.arange(min(1 + _FIRST, cost.shape[1]))
        rest = np.append(0, np.arange(len(first), cost.shape[1]))
        unclear = np.arange(len(cost))
        for columns in (first, rest):
            some = np.ix_(unclear, columns)
            into = around.cost(unclear, Turns(turns.rotation[some], turns.shift[some]), _EVERY)
            cost[some] = self.effort[some] + np.maximum(self.left[some], into)
            if columns is first and len(rest) > 1:
                # What is dearer at the least than what was found need not be looked at.
                clear = cost[:, first].min(axis=1) <= cost[:, len(first)]
                cost[np.ix_(clear, rest[1:])] = np.inf
                unclear = np.flatnonzero(~clear)
        return np.asarray(cost)

    def shortened(
        self, around: ContactCosts, rows: Indices, picked: Indices
    ) -> Iterator[tuple[int, tuple[float, Vectors, bool]]]:
        """Of some units' poses that help the part that does best: gain, angles, and whether it is small and
        free.
        """
        # Now every point counts.
        spent, weights = self.spent[rows], self.weights[rows]
        parts = spent + _PARTS[:, None] * (self.angles[rows, picked][:, None] - spent)
        spent_effort = effort(parts, weights)
        cost = spent_effort + around.cost(rows, Turns(*self.way.some(rows).turns(parts - spent)), 1)
        for row, (one, pick) in enumerate(zip(rows.tolist(), cost.argmin(axis=1).tolist(), strict=True)):
            small = cost[row, pick] == spent_effort[row, pick] < _SMALL
            yield one, (float(cost[row, 0] - cost[row, pick]), parts[row, pick], bool(small))


def effort(angles: Vectors, weights: Vectors) -> Vectors:
    """`(u, k)` how far angles `(u, k, 2)` radians are from none, in weighted degrees."""
    return np.asarray(np.sqrt(np.square(np.degrees(angles) * weights).sum(axis=-1)))


def disc(count: int, phase: Vectors) -> Vectors:
    """`(u, count, 2)` points evenly over unit discs, from the middle outwards, turned by `(u,)` radians."""
    step = np.arange(count) + 0.5
    angle = phase[:, None] + np.pi * (3.0 - np.sqrt(5.0)) * step
    return np.asarray((step / count)[:, None] ** 0.7 * np.stack([np.cos(angle), np.sin(angle)], axis=2))
