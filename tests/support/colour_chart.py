"""A ColorChecker and its colours by colour-science.

The chart is BabelColor's average of 30; the camera's colour matrix was fitted to that of ISO 17321-1.
"""

from __future__ import annotations

import camera_colours
import colour
import numpy as np
from camera_colours import D65, NM, OBSERVER, delta_e, lab_of_rgb

__all__ = ["D65", "NM", "OBSERVER", "chart", "difference", "lab_of_rgb", "observer_lab"]

difference = delta_e


def chart() -> np.ndarray:
    """`(24, n)` reflectances at `NM`, row by row."""
    patches = colour.SDS_COLOURCHECKERS["BabelColor Average"].values()
    return np.stack([np.interp(NM, patch.wavelengths, patch.values) for patch in patches])


def observer_lab(spd: np.ndarray) -> np.ndarray:
    """`(24, 3)` Lab of the chart under a light `(n,)`, adapted to D65 by CAT02 (the camera uses Bradford)."""
    return camera_colours.observer_lab(spd, chart(), "CAT02")
