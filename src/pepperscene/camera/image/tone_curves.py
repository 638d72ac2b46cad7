"""Tone curves of image signal processors: from linear light to code."""

from __future__ import annotations

from functools import lru_cache
from typing import Final

import numpy as np
from numpy.typing import NDArray

from pepperscene.camera.image.colorimetry import srgb_encode
from pepperscene.camera.isp.processor import ImageProcessor, Points, ToneCurveName

Array = NDArray[np.float64]

GAMMA: Final = 2.2  # chosen: that of most displays before sRGB
_LEVELS: Final = 1 << 16
"""Of light in a table of a curve. Near black, where sRGB is steepest, a step is 0.05 codes of 255."""
_FILMIC_EXPOSURE: Final = 0.6  # of Narkowicz (2015), so that his fit is that of the whole transform


def tone_curve(light: Array, curve: ToneCurveName | str | Points, gamma: float = GAMMA) -> Array:
    """Code in [0, 1] of linear light in [0, 1].

    "filmic" is the fit of Narkowicz (2015, "ACES filmic tone mapping curve", knarkowicz.wordpress.com) to the
    reference transform of the Academy Color Encoding System, scaled so that light 1 is white, and coded as
    sRGB: dark shade, bright lights, and a shoulder below white. A curve of points is linear between them.

    Raises:
        ValueError: the curve has another name.
    """
    if not isinstance(curve, str):
        x, y = np.array(curve).T
        return np.interp(light, x, y)
    if curve == "linear":
        return light
    if curve == "gamma":
        return np.asarray(light ** (1.0 / gamma))
    if curve == "filmic":
        return srgb_encode(_aces(_FILMIC_EXPOSURE * light) / _aces(np.array(_FILMIC_EXPOSURE)))
    if curve == "srgb":
        return srgb_encode(light)
    raise ValueError(f"there is no tone curve {curve!r}")


def _aces(x: Array) -> Array:
    return np.asarray(x * (2.51 * x + 0.03) / (x * (2.43 * x + 0.59) + 0.14))


def s_curve(code: Array, strength: float) -> Array:
    """Codes in [0, 1], by a share `strength` of -1 to 1 on their way to 3x^2 - 2x^3; 0, 1/2 and 1 stay."""
    return np.asarray(code + strength * (code * code * (3.0 - 2.0 * code) - code))


def apply_tone(linear: NDArray[np.float32], isp: ImageProcessor, tone: ToneCurveName) -> NDArray[np.float32]:
    """Codes in [0, 1] of linear values of any shape, clipped to [0, 1]; `tone` without a curve of its own."""
    curve = isp.tone_curve or tone
    table = _table(curve, GAMMA if isp.gamma is None else isp.gamma, isp.contrast or 0.0)
    levels = np.clip(linear, np.float32(0), np.float32(1))
    levels *= np.float32(_LEVELS - 1)
    levels += np.float32(0.5)
    return table.take(levels.astype(np.uint16))


@lru_cache(maxsize=4)
def _table(curve: ToneCurveName | str | Points, gamma: float, contrast: float) -> NDArray[np.float32]:
    """`(65536,)` codes by light: a fifth of the time of powers."""
    light = np.arange(_LEVELS) / (_LEVELS - 1)
    return s_curve(tone_curve(light, curve, gamma), contrast).astype(np.float32)
