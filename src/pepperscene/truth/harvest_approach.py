"""From where a tool comes to a fruit: with the stem right behind it.

The harvest robots of Wageningen reach for a sweet pepper in the horizontal plane, on the line through the
fruit's and the stem's centres: so the stem lies behind the fruit, and the cutter passes between the two.
Barth, Hemming & van Henten 2019 ("Angle estimation between plant parts for grasp optimisation in harvest
robots", Biosystems Engineering 183, 26-46) estimate that angle between fruit and stem from colour images;
their tool allows 25 degrees of error.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

_NEAREST: Final = 1e-3  # chosen: metres between fruit and stem axis below which no side is in front


@dataclass(frozen=True, eq=False)
class Approach:
    """The way to a fruit.

    Attributes:
        direction: `(3,)` horizontal unit vector in the world, the way that the tool moves: from the fruit's
            centre to the stem.
        stem: `(3,)` world metres, the stem's centre at the fruit's height.
    """

    direction: FloatArray
    stem: FloatArray

    def azimuth(self, pose: FloatArray) -> float:
        """Radians from a camera's optical axis to the direction, both seen from above; positive to its right.

        0 where the camera itself looks with the stem behind the fruit. For a camera that looks straight up or
        down, its upper side of the picture takes the place of the axis.
        """
        ahead = pose[:3, 2] if np.hypot(*pose[:2, 2]) > 1e-6 else -pose[:3, 1]
        cross = ahead[0] * self.direction[1] - ahead[1] * self.direction[0]
        return float(-np.arctan2(cross, ahead[:2] @ self.direction[:2]))


def approach(centre: FloatArray, stem: FloatArray) -> Approach | None:
    """The way to a fruit; None where its centre lies on the stem's axis.

    Args:
        centre: `(3,)` of the fruit, world metres.
        stem: `(k, 3)` axis of the plant's main stem from the ground up.
    """
    point = _at_height(stem, centre)
    level = (point - centre) * [1.0, 1.0, 0.0]
    distance = float(np.linalg.norm(level))
    return Approach(level / distance, point) if distance > _NEAREST else None


def _at_height(line: FloatArray, centre: FloatArray) -> FloatArray:
    """`(3,)` where a line passes the height of a point, nearest to it; else the nearer end of the line."""
    low, high = line[:-1], line[1:]
    rise = high[:, 2] - low[:, 2]
    part = (centre[2] - low[:, 2]) / np.where(rise == 0.0, np.inf, rise)
    passing = np.flatnonzero((part >= 0.0) & (part <= 1.0) & (rise != 0.0))
    if not passing.size:
        ends = line[[0, -1]]
        return np.asarray(ends[np.abs(ends[:, 2] - centre[2]).argmin()])
    points = low[passing] + part[passing, None] * (high - low)[passing]
    return np.asarray(points[np.linalg.norm((points - centre)[:, :2], axis=1).argmin()])
