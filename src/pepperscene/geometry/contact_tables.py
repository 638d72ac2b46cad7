"""How deep organs that turn reach into fruit and stems: balls around patches first, then points."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pepperscene.geometry.contact import NEAR, Bodies
from pepperscene.geometry.contact_organs import Indices, Vectors
from pepperscene.geometry.contact_stems import deepest


class FruitTable:
    """Organs that move towards fruit.

    Args:
        bodies: the organs as they stand.
        movers: `(n,)` organs that turn.
        fruit: `(f,)` that stay.
        meets: `(n, f)` which pairs are looked at.
    """

    def __init__(self, bodies: Bodies, movers: Indices, fruit: Indices, meets: NDArray[np.bool_]) -> None:
        self._walls = bodies.walls
        self._balls = bodies.walls.bodies(fruit.tolist())
        self._laid, self._patch, self._place = bodies.organs.patches(movers.tolist())
        self._centre, self._radius = self._laid.centre[self._patch], self._laid.radius[self._patch]
        self._reach = self._balls.reach + NEAR
        self._shape = meets.shape
        # How near the ball of a patch may come.
        self._close = np.where(meets[self._place], self._reach + self._radius[:, None], 0.0)

    def depths(self, rotation: Vectors, shift: Vectors, every: int) -> NDArray[np.float32]:
        """`(n, f, k)` metres that organs reach into fruit after turns; minus infinity where far apart."""
        balls, reach, ways = self._balls, self._reach, len(rotation)
        found = np.full((*self._shape, ways), -np.inf, dtype=np.float32)
        # To move patches towards fruit is to move the balls around fruit back to the patches.
        target = np.matmul(balls.centre - shift[:, None], rotation).transpose(1, 0, 2).reshape(-1, 3)
        middle = target.mean(axis=0)
        target = (target - middle).astype(np.float32)
        spread = np.sqrt(np.einsum("ti,ti->t", target, target).max())
        centre = self._centre - middle.astype(np.float32)
        off = np.einsum("pi,pi->p", centre, centre)
        kept = np.flatnonzero(off < np.square(self._radius + np.float32(spread + reach.max())))
        if not len(kept):
            return found
        # |c - t|^2 written out, so that only (p, t) arrays are made.
        square = centre[kept] @ (-2.0 * target.T)
        square += np.einsum("ti,ti->t", target, target)
        close = np.square(self._close[kept]) - off[kept, None]
        close[self._close[kept] == 0.0] = -np.inf
        near = square.reshape(len(kept), -1, ways) < close[:, :, None].astype(np.float32)
        row, body, way = np.nonzero(near)
        if not len(row):
            return found
        row = kept[row]
        # Into the fruit's own coordinates, from its centre; numbers are small there, as single ones must be.
        matrix = np.matmul(balls.turned.transpose(0, 2, 1)[:, None], rotation).astype(np.float32)
        offset = np.matmul(shift - balls.centre[:, None], balls.turned).astype(np.float32)
        depth = self._walls.depth(
            balls.row[body],
            self._laid.points[self._patch[row], ::every],
            matrix[body, way],
            offset[body, way],
            reach[body].astype(np.float32),
        )
        np.maximum.at(found, (self._place[row], body, way), depth)
        return found


class StemTable:
    """Blades that move towards stems and cords.

    Args:
        bodies: the organs as they stand.
        blades: `(n,)` that turn.
        stems: `(m,)` that stay.
        meets: `(n, m)` which pairs are looked at.
    """

    def __init__(self, bodies: Bodies, blades: Indices, stems: Indices, meets: NDArray[np.bool_]) -> None:
        chain, self._piece, self._tube = bodies.chains.pieces(stems)
        self._low, self._high = chain.low[self._piece], chain.high[self._piece]
        self._chain = chain
        self._laid, self._patch, self._place = bodies.organs.patches(blades.tolist())
        self._centre, self._radius = self._laid.centre[self._patch], self._laid.radius[self._patch]
        self._meets = meets

    def depths(self, rotation: Vectors, shift: Vectors, every: int) -> NDArray[np.float32]:
        """`(n, m, k)` metres that blades reach into stems after turns; minus infinity where far apart."""
        found = np.full((*self._meets.shape, len(rotation)), -np.inf, dtype=np.float32)
        back, shift = rotation.transpose(0, 2, 1).astype(np.float32), shift.astype(np.float32)
        gone = (np.matmul(self._centre, back) + shift[:, None]).reshape(-1, 3)
        # Most of a blade is not near a stem, and most of a stem not near a blade.
        wide = self._radius.max() + NEAR
        low, high = gone.min(axis=0) - wide, gone.max(axis=0) + wide
        kept = np.flatnonzero(((self._low < high) & (self._high > low)).all(axis=1))
        if not len(kept):
            return found
        low, high = self._low[kept].min(axis=0) - wide, self._high[kept].max(axis=0) + wide
        close = np.flatnonzero(((gone > low) & (gone < high)).all(axis=1))
        way, row = np.divmod(close, len(self._patch))
        local, tube = self._chain.some(self._piece[kept]), self._tube[kept]
        near = local.depth(gone[close]) > -NEAR - self._radius[row][:, None]
        near &= self._meets[self._place[row]][:, tube]
        entry, part = np.nonzero(near)
        if not len(entry):
            return found
        way, row = way[entry], row[entry]
        moved = np.matmul(self._laid.points[self._patch[row], ::every], back[way])
        moved += shift[way][:, None]
        np.maximum.at(found, (self._place[row], tube[part], way), deepest(moved, local, part))
        return found
