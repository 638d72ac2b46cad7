"""A ColorChecker and its colours by colour-science.

The chart is BabelColor's average of 30; the camera's colour matrix was fitted to that of ISO 17321-1.
"""

from __future__ import annotations

import colour
import numpy as np

NM = np.arange(380.0, 781.0)
OBSERVER = "CIE 1931 2 Degree Standard Observer"
D65 = colour.CCS_ILLUMINANTS[OBSERVER]["D65"]


def chart() -> np.ndarray:
    """`(24, n)` reflectances at `NM`, row by row."""
    patches = colour.SDS_COLOURCHECKERS["BabelColor Average"].values()
    return np.stack([np.interp(NM, patch.wavelengths, patch.values) for patch in patches])


def observer_lab(spd: np.ndarray) -> np.ndarray:
    """`(24, 3)` Lab of the chart under a light `(n,)`, adapted to D65 by CAT02 (the camera uses Bradford)."""
    observer = colour.MSDS_CMFS[OBSERVER].copy().align(colour.SpectralShape(380, 780, 1))
    weight = spd[:, None] * observer.values
    xyz, white, d65 = chart() @ weight, weight.sum(0), colour.xy_to_XYZ(D65)
    adapted = colour.chromatic_adaptation(
        xyz / white[1], white / white[1], d65, method="Von Kries", transform="CAT02"
    )
    return colour.XYZ_to_Lab(adapted, D65)


def lab_of_rgb(rgb: np.ndarray) -> np.ndarray:
    """`(..., 3)` Lab of linear sRGB."""
    return colour.XYZ_to_Lab(colour.RGB_to_XYZ(rgb, "sRGB", apply_cctf_decoding=False), D65)


def difference(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """CIEDE2000 colour differences."""
    return colour.delta_E(a, b, method="CIE 2000")
