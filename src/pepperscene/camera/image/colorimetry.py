"""Colorimetry of images: sRGB, CIELAB and chromatic adaptation.

colour-science provides the basic formulas too, but importing it takes a second.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Final, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pepperscene.spectra import Spectrum, read_spectra, sky_spectrum

Array = NDArray[np.float64]
FloatType = TypeVar("FloatType", np.float32, np.float64)

COLOUR_CHECKER_FILE: Final = "chart/colorchecker_iso17321_1.csv"

SRGB_TO_XYZ: Final[Array] = np.array(
    [[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]]
)
XYZ_TO_SRGB: Final[Array] = np.array(
    [[3.2406, -1.5372, -0.4986], [-0.9689, 1.8758, 0.0415], [0.0557, -0.2040, 1.0570]]
)
"""Linear sRGB and XYZ (white at Y = 1), as rounded by IEC 61966-2-1."""

D65_WHITE: Final[Array] = np.array([0.3127 / 0.3290, 1.0, (1.0 - 0.3127 - 0.3290) / 0.3290])
"""XYZ of sRGB's white, by its chromaticity in IEC 61966-2-1."""

_BRADFORD: Final[Array] = np.array(
    [[0.8951, 0.2664, -0.1614], [-0.7502, 1.7135, 0.0367], [0.0389, -0.0685, 1.0296]]
)
"""XYZ to the sharpened cone responses of Lam (1985), "Metamerism and colour constancy"."""

_LAB_KNEE: Final = (6.0 / 29.0) ** 3  # below it, CIELAB's cube root becomes a line (CIE 15:2004)
_SRGB_KNEE: Final = 0.0031308  # linear value below which the sRGB curve is a line (IEC 61966-2-1)
NM: Final = np.arange(300.0, 1101.0)
"""Wavelengths of sums over spectra: they cover silicon, and 1 nm is finer than any curve that is shipped."""


def srgb_encode(linear: NDArray[FloatType]) -> NDArray[FloatType]:
    """Encode linear values in [0, 1] by the sRGB curve of IEC 61966-2-1; shape and float type are kept."""
    return np.where(linear <= _SRGB_KNEE, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)


def srgb_decode(encoded: NDArray[FloatType]) -> NDArray[FloatType]:
    """Invert `srgb_encode`; shape and float type are kept."""
    # The standard rounds this knee to 0.04045.
    return np.where(encoded <= 12.92 * _SRGB_KNEE, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)


@lru_cache(maxsize=1)
def cie_1931_observer() -> Spectrum:
    """CIE 1931 colour matching functions, `(3, n)`, 360 to 830 nm."""
    columns = read_spectra("light/cie_1931_observer")
    return Spectrum(columns["x"].wavelength_nm, np.stack([columns[name].values for name in "xyz"]))


@lru_cache(maxsize=1)
def d65_spectrum() -> Spectrum:
    """CIE standard illuminant D65, relative; always the same object, so that corrections are cached."""
    return sky_spectrum("d65")


def colour_checker_reflectances() -> Spectrum:
    """`(24, n)` reflectances of the ColorChecker of ISO 17321-1; the end values are held."""
    patches = list(read_spectra(COLOUR_CHECKER_FILE).values())
    return Spectrum(patches[0].wavelength_nm, np.stack([patch.values for patch in patches]), "hold")


def bradford_adaptation(white: ArrayLike) -> Array:
    """`(3, 3)` matrix that adapts XYZ from a white `(3,)` to D65: von Kries' rule in Bradford's space."""
    gains = (_BRADFORD @ D65_WHITE) / (_BRADFORD @ np.asarray(white, float))
    return np.asarray(np.linalg.inv(_BRADFORD) @ (gains[:, None] * _BRADFORD))


def adapted_xyz(light: Spectrum, reflectance: Array) -> Array:
    """`(m, 3)` XYZ (white at Y = 1) of reflectances `(m, 801)` under `light`, adapted to D65."""
    weight = light.at(NM) * cie_1931_observer().at(NM)
    white = weight.sum(axis=-1)
    return np.asarray(reflectance @ weight.T / white[1] @ bradford_adaptation(white / white[1]).T)


def adapted_white(light: Spectrum, reference: Spectrum) -> Array:
    """`(3,)` XYZ (white at Y = 1) of a white diffuser under `light`, seen adapted to `reference`."""
    observer = cie_1931_observer().at(NM)
    white, own = observer @ reference.at(NM), observer @ light.at(NM)
    return np.asarray(bradford_adaptation(white / white[1]) @ (own / own[1]))


def xyz_to_lab(xyz: ArrayLike) -> Array:
    """`(..., 3)` CIELAB of XYZ (white at Y = 1) under D65."""
    relative = np.asarray(xyz, float) / D65_WHITE
    line = relative / (3.0 * (6.0 / 29.0) ** 2) + 4.0 / 29.0
    x, y, z = np.moveaxis(np.where(relative > _LAB_KNEE, np.cbrt(relative), line), -1, 0)
    return np.stack([116.0 * y - 16.0, 500.0 * (x - y), 200.0 * (y - z)], axis=-1)
