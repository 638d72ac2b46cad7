"""The steps from electrons to an image, and what is left out."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Annotated, Any, Final, Literal, get_args

import numpy as np
from pydantic import BeforeValidator, PlainSerializer

from pepperscene.camera.isp.processor import ImageProcessor
from pepperscene.units import NONE, Switch, Table, single_message, within

Demosaic = Literal["malvar", "menon", "bilinear"]
Light = Literal["flash", "daylight", "lamps"]
Tone = Literal["srgb", "linear"]
GAIN_RANGE: Final = (0.01, 100.0)
"""Allowed white balance gains. Chosen: cameras need 1 to 4, and single precision is exact enough here."""
LARGEST_MATRIX_ENTRY: Final = 100.0
"""Largest absolute entry of a given colour matrix. Chosen as `GAIN_RANGE`; fitted matrices stay below 20."""
LARGEST_PEDESTAL: Final = 0.25  # of full scale; chosen: black is then a bright grey, code 137

Gain = Annotated[float, within(*GAIN_RANGE)]
Gains = tuple[Gain, Gain, Gain]
WhiteBalance = Light | Gains
Entry = Annotated[float, within(-LARGEST_MATRIX_ENTRY, LARGEST_MATRIX_ENTRY)]
MatrixRow = tuple[Entry, Entry, Entry]
Matrix = tuple[MatrixRow, MatrixRow, MatrixRow]
Pedestal = Annotated[float, within(0, LARGEST_PEDESTAL)] | Literal["auto"]


_BALANCE: Final = single_message(
    'must be "flash", "daylight", "lamps", "none", or the gains of red, green and blue, each 0.01 to 100'
)
_NAMED_NONE: Final = BeforeValidator(lambda value: None if value == NONE else value)
_NONE_NAME: Final = PlainSerializer(lambda value: NONE if value is None else value)
_MATRIX: Final = single_message("must be true, false, or three rows of three numbers, each -100 to 100")
_PEDESTAL: Final = single_message('must be "auto", or 0 to 0.25')


def _processor_table(value: object) -> object:
    """A table of `isp`, or None for its name; another text is no table."""
    if isinstance(value, str) and value != NONE:
        raise ValueError(f'must be a table, or "{NONE}"')
    return None if value == NONE else value


@dataclass(frozen=True)
class Developing(Table):
    """The steps from the light in front of the lens to the image; each can be left out.

    Attributes:
        falloff: the fall-off towards the image corners: cos^4 of the field angle and the lens' vignetting.
        shot_noise: photo-electrons arrive at random (needs a generator).
        read_noise: noise of the amplifier (needs a generator).
        saturation: the photosites' full well and the converter's upper end.
        quantise: rounding by the converter.
        demosaic: how colours are interpolated if every Bayer photosite is a pixel (binning 1).
        white_balance: the light under which a white diffuser is neutral, or the gains of red, green and blue,
            each within `GAIN_RANGE`; None keeps the device's colour cast. "lamps" is `Camera.lamp_light`.
        colour_matrix: from camera_rgb to linear sRGB. True fits it to the light of the white balance or, if
            that names none, to the flash or else daylight; False leaves it out; a `(3, 3)` matrix is applied
            to camera_rgb after the gains. Its rows need not sum to 1; entries are within +-100.
        tone: the sRGB curve, or codes proportional to light.
        white_balance_error: factors on the gains of red, green and blue, as of a camera that misjudges the
            light; the colour matrix is still that of the right gains.
        stray_light: diffraction, scatter, veiling glare and ghosts of the lens; see `StrayLight`.
        pedestal: added to linear sRGB before it is clipped at black, as a fraction of full scale, from 0 to
            0.25; white stays white. Without it, clipping the noise of black makes it brighter, and most where
            noise is strongest, in red and blue. "auto" is `AUTO_PEDESTAL` standard deviations of the noisiest
            colour of black, which makes it neutral; 0 on a monochrome sensor.
        isp: what an image signal processor does to the image, or None.
        blur_px: standard deviation of a Gaussian by which lens and optical low-pass filter blur the light
            before it is measured, besides focus and stray light.

    Sequences and arrays of numbers become tuples of floats. White balance and colour matrix do not apply to
    monochrome sensors. With numbers for both, or without a matrix, no reference light is needed.

    Raises:
        ValueError: neither the name of a light nor numbers of that shape and range.
    """

    falloff: Switch = True
    shot_noise: Switch = True
    read_noise: Switch = True
    saturation: Switch = True
    quantise: Switch = True
    demosaic: Demosaic = "malvar"
    white_balance: Annotated[WhiteBalance | None, _BALANCE, _NAMED_NONE, _NONE_NAME] = "flash"
    colour_matrix: Annotated[Switch | Matrix, _MATRIX] = True
    tone: Tone = "srgb"
    white_balance_error: Gains = (1.0, 1.0, 1.0)
    stray_light: Switch = False
    pedestal: Annotated[Pedestal, _PEDESTAL] = 0.0
    isp: Annotated[ImageProcessor | None, BeforeValidator(_processor_table)] = None
    blur_px: Annotated[float, within(0, 20)] = 0.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "white_balance_error", _gains(self.white_balance_error, "error"))
        if self.white_balance is not None:
            object.__setattr__(self, "white_balance", _white_balance(self.white_balance))
        object.__setattr__(self, "colour_matrix", _colour_matrix(self.colour_matrix))
        if self.pedestal != "auto" and not 0.0 <= float(self.pedestal) <= LARGEST_PEDESTAL:
            raise ValueError(f'a pedestal must be "auto", or 0 to {LARGEST_PEDESTAL:g}')

    def to_metadata(self) -> dict[str, Any]:
        """JSON-ready description; later steps only if they are used."""
        steps = dataclasses.asdict(self) | {"isp": self.isp and self.isp.to_metadata()}
        unused = {
            "white_balance_error": (1.0, 1.0, 1.0), "stray_light": False, "pedestal": 0.0, "isp": None,
            "blur_px": 0.0,
        }  # fmt: skip
        return {name: value for name, value in steps.items() if name not in unused or value != unused[name]}


def _white_balance(value: object) -> WhiteBalance:
    """The name of a light unchanged, gains as a tuple."""
    if isinstance(value, str):
        for light in get_args(Light):
            if value == light:
                return light
        raise ValueError(f'white balance must be "flash", "daylight", "lamps", gains or None, not {value!r}')
    return _gains(value, "gains")


def _gains(value: object, name: str) -> tuple[float, float, float]:
    """Three factors of red, green and blue as a tuple."""
    gains = np.asarray(value, dtype=float)
    # Written so that nan fails too.
    if gains.shape != (3,) or not ((gains >= GAIN_RANGE[0]) & (gains <= GAIN_RANGE[1])).all():
        raise ValueError("white balance {} must be three numbers of {:g} to {:g}".format(name, *GAIN_RANGE))
    red, green, blue = gains.tolist()
    return red, green, blue


def _colour_matrix(value: object) -> bool | Matrix:
    """A switch as a bool, a matrix as tuples."""
    if isinstance(value, bool | np.bool_):
        return bool(value)
    matrix = np.asarray(value, dtype=float)
    if matrix.shape != (3, 3) or not (np.abs(matrix) <= LARGEST_MATRIX_ENTRY).all():
        allowed = f"three rows of three numbers of {-LARGEST_MATRIX_ENTRY:g} to {LARGEST_MATRIX_ENTRY:g}"
        raise ValueError(f"a colour matrix must be {allowed}")
    red, green, blue = ((float(row[0]), float(row[1]), float(row[2])) for row in matrix)
    return red, green, blue
