"""Colorimetry: sRGB, CIELAB and chromatic adaptation; white balance gains and colour matrices of sensors.

colour-science provides the basic formulas too, but importing it takes a second.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Final, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pepperscene.camera.sensor.sensor import Sensor
from pepperscene.errors import InputError
from pepperscene.spectra import MEAN_LEAF, Spectrum, leaf_spectra, read_spectra, sky_spectrum
from pepperscene.spectra.lights import SkyKind

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


def xyz_to_lab(xyz: ArrayLike) -> Array:
    """`(..., 3)` CIELAB of XYZ (white at Y = 1) under D65."""
    relative = np.asarray(xyz, float) / D65_WHITE
    line = relative / (3.0 * (6.0 / 29.0) ** 2) + 4.0 / 29.0
    x, y, z = np.moveaxis(np.where(relative > _LAB_KNEE, np.cbrt(relative), line), -1, 0)
    return np.stack([116.0 * y - 16.0, 500.0 * (x - y), 200.0 * (y - z)], axis=-1)


_WHITE: Final = np.ones((1, NM.size))
_MIN_LUMINOUS_FRACTION: Final = 1e-3  # chosen: deep red of 700 nm has 4e-3
_LARGEST_GAIN: Final = 1e6  # chosen: a colour that sees a millionth of another's light measures only noise
_LARGEST_ENTRY: Final = 20.0  # chosen: of a matrix; broad lights need 2, and noise grows with it

_LEAF_WEIGHT: Final = 1.5
"""Weight of the leaves' mean squared error; that of the chart is 1. Chosen: leaves fill most of a picture.
From 1 to 2, the chart's mean colour difference rises by less than 0.15 for all shipped sensors."""
_DAYLIGHT_WEIGHT: Final = 0.25
"""Weight of the colours of daylight. Chosen: with 0.5, the chart's mean colour difference for the MT9V024
rises from 1.7 to 2.1, and with 1 to 3.6: no matrix shows both, as its responses are far from combinations of
the observer's functions. For the other shipped sensors the weight hardly matters."""

# Training leaves: all combinations. Chosen: from young or yellowing to dark leaves, around `MEAN_LEAF`.
_STRUCTURE: Final = (1.3, 1.6, 2.0)
_CHLOROPHYLL_UG_CM2: Final = (10.0, 25.0, 40.0, 60.0)
_CAROTENOID_RATIO: Final = MEAN_LEAF["carotenoid_ug_cm2"] / MEAN_LEAF["chlorophyll_ug_cm2"]
_BROWN: Final = (0.0, 0.3)
_SURFACE_REFLECTANCE: Final = (0.0, 0.04)
"""Specular part of the reflectance that is missing: none, and all of a surface of index 1.5 (Fresnel). A
camera sees more or less of it, depending on where the light is."""
_DAYLIGHTS: Final[tuple[SkyKind, ...]] = ("d50", "d55", "d65", "d75")


@dataclass(frozen=True, eq=False)
class ColourCorrection:
    """Conversion of camera_rgb under a light to linear sRGB: `matrix @ (gains * rgb)`.

    Attributes:
        gains: `(3,)` white balance; the smallest is 1.
        matrix: `(3, 3)` colour correction matrix (CCM), applied after the gains; its rows sum to 1.
    """

    gains: Array
    matrix: Array


def colour_correction(sensor: Sensor, light: Spectrum) -> ColourCorrection:
    """Fit gains and matrix to a ColorChecker and to leaves under `light`, and to daylights.

    The targets are colours for the CIE 1931 observer, adapted from `light` to D65 (Bradford), of

    - the 24 patches of the chart,
    - 48 leaves by PROSPECT-D, because charts have no spectra like theirs: a matrix for the chart alone raises
      the chroma of measured leaves by 5 to 17 %, depending on the sensor,
    - white diffusers under daylight of 5,000 to 7,500 K, seen in the white balance of `light`.

    The matrix has six free numbers, because white must stay white. A linear fit to the chart initialises
    them, and least squares in CIELAB, which is perceptually uniform, refines them.

    Raises:
        InputError: the sensor cannot distinguish colours under the light: one of its colours does not see it,
            hardly any of it is visible, or it is so narrow that the matrix would amplify noise.
    """
    return _fitted_correction(_colours(sensor.name, sensor.quantum_efficiency), light)


@lru_cache(maxsize=32)
def _colours(name: str, quantum_efficiency: Spectrum) -> Sensor:
    """One sensor for all with these colours: automatic exposure tries many gains, and each fit takes .1 s."""
    return Sensor(name, 2, 2, 1e-6, quantum_efficiency, 1.0, 0.0, 8, 0.0)


@lru_cache(maxsize=32)
def _fitted_correction(sensor: Sensor, light: Spectrum) -> ColourCorrection:
    gains = white_balance_gains(sensor, light)
    power = light.at(NM)
    if not float(power @ cie_1931_observer().at(NM)[1] / power.sum()) > _MIN_LUMINOUS_FRACTION:
        allowed = "needs a visible reference light; leave the colour matrix out"
        raise InputError(sensor.name, allowed, key="colour_matrix", value=True)
    chart = colour_checker_reflectances().at(NM)
    matrix = _fit_matrix(
        [
            (balanced_rgb(sensor, light, chart), adapted_xyz(light, chart), 1.0),
            (balanced_rgb(sensor, light, _leaves()), adapted_xyz(light, _leaves()), _LEAF_WEIGHT),
            (*_daylights(sensor, light), _DAYLIGHT_WEIGHT),
        ]
    )
    if np.abs(matrix).max() > _LARGEST_ENTRY:
        allowed = "needs a reference light of more colours; leave the colour matrix out"
        raise InputError(sensor.name, allowed, key="colour_matrix", value=True)
    return ColourCorrection(gains, matrix)


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


def balanced_rgb(sensor: Sensor, light: Spectrum, reflectance: Array) -> Array:
    """`(m, 3)` camera_rgb of reflectances `(m, 801)` at `NM`, balanced and 1 for white."""
    white = _relative_electrons(sensor, light, _WHITE)
    return np.asarray(_relative_electrons(sensor, light, reflectance) / white)


def _relative_electrons(sensor: Sensor, light: Spectrum, reflectance: Array) -> Array:
    """`(m, 3)` relative electrons of reflectances `(m, 801)` under `light`."""
    return np.asarray(reflectance @ (light.at(NM) * sensor.electrons_per_joule(NM)).T)


@lru_cache(maxsize=1)
def _leaves() -> Array:
    """`(48, 801)` reflectances of the training leaves."""
    grid = np.meshgrid(_STRUCTURE, _CHLOROPHYLL_UG_CM2, _BROWN, _SURFACE_REFLECTANCE, indexing="ij")
    structure, chlorophyll, brown, missing = (values.ravel() for values in grid)
    leaves = leaf_spectra(
        NM,
        structure_n=structure,
        chlorophyll_ug_cm2=chlorophyll,
        carotenoid_ug_cm2=_CAROTENOID_RATIO * chlorophyll,
        brown=brown,
        water_cm=MEAN_LEAF["water_cm"],
        dry_matter_g_cm2=MEAN_LEAF["dry_matter_g_cm2"],
    )
    return np.asarray(np.maximum(leaves.reflectance - missing[:, None], 0.0))


def _daylights(sensor: Sensor, light: Spectrum) -> tuple[Array, Array]:
    """camera_rgb and XYZ, each `(4, 3)`, of white diffusers under daylight, balanced for `light`."""
    observer = cie_1931_observer().at(NM)

    def seen(one: Spectrum) -> tuple[Array, Array]:
        """camera_rgb and XYZ of the same luminance."""
        xyz = observer @ one.at(NM)
        rgb = _relative_electrons(sensor, one, _WHITE)[0] / float(one.at(NM) @ observer[1])
        return rgb, xyz / xyz[1]

    (balance, white), *others = (seen(one) for one in (light, *map(sky_spectrum, _DAYLIGHTS)))
    adaptation = bradford_adaptation(white)
    return np.stack([rgb / balance for rgb, _ in others]), np.stack([adaptation @ xyz for _, xyz in others])


def _fit_matrix(samples: list[tuple[Array, Array, float]]) -> Array:
    """`(3, 3)` matrix with rows that sum to 1, from balanced camera_rgb to linear sRGB.

    `samples` are groups of camera_rgb `(m, 3)`, XYZ `(m, 3)` and the weight of their root mean square error.
    """
    from scipy.optimize import least_squares

    def matrix(free: Array) -> Array:
        left = free.reshape(3, 2)
        return np.column_stack([left, 1 - left.sum(axis=1)])

    # Start with linear least squares in sRGB.
    rgb, xyz, _ = samples[0]
    basis, residual = rgb[:, :2] - rgb[:, 2:], xyz @ XYZ_TO_SRGB.T - rgb[:, 2:]
    start = np.linalg.lstsq(basis, residual, rcond=None)[0].T.ravel()
    # Then all groups together in CIELAB.
    colours = np.concatenate([rgb for rgb, _, _ in samples])
    target = xyz_to_lab(np.concatenate([xyz for _, xyz, _ in samples]))
    weight = np.concatenate([np.full(len(rgb), weight / np.sqrt(len(rgb))) for rgb, _, weight in samples])

    def errors(free: Array) -> Array:
        lab = xyz_to_lab(colours @ matrix(free).T @ SRGB_TO_XYZ.T)
        return np.asarray(((lab - target) * weight[:, None]).ravel())

    return matrix(least_squares(errors, start).x)
