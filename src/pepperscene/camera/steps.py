"""The choice of steps from light to the picture."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Literal, get_args

import numpy as np

from pepperscene.camera.demosaic import Demosaic

Light = Literal["flash", "daylight"]
Gains = tuple[float, float, float]
WhiteBalance = Light | Gains
Matrix = tuple[Gains, Gains, Gains]
Tone = Literal["srgb", "linear"]

GAIN_RANGE: Final = (0.01, 100.0)
"""Of explicit white balance gains. Chosen: cameras need 1 to 4, and single precision bears these anywhere."""

LARGEST_ENTRY: Final = 100.0
"""Of an explicit colour matrix, either sign. Chosen as `GAIN_RANGE`; fitted matrices stay below 20."""


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
        white_balance: the light under which a white diffuser is neutral, or the gains of red, green and blue,
            each within `GAIN_RANGE`; None leaves the device's cast.
        colour_matrix: from camera_rgb to linear sRGB: that of the light of the white balance, or where this
            names none, of the flash or else daylight; or an own `(3, 3)`, row by row, that is applied to
            camera_rgb behind the gains. Its rows need not sum to 1; entries are within +-`LARGEST_ENTRY`.
        tone: the sRGB curve, or codes proportional to light.

    Sequences and arrays of numbers become tuples of floats. White balance and colour matrix do not concern
    monochrome sensors. With gains of one's own, and an own matrix or none, no reference light is asked for.

    Raises:
        ValueError: neither the name of a light nor numbers of that shape and range.
    """

    falloff: bool = True
    shot_noise: bool = True
    read_noise: bool = True
    saturation: bool = True
    quantise: bool = True
    demosaic: Demosaic = "malvar"
    white_balance: WhiteBalance | None = "flash"
    colour_matrix: bool | Matrix = True
    tone: Tone = "srgb"

    def __post_init__(self) -> None:
        if self.white_balance is not None:
            object.__setattr__(self, "white_balance", _white_balance(self.white_balance))
        object.__setattr__(self, "colour_matrix", _colour_matrix(self.colour_matrix))


def _white_balance(wanted: object) -> WhiteBalance:
    """A light's name as it is, numbers as a tuple."""
    if isinstance(wanted, str):
        for light in get_args(Light):
            if wanted == light:
                return light
        raise ValueError(f'a white balance is "flash", "daylight", gains or None, not {wanted!r}')
    gains = np.asarray(wanted, dtype=float)
    # Written so that nan fails too.
    if gains.shape != (3,) or not ((gains >= GAIN_RANGE[0]) & (gains <= GAIN_RANGE[1])).all():
        raise ValueError("white balance gains are three numbers of {:g} to {:g}".format(*GAIN_RANGE))
    red, green, blue = gains.tolist()
    return red, green, blue


def _colour_matrix(wanted: object) -> bool | Matrix:
    """A switch as it is, numbers as tuples."""
    if isinstance(wanted, bool | np.bool_):
        return bool(wanted)
    matrix = np.asarray(wanted, dtype=float)
    if matrix.shape != (3, 3) or not (np.abs(matrix) <= LARGEST_ENTRY).all():
        raise ValueError(
            f"a colour matrix is three rows of three numbers of {-LARGEST_ENTRY:g} to {LARGEST_ENTRY:g}"
        )
    red, green, blue = ((float(row[0]), float(row[1]), float(row[2])) for row in matrix)
    return red, green, blue
