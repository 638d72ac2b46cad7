"""The normal law between two bounds: its moments, and the law that has given moments."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray


def truncated_moments(mean: float, sd: float, low: float, high: float) -> tuple[float, float]:
    """Mean and standard deviation of a normal law cut to [low, high].

    Johnson, Kotz & Balakrishnan 1994, Continuous Univariate Distributions 1, section 13.10.

    Raises:
        ValueError: the law has no probability between the bounds that floating point could tell from zero.
    """
    a, b = (low - mean) / sd, (high - mean) / sd
    density = [math.exp(-0.5 * x * x) / math.sqrt(2.0 * math.pi) for x in (a, b)]
    # The upper tail is counted from above, or its probability would be lost in rounding.
    side = -1.0 if a > 0 else 1.0
    mass = 0.5 * side * (math.erfc(-side * b / math.sqrt(2.0)) - math.erfc(-side * a / math.sqrt(2.0)))
    if not mass > 0:
        raise ValueError("the law has no probability between its bounds")
    shift = (density[0] - density[1]) / mass
    spread = 1.0 + (a * density[0] - b * density[1]) / mass - shift * shift
    return mean + sd * shift, sd * math.sqrt(max(spread, 0.0))


def untruncated(mean: float, sd: float, low: float, high: float) -> tuple[float, float]:
    """Mean and standard deviation of the normal law that has `mean` and `sd` once cut to [low, high].

    Newton's method on both moments, with a numerical Jacobian.

    Raises:
        ValueError: no normal law has them.
    """
    found = np.array([mean, math.log(sd)])

    def missing(at: NDArray[np.float64]) -> NDArray[np.float64]:
        got = truncated_moments(float(at[0]), math.exp(float(at[1])), low, high)
        return np.array([got[0] - mean, got[1] - sd]) / sd

    for _ in range(60):
        # Far from the answer numbers may over- or underflow; then there is none.
        with np.errstate(all="ignore"):
            try:
                off = missing(found)
                if np.abs(off).max() < 1e-10:
                    return float(found[0]), math.exp(float(found[1]))
                steps = np.array([1e-6 * sd, 1e-6])
                jacobian = np.column_stack(
                    [(missing(found + np.eye(2)[k] * steps[k]) - off) / steps[k] for k in (0, 1)]
                )
                move = np.linalg.solve(jacobian, -off)
            except (ValueError, np.linalg.LinAlgError):
                break
        if not np.isfinite(move).all():
            break
        # Short steps: far from the answer the cut law hardly depends on its parent.
        found = found + move * min(1.0, 0.5 / max(abs(move[0]) / sd, abs(move[1]), 1e-12))
        if abs(found[0] - mean) > 30 * sd or abs(found[1] - math.log(sd)) > 3:
            break
    raise ValueError("no normal distribution has this mean and sd between its bounds; move low, high or sd")
