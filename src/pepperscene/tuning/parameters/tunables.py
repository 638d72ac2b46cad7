"""What a recipe has by itself of everything that can be fitted."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

Group = Literal["pigments", "cuticle", "light", "exposure", "camera"]


@dataclass(frozen=True, eq=False)
class Tunables:
    """One thing that can be fitted, at the recipe's own value.

    Attributes:
        name: "leaf.chlorophyll".
        unit: of its numbers; "" for plain ones.
        meaning: in a few words.
        group: that it belongs to.
        value: `(k,)`.
        low, high: that physics and the file formats allow.
        floor: what "none of it" is: 1 of PROSPECT's N, 0 of anything else.
        labels: `(k,)` of its numbers.
    """

    name: str
    unit: str
    meaning: str
    group: Group
    value: NDArray[np.float64]
    low: float = 0.0
    high: float = np.inf
    floor: float = 0.0
    labels: tuple[str, ...] = ("",)
