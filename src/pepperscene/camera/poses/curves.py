"""A smooth curve through points, parameterised by its arc length."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from scipy.interpolate import CubicSpline

Array = NDArray[np.float64]

_PARTS: Final = 32
"""Parts of a span between two points for the arc length. Chosen: with 8 Gauss points in each, the length of
curves that are not refused is exact to 1e-8, also in hairpin bends."""
_GAUSS_POINTS: Final = 8
_NEWTON_STEPS: Final = 60  # chosen: about 4 are needed; as many halvings of the interval reach rounding
_LEAST_CHORD: Final = 1e-9
"""Least distance of two neighbouring points over the length of the path. Chosen: parts of shorter spans
vanish in the rounding of the arc length."""
_LEAST_RATE: Final = 1e-3
"""Least |dr/du|, which is near 1 for a parameter u of chord lengths. Chosen: a curve that is slower there
turns within a thousandth of a span, which no camera follows at constant speed."""


@dataclass(frozen=True, eq=False)
class SmoothCurve:
    """A cubic spline through points, with a constant rate along its arc length.

    Attributes:
        knots: `(k,)` parameter of the points: the sum of chord lengths, metres.
        spline: position `(..., 3)` against the parameter.
        nodes: `(m,)` ends of the parts whose length is tabulated.
        lengths: `(m,)` arc length up to each node, metres.
    """

    knots: Array
    spline: CubicSpline
    nodes: Array
    lengths: Array

    @property
    def length_m(self) -> float:
        """Arc length of the whole curve."""
        return float(self.lengths[-1])

    def parameter_at(self, arc_length_m: Array) -> Array:
        """Parameter `(n,)` at arc lengths `(n,)` from the start; Newton's method, kept inside a bracket."""
        goal = np.clip(arc_length_m, 0.0, self.length_m)
        part = np.clip(np.searchsorted(self.lengths, goal, side="right") - 1, 0, len(self.nodes) - 2)
        start, low, high = self.nodes[part], self.nodes[part], self.nodes[part + 1]
        rest = goal - self.lengths[part]
        fraction = rest / (self.lengths[part + 1] - self.lengths[part])
        parameter = low + fraction * (high - low)
        for _ in range(_NEWTON_STEPS):
            error = _arc_length(self.spline, start, parameter) - rest
            if np.abs(error).max() <= 1e-13 * self.length_m:
                break
            low, high = np.where(error < 0, parameter, low), np.where(error > 0, parameter, high)
            step = parameter - error / np.linalg.norm(self.spline(parameter, 1), axis=-1)
            parameter = np.where((step >= low) & (step <= high), step, (low + high) / 2)
        return parameter


def curve_through(points_m: Array) -> SmoothCurve:
    """A curve through points `(k, 3)`; if the last is the first, it is closed and smooth there too.

    A cubic spline with continuous second derivatives over the chord length. Its ends are free of curvature:
    otherwise it swings out by several spans where points are unevenly spaced.

    Raises:
        ValueError: fewer than two points, two neighbours are (nearly) equal, or the curve turns back on
            itself.
    """
    from scipy.interpolate import CubicSpline

    if points_m.ndim != 2 or points_m.shape[1] != 3 or len(points_m) < 2 or not np.isfinite(points_m).all():
        raise ValueError("the points of a path must be at least two, with three finite coordinates each")
    chords = np.linalg.norm(np.diff(points_m, axis=0), axis=1)
    if not chords.min() > _LEAST_CHORD * chords.sum():
        number = int(np.argmin(chords)) + 1
        raise ValueError(f"points {number} and {number + 1} are equal, or nearly so")
    knots = np.concatenate([[0.0], np.cumsum(chords)])
    is_closed = len(points_m) > 2 and np.array_equal(points_m[0], points_m[-1])
    spline = CubicSpline(knots, points_m, bc_type="periodic" if is_closed else "natural")
    _check_no_reversal(spline)
    # Tabulate the arc length over parts of each span.
    fractions = np.arange(_PARTS) / _PARTS
    nodes = np.append((knots[:-1, None] + chords[:, None] * fractions).ravel(), knots[-1])
    lengths = np.concatenate([[0.0], np.cumsum(_arc_length(spline, nodes[:-1], nodes[1:]))])
    return SmoothCurve(knots, spline, nodes, lengths)


def _check_no_reversal(spline: CubicSpline) -> None:
    """Check that the rate |dr/du| is nowhere near zero, at the ends of spans and at its extrema."""
    from scipy.interpolate import PPoly

    first, second = spline.derivative(1).c, spline.derivative(2).c
    # r' . r'' of each span, of degree 3, whose roots are the extrema of |r'|.
    product = np.zeros((first.shape[0] + second.shape[0] - 1, first.shape[1]))
    for i, a in enumerate(first):
        for j, b in enumerate(second):
            product[i + j] += (a * b).sum(axis=-1)
    extrema = PPoly(product, spline.x).roots(discontinuity=False, extrapolate=False)
    # A straight span has the extremum "everywhere", marked by nan; its ends are enough.
    candidates = np.concatenate([spline.x, extrema[np.isfinite(extrema)]])
    rate = np.linalg.norm(spline(candidates, 1), axis=-1)
    if rate.min() < _LEAST_RATE:
        x, y, z = spline(candidates[np.argmin(rate)])
        raise ValueError(
            f"the path turns back on itself at ({x:.3f}, {y:.3f}, {z:.3f}) m, where a constant speed is "
            "impossible; move the points apart, or use two paths"
        )


def _arc_length(spline: CubicSpline, start: Array, end: Array) -> Array:
    """Arc length `(n,)` between parameters `(n,)` of the same part."""
    places, weights = np.polynomial.legendre.leggauss(_GAUSS_POINTS)
    half = (end - start) / 2
    rates = np.linalg.norm(spline(start[:, None] + half[:, None] * (1 + places), 1), axis=-1)
    return np.asarray(half * (rates @ weights))
