"""The choice of steps from electrons to the picture."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

WhiteBalance = Literal["flash", "daylight"]
Tone = Literal["srgb", "linear"]


@dataclass(frozen=True)
class Developing:
    """Which steps lead from electrons to the picture.

    Attributes:
        noise: shot and read noise (they also need a generator).
        quantise: the steps of the sensor's converter.
        white_balance: the light under which a white diffuser is neutral; None leaves the device's cast.
        colour_matrix: from camera_rgb to linear sRGB.
        tone: the sRGB curve, or codes proportional to light.
    """

    noise: bool = True
    quantise: bool = True
    white_balance: WhiteBalance | None = "flash"
    colour_matrix: bool = True
    tone: Tone = "srgb"
