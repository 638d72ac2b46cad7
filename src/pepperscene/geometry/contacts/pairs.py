"""How deep organs that turn reach into fruit and stems, for many organs and turns in one go.

Boxes around organs first, then balls around patches, then points: each leaves little for the next.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.geometry.contacts.detect import NEAR, ContactBodies
from pepperscene.geometry.contacts.organs import Indices, Organs, Points, Vectors
from pepperscene.geometry.contacts.samples import counted
from pepperscene.geometry.contacts.stems import Capsules, deepest

ENTRIES: Final = 1 << 16
"""So many distances are worked out at a time, chosen: what fits into a cache."""


@dataclass(frozen=True, eq=False)
class Turns:
    """Turns of some units: every point p goes to rotation @ p + shift.

    Attributes:
        rotation: `(u, k, 3, 3)` of each unit.
        shift: `(u, k, 3)` metres.
    """

    rotation: Vectors
    shift: Vectors

    def with_their_inverses(self) -> Turns:
        """`(2 u, k)` turns, and after them what undoes them: to turn a fruit is to turn all else back."""
        back = self.rotation.swapaxes(2, 3)
        undone = -np.einsum("ukij,ukj->uki", back, self.shift)
        return Turns(np.concatenate([self.rotation, back]), np.concatenate([self.shift, undone]))


class FruitPairs:
    """Organs that move towards fruit.

    Args:
        bodies: the organs as they stand.
        movers: `(n,)` organs that turn.
        fruit: `(n,)` what each moves towards.
    """

    def __init__(self, bodies: ContactBodies, movers: Indices, fruit: Indices) -> None:
        self._bodies, self._movers = bodies, movers
        self._balls = bodies.walls.bodies(fruit)

    def __len__(self) -> int:
        return len(self._movers)

    def depths(self, rows: Indices, turn: Indices, turns: Turns, every: int) -> NDArray[np.float32]:
        """`(r, k)` metres that some organs reach into their fruit; minus infinity where far apart.

        Args:
            rows: `(r,)` which pairs.
            turn: `(r,)` by which turns each organ moves.
            turns: `(t, k)`.
            every: look at every so-manieth point.
        """
        found = np.full((len(rows), turns.shift.shape[1]), -np.inf, dtype=np.float32)
        balls, movers = self._balls, self._movers[rows]
        centre, reach = balls.centre[rows], balls.reach[rows] + NEAR
        turned = balls.turned.transpose(0, 2, 1)[rows]
        for pair, way, hit, patch in _near(self._bodies.organs, movers, centre, reach, turn, turns):
            # Told from the fruit's centre numbers are small, as single ones must be.
            own, by = turned[pair], turn[pair]
            matrix = np.matmul(own, turns.rotation[by, way])
            offset = np.matmul(own, (turns.shift[by, way] - centre[pair])[:, :, None])[:, :, 0]
            depth = self._bodies.walls.depth(
                balls.row[rows[pair]][hit],
                self._bodies.organs.laid.coordinates(patch, every),
                matrix.transpose(1, 2, 0).astype(np.float32, order="C").take(hit, axis=2),
                offset.T.astype(np.float32, order="C").take(hit, axis=1),
                reach.astype(np.float32)[pair][hit],
            )
            np.maximum.at(found, (pair[hit], way[hit]), depth)
        return found


class StemPairs:
    """Blades that move towards stems and cords.

    Args:
        bodies: the organs as they stand.
        blades: `(n,)` that turn.
        stems: `(n,)` what each moves towards.
        low: `(n, 3)` and
        high: `(n, 3)` metres, the corners of boxes that the blades stay in.
    """

    def __init__(
        self, bodies: ContactBodies, blades: Indices, stems: Indices, low: Vectors, high: Vectors
    ) -> None:
        self._bodies, self._blades = bodies, blades
        chain, piece, pair = bodies.chains.pieces(stems)
        met = (chain.low[piece] < high[pair]).all(axis=1) & (chain.high[piece] > low[pair]).all(axis=1)
        kept = np.flatnonzero(met)
        self._chain, self._pair = chain.some(piece[kept]), pair[kept]

    def __len__(self) -> int:
        return len(self._blades)

    def depths(self, rows: Indices, turn: Indices, turns: Turns, every: int) -> NDArray[np.float32]:
        """`(r, k)` metres that some blades reach into their stems; minus infinity where far apart.

        Args:
            rows: `(r,)` which pairs, ascending.
            turn: `(r,)` by which turns each blade moves.
            turns: `(t, k)`.
            every: look at every so-manieth point.
        """
        found = np.full((len(rows), turns.shift.shape[1]), -np.inf, dtype=np.float32)
        place = np.full(len(self), -1)
        place[rows] = np.arange(len(rows))
        kept = np.flatnonzero(place[self._pair] >= 0)
        entry, chain = place[self._pair[kept]], self._chain.some(kept)
        middle = chain.start + 0.5 * chain.span
        reach = chain.radius + 0.5 * np.sqrt(np.einsum("ci,ci->c", chain.span, chain.span)) + NEAR
        blades, turn = self._blades[rows][entry], turn[entry]
        for piece, way, hit, patch in _near(self._bodies.organs, blades, middle, reach, turn, turns):
            # To move blades towards stems is to move stems back towards blades.
            back = turns.rotation[turn[piece], way]
            start = chain.start[piece] - turns.shift[turn[piece], way]
            moved = Capsules(
                np.matmul(start[:, None], back)[:, 0],
                np.matmul(chain.span[piece][:, None], back)[:, 0],
                chain.radius[piece],
            )
            depth = deepest(self._bodies.organs.laid.coordinates(patch, every), moved, hit)
            np.maximum.at(found, (entry[piece[hit]], way[hit]), depth)
        return found


def _near(
    organs: Organs, movers: Indices, centre: Vectors, reach: Vectors, turn: Indices, turns: Turns
) -> Iterator[tuple[Indices, Indices, Indices, Indices]]:
    """Patches of organs that come near to balls.

    Yields:
        `(h,)` pairs of organ and ball and `(h,)` the way on which they meet; `(m,)` the place of each patch's
        pair among these, and `(m,)` the patches.
    """
    if not len(movers):
        return
    ways = turns.shift.shape[1]
    low, high = organs.low[movers].astype(np.float32), organs.high[movers].astype(np.float32)
    rotation, shift = turns.rotation.astype(np.float32), turns.shift.astype(np.float32)
    single, far = centre.astype(np.float32), reach.astype(np.float32)
    pairs, balls, on = [], [], []
    for start in range(0, len(movers), max(ENTRIES // (4 * ways), 1)):
        block = slice(start, start + max(ENTRIES // (4 * ways), 1))
        # To move organs towards balls is to move balls back to the organs.
        target = _back(single[block], turn[block], rotation, shift)
        off = np.zeros(target.shape[1:], dtype=np.float32)
        for axis in range(3):
            least, most = low[block, axis, None], high[block, axis, None]
            beside = target[axis] - np.clip(target[axis], least, most)
            off += beside * beside
        pair, way = np.nonzero(off < np.square(far[block])[:, None])
        balls.append(target[:, pair, way])
        pairs.append(pair + start)
        on.append(way)
    pair, way, ball = np.concatenate(pairs), np.concatenate(on), np.concatenate(balls, axis=1)
    # Only now, so that none is laid on what comes near to nothing.
    organs.sample(movers[np.unique(pair)])
    count = organs.patch_count[movers[pair]]
    for part in _runs(count):
        hit, number = counted(count[part])
        patch = organs.patch_first[movers[pair[part]]][hit] + number
        apart = far.take(pair[part]).take(hit) + organs.laid.radius.take(patch)
        square = np.zeros(len(patch), dtype=np.float32)
        for axis in range(3):
            beside = organs.laid.centre[:, axis].take(patch) - ball[axis, part].take(hit)
            square += beside * beside
        kept = np.flatnonzero(square < apart * apart)
        if len(kept):
            yield pair[part], way[part], hit[kept], patch[kept]


def _back(centre: Points, turn: Indices, rotation: Points, shift: Points) -> Points:
    """`(3, n, k)` where turns bring centres `(n, 3)` from."""
    x, y, z = (centre[:, axis, None] - shift[turn, :, axis] for axis in range(3))
    r = rotation.transpose(2, 3, 0, 1)
    return np.stack([x * r[0, i][turn] + y * r[1, i][turn] + z * r[2, i][turn] for i in range(3)])


def _runs(sizes: Indices) -> Iterator[slice]:
    """Runs of things whose sizes add up to what is worked out at a time."""
    total, start = np.cumsum(sizes), 0
    while start < len(sizes):
        done = total[start - 1] if start else 0
        stop = max(int(np.searchsorted(total, done + ENTRIES, side="right")), start + 1)
        yield slice(start, stop)
        start = stop
