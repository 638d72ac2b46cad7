"""The choice of steps from light to the picture."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from pepperscene.camera.demosaic import Demosaic

WhiteBalance = Literal["flash", "daylight"]
Tone = Literal["srgb", "linear"]


@dataclass(frozen=True)
class Developing:
    """Which steps lead from the light before the lens to the picture; each can be left out.

    Attributes:
        falloff: the image's fall-off towards the corners: cos^4 of the field angle and the lens' vignetting.
        shot_noise: photo-electrons arrive at random (needs a generator).
        read_noise: the amplifier's noise (needs a generator).
        saturation: the photosites' full well and the converter's upper end.
        quantise: the converter's steps.
        demosaic: how colours are interpolated where every Bayer photosite is a pixel (binning 1).
        white_balance: the light under which a white diffuser is neutral; None leaves the device's cast.
        colour_matrix: from camera_rgb to linear sRGB.
        tone: the sRGB curve, or codes proportional to light.

    White balance and colour matrix do not concern monochrome sensors.
    """

    falloff: bool = True
    shot_noise: bool = True
    read_noise: bool = True
    saturation: bool = True
    quantise: bool = True
    demosaic: Demosaic = "malvar"
    white_balance: WhiteBalance | None = "flash"
    colour_matrix: bool = True
    tone: Tone = "srgb"
