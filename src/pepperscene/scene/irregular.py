"""How plants stand off from even rows: where their places lie, and how each one holds itself."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.scene.greenhouse import Greenhouse
from pepperscene.scene.row import DoubleRow

_MOST: Final = 3.0  # standard deviations; what lies beyond is laid there, 0.3 % of all


@dataclass(frozen=True)
class Posture:
    """What a plant keeps wherever it stands.

    Attributes:
        across_m: of its foot, away from its aisle.
        lean_rad: towards its aisle.
        turn_rad: about its own vertical axis, counter-clockwise seen from above.
    """

    across_m: float = 0.0
    lean_rad: float = 0.0
    turn_rad: float = 0.0


def posture(house: Greenhouse, rng: np.random.Generator) -> Posture:
    """How one plant stands: normal spreads about its row's line, lean and facing."""
    across, lean, turn = _normal(rng, 3)
    return Posture(
        across_m=float(house.across_sd_m * across),
        lean_rad=float(house.row_lean_rad + house.lean_sd_rad * lean),
        turn_rad=float(house.turn_sd_rad * turn),
    )


def uneven(row: DoubleRow, house: Greenhouse, rng: np.random.Generator) -> NDArray[np.float64]:
    """`(n, 2)` x and y of the places of a double row: along the row, each lies by chance off its spot."""
    places = row.places()
    places[:, 0] += house.spacing_sd_m * _normal(rng, len(places))
    return places


def _normal(rng: np.random.Generator, count: int) -> NDArray[np.float64]:
    """Standard normal numbers, none further out than `_MOST`."""
    return np.clip(rng.standard_normal(count), -_MOST, _MOST)
