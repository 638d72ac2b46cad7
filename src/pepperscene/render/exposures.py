"""The exposure as a factor of the picture, and its derivatives."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.render.bodies import Values

_POWERS: Final = {"exposure.time": 1.0, "exposure.gain": 1.0, "exposure.f_number": -2.0}
"""Of each parameter of the exposure in the picture."""


def exposure(values: Values, own: Values) -> float:
    """What the exposure makes of the camera's own picture, as a factor."""
    stops = own["exposure.f_number"] / values["exposure.f_number"]
    return float(values["exposure.time"] * values["exposure.gain"] * stops**2)


def relative_exposure(values: Values, along: Values) -> float:
    """The exposure's relative change along a direction."""
    return sum(float(power * along[name] / values[name]) for name, power in _POWERS.items() if name in along)


def by_exposure(values: Values, loss: float) -> dict[str, NDArray[np.float64]]:
    """Derivatives by the exposure of what grows with it in proportion."""
    return {name: np.asarray(power * loss / values[name]) for name, power in _POWERS.items()}
