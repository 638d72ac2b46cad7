"""Colorimetry of images: sRGB, CIELAB, chromatic adaptation, and colour correction of sensors.

colour-science provides the basic formulas too, but importing it takes a second.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from typing import Final, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pepperscene.camera.sensor import Sensor
from pepperscene.errors import InputError
from pepperscene.spectra import Spectrum, colour_science, read_spectra, sky_spectrum

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
_NM: Final = np.arange(300.0, 1101.0)  # covers silicon; 1 nm is finer than any curve that is shipped
_WHITE: Final = np.ones((1, _NM.size))
_MIN_LUMINOUS_FRACTION: Final = 1e-3  # chosen: deep red of 700 nm has 4e-3
_LARGEST_GAIN: Final = 1e6  # chosen: a colour that sees a millionth of another's light measures only noise
_LARGEST_ENTRY: Final = 20.0  # chosen: of a matrix; broad lights need 2, and noise grows with it


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
    weight = light.at(_NM) * cie_1931_observer().at(_NM)
    white = weight.sum(axis=-1)
    return np.asarray(reflectance @ weight.T / white[1] @ bradford_adaptation(white / white[1]).T)


def xyz_to_lab(xyz: ArrayLike) -> Array:
    """`(..., 3)` CIELAB of XYZ (white at Y = 1) under D65."""
    relative = np.asarray(xyz, float) / D65_WHITE
    line = relative / (3.0 * (6.0 / 29.0) ** 2) + 4.0 / 29.0
    x, y, z = np.moveaxis(np.where(relative > _LAB_KNEE, np.cbrt(relative), line), -1, 0)
    return np.stack([116.0 * y - 16.0, 500.0 * (x - y), 200.0 * (y - z)], axis=-1)


@dataclass(frozen=True, eq=False)
class ColourCorrection:
    """Conversion of camera_rgb under a light to linear sRGB: `matrix @ (gains * rgb)`.

    Attributes:
        gains: `(3,)` white balance; the smallest is 1.
        matrix: `(3, 3)` colour correction matrix (CCM), applied after the gains; its rows sum to 1.
        chart_lab: `(2, 24, 3)` CIELAB of the chart that the matrix was fitted to: target and result.
    """

    gains: Array
    matrix: Array
    chart_lab: Array = field(repr=False)

    @cached_property
    def mean_delta_e_2000(self) -> float:
        """Mean CIEDE2000 residual on the chart."""
        target, result = self.chart_lab
        return float(np.mean(colour_science().delta_E(target, result, method="CIE 2000")))


@lru_cache(maxsize=32)
def colour_correction(sensor: Sensor, light: Spectrum) -> ColourCorrection:
    """Fit gains and matrix to the 24 patches of a ColorChecker under `light`.

    The target is each patch's colour for the CIE 1931 observer under `light`, adapted to D65 (Bradford). The
    matrix has six free numbers, because white must stay white. A linear fit initialises them, and least
    squares in CIELAB, which is perceptually uniform, refines them.

    Raises:
        InputError: the sensor cannot distinguish colours under the light: one of its colours does not see it,
            hardly any of it is visible, or it is so narrow that the matrix would amplify noise.
    """
    gains = white_balance_gains(sensor, light)
    power = light.at(_NM)
    if not float(power @ cie_1931_observer().at(_NM)[1] / power.sum()) > _MIN_LUMINOUS_FRACTION:
        allowed = "needs a visible reference light; leave the colour matrix out"
        raise InputError(sensor.name, allowed, key="colour_matrix", value=True)
    chart = colour_checker_reflectances().at(_NM)
    rgb = _relative_electrons(sensor, light, chart) / _relative_electrons(sensor, light, _WHITE)
    xyz = adapted_xyz(light, chart)
    lab, matrix = xyz_to_lab(xyz), _fit_matrix(rgb, xyz)
    if np.abs(matrix).max() > _LARGEST_ENTRY:
        allowed = "needs a reference light of more colours; leave the colour matrix out"
        raise InputError(sensor.name, allowed, key="colour_matrix", value=True)
    return ColourCorrection(gains, matrix, np.stack([lab, _rendered_lab(rgb, matrix)]))


def white_balance_gains(sensor: Sensor, light: Spectrum) -> Array:
    """`(3,)` gains, the smallest 1, that make a white diffuser under `light` neutral.

    Raises:
        InputError: a colour of the sensor sees hardly any of the light.
    """
    (white,) = _relative_electrons(sensor, light, _WHITE)
    if not white.min() * _LARGEST_GAIN > white.max():
        problem = "all three colours must see the reference light"
        raise InputError(sensor.name, problem, key="quantum_efficiency")
    return np.asarray(white.max() / white)


def _relative_electrons(sensor: Sensor, light: Spectrum, reflectance: Array) -> Array:
    """`(m, 3)` relative electrons of reflectances `(m, 801)` under `light`."""
    return np.asarray(reflectance @ (light.at(_NM) * sensor.electrons_per_joule(_NM)).T)


def _rendered_lab(rgb: Array, matrix: Array) -> Array:
    """`(m, 3)` CIELAB of balanced camera_rgb after the matrix."""
    return xyz_to_lab(rgb @ matrix.T @ SRGB_TO_XYZ.T)


def _fit_matrix(rgb: Array, xyz: Array) -> Array:
    """`(3, 3)` matrix with rows that sum to 1, from balanced camera_rgb to linear sRGB."""
    from scipy.optimize import least_squares

    def matrix(free: Array) -> Array:
        left = free.reshape(3, 2)
        return np.column_stack([left, 1 - left.sum(axis=1)])

    # Start with linear least squares in sRGB.
    basis, residual = rgb[:, :2] - rgb[:, 2:], xyz @ XYZ_TO_SRGB.T - rgb[:, 2:]
    start = np.linalg.lstsq(basis, residual, rcond=None)[0].T.ravel()
    target = xyz_to_lab(xyz)
    fit = least_squares(lambda free: (_rendered_lab(rgb, matrix(free)) - target).ravel(), start)
    return matrix(fit.x)
