"""What the standard observer sees, and how far apart two colours look: CIE 1931, CIELAB, Bradford, sRGB.

The few formulas that a first picture needs. colour-science has them too, but its import takes a second.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from typing import Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pepperscene.camera.sensor import Sensor
from pepperscene.errors import InputError
from pepperscene.spectra import Spectrum, colour_science, read_spectra, sky_spectrum

Array = NDArray[np.float64]

OBSERVER: Final = "light/cie_1931_observer"

SRGB_TO_XYZ: Final[Array] = np.array(
    [[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]]
)
XYZ_TO_SRGB: Final[Array] = np.array(
    [[3.2406, -1.5372, -0.4986], [-0.9689, 1.8758, 0.0415], [0.0557, -0.2040, 1.0570]]
)
"""Linear sRGB and XYZ (white at Y = 1), as IEC 61966-2-1 rounds them."""

D65_WHITE: Final[Array] = np.array([0.3127 / 0.3290, 1.0, (1.0 - 0.3127 - 0.3290) / 0.3290])
"""XYZ of sRGB's white, by its chromaticity in IEC 61966-2-1."""

_BRADFORD: Final[Array] = np.array(
    [[0.8951, 0.2664, -0.1614], [-0.7502, 1.7135, 0.0367], [0.0389, -0.0685, 1.0296]]
)
"""XYZ to the sharpened cone responses of Lam (1985), "Metamerism and colour constancy"."""

_KNEE: Final = (6.0 / 29.0) ** 3  # of CIELAB: below, its cube root becomes a line (CIE 15:2004)


@lru_cache(maxsize=1)
def cie_1931_observer() -> Spectrum:
    """CIE 1931 colour matching functions, `(3, n)`, 360 to 830 nm."""
    columns = read_spectra(OBSERVER)
    return Spectrum(columns["x"].wavelength_nm, np.stack([columns[name].values for name in "xyz"]))


def bradford_adaptation(white: ArrayLike) -> Array:
    """`(3, 3)` what brings XYZ seen under a light of the given white, `(3,)`, to D65: von Kries' rule in
    Bradford's space.
    """
    gains = (_BRADFORD @ D65_WHITE) / (_BRADFORD @ np.asarray(white, float))
    return np.asarray(np.linalg.inv(_BRADFORD) @ (gains[:, None] * _BRADFORD))


def xyz_to_lab(xyz: ArrayLike) -> Array:
    """`(..., 3)` CIELAB of XYZ (white at Y = 1) under D65."""
    share = np.asarray(xyz, float) / D65_WHITE
    line = share / (3.0 * (6.0 / 29.0) ** 2) + 4.0 / 29.0
    x, y, z = np.moveaxis(np.where(share > _KNEE, np.cbrt(share), line), -1, 0)
    return np.stack([116.0 * y - 16.0, 500.0 * (x - y), 200.0 * (y - z)], axis=-1)


CHART = "chart/colorchecker_iso17321_1.csv"
_NM = np.arange(300.0, 1101.0)  # covers silicon; 1 nm is finer than any curve that is shipped
_WHITE = np.ones((1, _NM.size))
_LEAST_VISIBLE = 1e-3  # chosen: share of the power, weighted by the eye; deep red of 700 nm has 4e-3
_LARGEST_ENTRY = 20.0  # chosen: of a matrix; broad lights need 2, and noise grows with it


@dataclass(frozen=True, eq=False)
class ColourCorrection:
    """How camera_rgb under a light becomes linear sRGB: `matrix @ (gains * rgb)`.

    Attributes:
        gains: `(3,)` white balance, the smallest is 1.
        matrix: `(3, 3)` colour correction matrix (CCM) behind the gains; its rows sum to 1.
        chart_lab: `(2, 24, 3)` CIELAB of the chart that the matrix was fitted to: wanted, and found.
    """

    gains: Array
    matrix: Array
    chart_lab: Array = field(repr=False)

    @cached_property
    def mean_delta_e_2000(self) -> float:
        """Mean CIEDE2000 left over on the chart."""
        wanted, found = self.chart_lab
        return float(np.mean(colour_science().delta_E(wanted, found, method="CIE 2000")))


@lru_cache(maxsize=32)
def colour_correction(sensor: Sensor, light: Spectrum) -> ColourCorrection:
    """Gains and matrix that render the 24 patches of a ColorChecker under `light` best.

    The aim is each patch's colour for the CIE 1931 observer under `light`, adapted to D65 (Bradford). The
    matrix has six free numbers, as white must stay white; a linear fit starts them and least squares in
    CIELAB, where equal distances look equally large, finishes them.

    Raises:
        InputError: the light does not let this sensor tell colours apart: a colour of the sensor does not see
            it, hardly any of it is visible, or it is so narrow that the matrix would show noise alone.
    """
    gains = white_balance_gains(sensor, light)
    if not _visible_share(light) > _LEAST_VISIBLE:
        raise InputError(
            sensor.name,
            "needs a visible reference light; leave the colour matrix out",
            key="colour_matrix",
            value=True,
        )
    chart = colour_checker_reflectances().at(_NM)
    rgb = _seen(sensor, light, chart) / _seen(sensor, light, _WHITE)  # balanced, white diffuser at 1

    xyz = adapted_xyz(light, chart)
    matrix = _fit(rgb, _linear_start(rgb, xyz @ XYZ_TO_SRGB.T), xyz)
    if np.abs(matrix).max() > _LARGEST_ENTRY:
        allowed = "needs a reference light of more colours; leave the colour matrix out"
        raise InputError(sensor.name, allowed, key="colour_matrix", value=True)
    return ColourCorrection(
        gains, matrix, np.stack([xyz_to_lab(xyz), xyz_to_lab(rgb @ matrix.T @ SRGB_TO_XYZ.T)])
    )


def white_balance_gains(sensor: Sensor, light: Spectrum) -> Array:
    """`(3,)` gains, the smallest 1, that make a white diffuser under `light` neutral.

    Raises:
        InputError: a colour of the sensor does not see the light at all.
    """
    (white,) = _seen(sensor, light, _WHITE)
    if not white.min() > 0:
        raise InputError(
            sensor.name, "all three colours must see the reference light", key="quantum_efficiency"
        )
    return np.asarray(white.max() / white)


def _seen(sensor: Sensor, light: Spectrum, reflectance: Array) -> Array:
    """`(m, 3)` relative electrons of reflectances `(m, 801)` under `light`."""
    return np.asarray(reflectance @ (light.at(_NM) * sensor.electrons_per_joule(_NM)).T)


def _visible_share(light: Spectrum) -> float:
    """Of the light's power, weighted by the eye's luminous efficiency, whose peak is 1."""
    power = light.at(_NM)
    return float(power @ cie_1931_observer().at(_NM)[1] / power.sum())


@lru_cache(maxsize=1)
def d65_spectrum() -> Spectrum:
    """CIE standard illuminant D65, relative; always the same object, so that corrections are kept."""
    return sky_spectrum("d65")


def colour_checker_reflectances() -> Spectrum:
    """`(24, n)` reflectances of the ColorChecker of ISO 17321-1, end values held."""
    patches = list(read_spectra(CHART).values())
    return Spectrum(patches[0].wavelength_nm, np.stack([patch.values for patch in patches]), "hold")


def adapted_xyz(light: Spectrum, reflectance: Array) -> Array:
    """`(m, 3)` XYZ (white at Y = 1) of reflectances `(m, 801)` under `light`, adapted to D65."""
    weight = light.at(_NM) * cie_1931_observer().at(_NM)
    white = weight.sum(axis=-1)
    return np.asarray(reflectance @ weight.T / white[1] @ bradford_adaptation(white / white[1]).T)


def _matrix(free: Array) -> Array:
    """`(3, 3)` with the six free numbers in the first two columns and rows that sum to 1."""
    left = free.reshape(3, 2)
    return np.column_stack([left, 1 - left.sum(axis=1)])


def _linear_start(rgb: Array, aim: Array) -> Array:
    """Least squares in linear sRGB, `(6,)`."""
    basis = rgb[:, :2] - rgb[:, 2:]
    return np.asarray(np.linalg.lstsq(basis, aim - rgb[:, 2:], rcond=None)[0].T.ravel())


def _fit(rgb: Array, start: Array, xyz: Array) -> Array:
    from scipy.optimize import least_squares

    aim = xyz_to_lab(xyz)
    found = least_squares(
        lambda free: (xyz_to_lab(rgb @ _matrix(free).T @ SRGB_TO_XYZ.T) - aim).ravel(), start
    )
    return _matrix(found.x)
