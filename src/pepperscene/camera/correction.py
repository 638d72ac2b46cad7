"""White balance and colour correction matrix of a sensor under a light."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from pepperscene.camera.sensor import Sensor
from pepperscene.errors import InputError
from pepperscene.spectra import Spectrum, colour_science, read_spectra, sky_spectrum

Array = NDArray[np.float64]
CHART = "chart/colorchecker_iso17321_1.csv"
_NM = np.arange(300.0, 1101.0)  # covers silicon; 1 nm is finer than any curve that is shipped


@dataclass(frozen=True, eq=False)
class Correction:
    """How camera_rgb under a light becomes linear sRGB: `matrix @ (gains * rgb)`.

    Attributes:
        gains: `(3,)` white balance, the smallest is 1.
        matrix: `(3, 3)` colour correction matrix (CCM) behind the gains; its rows sum to 1.
        mean_delta_e_2000: left over on the chart that the matrix was fitted to.
    """

    gains: Array
    matrix: Array
    mean_delta_e_2000: float


@lru_cache(maxsize=32)
def correction(sensor: Sensor, light: Spectrum) -> Correction:
    """Gains and matrix that render the 24 patches of a ColorChecker under `light` best.

    The aim is each patch's colour for the CIE 1931 observer under `light`, adapted to D65 (Bradford). The
    matrix has six free numbers, as white must stay white; a linear fit starts them and least squares in
    CIELAB, where equal distances look equally large, finishes them.

    Raises:
        InputError: a colour of the sensor does not see the light at all.
    """
    colour = colour_science()
    chart = chart_reflectances().at(_NM)
    device = np.vstack([chart, np.ones_like(_NM)]) @ (light.at(_NM) * sensor.electrons_per_joule(_NM)).T
    if not device[-1].min() > 0:
        raise InputError(
            sensor.name, "quantum_efficiency", None, "all three colours must see the reference light"
        )
    gains = device[-1].max() / device[-1]
    rgb = device[:-1] / device[-1]  # balanced, white diffuser at 1

    xyz = adapted_xyz(light, chart)
    srgb = colour.RGB_COLOURSPACES["sRGB"]
    aim = xyz @ srgb.matrix_XYZ_to_RGB.T
    matrix = _fit(rgb, _linear_start(rgb, aim), xyz, srgb.matrix_RGB_to_XYZ)
    left = colour.delta_E(_lab(xyz), _lab(rgb @ matrix.T @ srgb.matrix_RGB_to_XYZ.T), method="CIE 2000")
    return Correction(gains, matrix, float(np.mean(left)))


@lru_cache(maxsize=1)
def daylight() -> Spectrum:
    """CIE standard illuminant D65, relative; always the same object, so that corrections are kept."""
    return sky_spectrum("d65")


def chart_reflectances() -> Spectrum:
    """`(24, n)` reflectances of the ColorChecker of ISO 17321-1, end values held."""
    patches = list(read_spectra(CHART).values())
    return Spectrum(patches[0].wavelength_nm, np.stack([patch.values for patch in patches]), "hold")


def adapted_xyz(light: Spectrum, reflectance: Array) -> Array:
    """`(m, 3)` XYZ (white at Y = 1) of reflectances `(m, 801)` under `light`, adapted to D65."""
    colour = colour_science()
    observer = colour.MSDS_CMFS["CIE 1931 2 Degree Standard Observer"]
    weight = light.at(_NM) * Spectrum(observer.wavelengths, observer.values.T).at(_NM)
    white = weight.sum(axis=-1)
    adapt = colour.adaptation.matrix_chromatic_adaptation_VonKries(
        white / white[1], colour.xy_to_XYZ(_d65_white()), transform="Bradford"
    )
    return np.asarray(reflectance @ weight.T / white[1] @ adapt.T)


def _d65_white() -> Array:
    return np.asarray(colour_science().RGB_COLOURSPACES["sRGB"].whitepoint)


def _lab(xyz: Array) -> Array:
    return np.asarray(colour_science().XYZ_to_Lab(xyz, _d65_white()))


def _matrix(free: Array) -> Array:
    """`(3, 3)` with the six free numbers in the first two columns and rows that sum to 1."""
    left = free.reshape(3, 2)
    return np.column_stack([left, 1 - left.sum(axis=1)])


def _linear_start(rgb: Array, aim: Array) -> Array:
    """Least squares in linear sRGB, `(6,)`."""
    basis = rgb[:, :2] - rgb[:, 2:]
    return np.asarray(np.linalg.lstsq(basis, aim - rgb[:, 2:], rcond=None)[0].T.ravel())


def _fit(rgb: Array, start: Array, xyz: Array, to_xyz: Array) -> Array:
    from scipy.optimize import least_squares

    aim = _lab(xyz)
    found = least_squares(lambda free: (_lab(rgb @ _matrix(free).T @ to_xyz.T) - aim).ravel(), start)
    return _matrix(found.x)
