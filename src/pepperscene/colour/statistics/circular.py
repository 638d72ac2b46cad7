"""Statistics of angles: mean, spread, median, and how far one distribution on the circle is from another.

Hue is an angle: 359 and 1 degrees are neighbours, and their mean is 0, not 180. After Fisher 1993,
"Statistical analysis of circular data", chapters 2 and 3. All angles are degrees; all functions turn with
their input, so that adding the same angle to all changes no spread and no distance.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

Floats = NDArray[np.float64]

_NOTHING: Final = 1e-12
"""Share of the weights below which a resultant is what rounding leaves of none."""


def bin_angles(bins: int) -> Floats:
    """`(bins,)` middles of even bins around the circle, degrees; the first is 0, as in a hue spectrum."""
    return np.asarray(np.arange(bins) * (360.0 / bins), float)


def circular_mean(angle_deg: ArrayLike, weight: ArrayLike | None = None) -> float:
    """Mean direction, degrees in [0, 360); nan where the angles have none.

    Args:
        angle_deg: `(n,)`.
        weight: `(n,)`, not below 0; None counts all the same.
    """
    total, weights = _resultant(angle_deg, weight)
    if abs(total) <= _NOTHING * weights:
        return float("nan")
    return float(np.degrees(np.angle(total)) % 360.0)


def resultant_length(angle_deg: ArrayLike, weight: ArrayLike | None = None) -> float:
    """Length of the mean of the angles' unit vectors: 1 all the same, 0 no direction; nan without angles."""
    total, weights = _resultant(angle_deg, weight)
    return float(min(abs(total) / weights, 1.0)) if weights > 0.0 else float("nan")


def circular_sd(angle_deg: ArrayLike, weight: ArrayLike | None = None) -> float:
    """Circular standard deviation, degrees: sqrt(-2 ln R); infinite where the angles have no direction."""
    length = resultant_length(angle_deg, weight)
    with np.errstate(divide="ignore"):
        return float(np.degrees(np.sqrt(-2.0 * np.log(length))))


def concentration(length: float) -> float:
    """Concentration kappa of the von Mises distribution with this resultant length; inf for a length of 1.

    The maximum of its likelihood: where the ratio of the Bessel functions I1 and I0 is the length.
    """
    from scipy.optimize import brentq
    from scipy.special import i0e, i1e

    if not 0.0 <= length < 1.0:
        return float("inf") if length == 1.0 else float("nan")
    # The approximation of Banerjee et al. 2005 (J. Mach. Learn. Res. 6:1345) is right within a factor of 2.
    near = length * (2.0 - length**2) / (1.0 - length**2)
    if length < 1e-6 or near > 1e6:  # the approximation's own limits, beyond which rounding rules the ratio
        return float(near)
    return float(brentq(lambda kappa: i1e(kappa) / i0e(kappa) - length, near / 2.0, 2.0 * near))


def circular_median(angle_deg: ArrayLike, weight: ArrayLike | None = None) -> float:
    """The angle with the least mean arc to all others, degrees in [0, 360); nan without angles.

    Where several of the angles are equally good (an even number of them), their mean direction.
    """
    angles, weights = _weighted(angle_deg, weight)
    candidates, place = np.unique(np.round(angles % 360.0, 9) % 360.0, return_inverse=True)
    shares = np.bincount(place, weights, minlength=candidates.size)
    candidates, shares = candidates[shares > 0.0], shares[shares > 0.0]
    if candidates.size == 0:
        return float("nan")
    arcs = np.array([float(_arc(candidates - candidate) @ shares) for candidate in candidates])
    best = arcs <= arcs.min() + 360.0 * _NOTHING * shares.sum()
    return circular_mean(candidates[best])


def circular_emd(one: ArrayLike, other: ArrayLike) -> float:
    """Earth mover's distance of two distributions over the same even bins of the circle, degrees.

    How far the one must be turned into the other's shape, per unit of mass, along the shorter arcs: the sum
    of the distances of the cumulated difference from its median (Rabin, Delon & Gousseau 2011,
    "Transportation distances on the circle", J. Math. Imaging Vis. 41:147). At most 180; nan where one is
    empty.

    Args:
        one: `(bins,)`, not below 0; of any sum, as both are brought to 1.
        other: `(bins,)`.

    Raises:
        ValueError: the two differ in size, or a value is below 0.
    """
    p, q = np.asarray(one, float), np.asarray(other, float)
    if p.ndim != 1 or p.shape != q.shape:
        raise ValueError(f"distributions must be two lists of one length, not {p.shape} and {q.shape}")
    if (p < 0.0).any() or (q < 0.0).any():
        raise ValueError("distributions must not be below 0")
    if not (p.sum() > 0.0 and q.sum() > 0.0):
        return float("nan")
    moved = np.cumsum(p / p.sum() - q / q.sum())
    return float(np.abs(moved - np.median(moved)).sum() * (360.0 / p.size))


def _resultant(angle_deg: ArrayLike, weight: ArrayLike | None) -> tuple[complex, float]:
    """Sum of the weighted unit vectors, and that of the weights."""
    angles, weights = _weighted(angle_deg, weight)
    return complex(np.sum(weights * np.exp(1j * np.radians(angles % 360.0)))), float(weights.sum())


def _weighted(angle_deg: ArrayLike, weight: ArrayLike | None) -> tuple[Floats, Floats]:
    angles = np.asarray(angle_deg, float).ravel()
    weights = np.ones_like(angles) if weight is None else np.asarray(weight, float).ravel()
    if weights.shape != angles.shape or not (weights >= 0.0).all():
        raise ValueError(f"{angles.size} angles need as many weights that are not below 0")
    return angles, weights


def _arc(difference_deg: NDArray[np.floating[Any]]) -> Floats:
    """The shorter way around, 0 to 180 degrees."""
    return np.asarray(np.abs((difference_deg + 180.0) % 360.0 - 180.0))
