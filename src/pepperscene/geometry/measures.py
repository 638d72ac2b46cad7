"""Reading the measures of many organs of one kind into arrays."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from pepperscene.grammar.plant import Organ


def measure(organs: Sequence[Organ], name: str, default: float | None = None) -> NDArray[np.float64]:
    """`(n,)` one measure of each organ.

    Raises:
        ValueError: an organ lacks it and there is no default, or it is not a finite number.
    """
    # What is missing becomes a NaN.
    values = np.array([organ.measures.get(name, default) for organ in organs], dtype=np.float64)
    if not np.isfinite(values).all():
        organ = organs[int(np.argmin(np.isfinite(values)))]
        raise ValueError(
            f"{organ.kind} of phytomer {organ.phytomer} needs a finite measure {name}, "
            f"not {organ.measures.get(name, default)}"
        )
    return values


def size(organs: Sequence[Organ], name: str) -> NDArray[np.float64]:
    """`(n,)` one measure of each organ that must be above zero.

    Raises:
        ValueError: an organ lacks it or it is not above zero.
    """
    values = measure(organs, name)
    if not np.all(values > 0.0):
        raise ValueError(f"{organs[0].kind}: {name} must be above zero, found {values.min()}")
    return values
