"""What sizes and shapes an organ can have, whatever a law of great variance says."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

import numpy as np

from pepperscene.grammar.hashing import FloatArray

_LEAST: Final = 1e-4  # m, chosen: smaller than any organ that can be seen
_INF: Final = float("inf")

# Chosen: where a body would vanish or turn inside out. Angles have no limits.
_LIMITS: Final[Mapping[str, tuple[float, float]]] = {
    "length": (_LEAST, _INF),
    "width": (_LEAST, _INF),
    "diameter": (_LEAST, _INF),
    "groove": (0.0, _INF),
    "margin_wave": (0.0, _INF),
    "margin_waves": (0.0, _INF),
    "blister": (0.0, _INF),
    "vein": (0.0, _INF),
    "tip": (0.05, 20.0),
    "slenderness": (0.1, 10.0),
    "base": (0.05, 20.0),
    "widest": (0.05, 0.95),
    "asymmetry": (-0.9, 0.9),
    "lobes": (0.0, _INF),
    "lobe_depth": (0.0, _INF),
    "taper": (0.05, 5.0),
    "shoulder": (0.0, _INF),
    "point": (0.0, 1.0),
    "calyx_radius": (0.02, 10.0),
    "calyx_tooth": (0.0, 1.0),
    "calyx_state": (0.0, 1.0),
    "open": (0.0, 1.0),
    "state": (0.0, 1.0),
    "state_spread": (0.0, 1.0),
    "ripeness": (0.0, 1.0),
    "ripeness_spread": (0.0, 1.0),
}


def possible(name: str, values: FloatArray) -> FloatArray:
    """The values of a parameter, none beyond what an organ can have."""
    low, high = _LIMITS.get(name, (-_INF, _INF))
    return values if low == -_INF else np.minimum(np.maximum(values, low), high)
