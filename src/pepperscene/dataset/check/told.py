"""What a frame's JSON tells, as far as it can be read: a damaged one must not stop the check."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray


def table(facts: Mapping[str, Any], name: str) -> dict[str, Any]:
    """The object of a name, empty where there is none."""
    found = facts.get(name)
    return found if isinstance(found, dict) else {}


def instances(facts: Mapping[str, Any]) -> dict[int, dict[str, Any]]:
    """The entries of the instances by their number."""
    entries = table(facts, "instances").items()
    return {int(name): entry for name, entry in entries if name.isdecimal() and isinstance(entry, dict)}


def pose(facts: Mapping[str, Any]) -> NDArray[np.float64] | None:
    """`(4, 4)`, camera to world."""
    try:
        found = np.asarray(table(facts, "camera").get("pose"), dtype=float)
    except (TypeError, ValueError):
        return None
    return found if found.shape == (4, 4) and np.isfinite(found).all() else None


def number(facts: Mapping[str, Any], name: str, default: int = 0) -> int:
    """A whole number of the camera."""
    found = table(facts, "camera").get(name)
    return found if isinstance(found, int) else default
