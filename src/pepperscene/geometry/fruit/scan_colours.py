"""Colours of a scanned surface on the points that it has after simplification and cleaning."""

from __future__ import annotations

import numpy as np

from pepperscene.geometry.mesh import FloatArray, SingleArray


def transfer_colours(points: FloatArray, scanned: FloatArray, colours: FloatArray) -> SingleArray:
    """Return `(v, 3)` colours of points: the mean of those of the scanned points nearest to each.

    A point that is nearest to none, such as the centre of a closed hole, has the colour of the scanned point
    nearest to it.

    Args:
        points: `(v, 3)` in the coordinates of the scanned ones.
        scanned: `(n, 3)`.
        colours: `(n, 3)` of the scanned points, linear.
    """
    from scipy.spatial import KDTree

    _, owner = KDTree(points).query(scanned)
    count = np.bincount(owner, minlength=len(points))
    total = [np.bincount(owner, channel, minlength=len(points)) for channel in colours.T]
    result = np.stack(total, axis=1) / np.maximum(count, 1)[:, None]
    alone = count == 0
    if alone.any():
        _, nearest = KDTree(scanned).query(points[alone])
        result[alone] = colours[nearest]
    return result.astype(np.float32)
