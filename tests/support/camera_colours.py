"""Measured leaves, lights and cameras, and their colours by colour-science."""

from __future__ import annotations

from dataclasses import replace

import colour
import numpy as np

from pepperscene.camera import Sensor, load_flash, load_sensor
from pepperscene.camera.image.colorimetry import NM as ALL_NM
from pepperscene.camera.image.colorimetry import (
    SRGB_TO_XYZ,
    adapted_xyz,
    balanced_rgb,
    colour_checker_reflectances,
    colour_correction,
    d65_spectrum,
    xyz_to_lab,
)
from pepperscene.shipped import shipped_folder
from pepperscene.spectra import Spectrum, read_spectra

NM = np.arange(380.0, 781.0)
OBSERVER = "CIE 1931 2 Degree Standard Observer"
D65 = colour.CCS_ILLUMINANTS[OBSERVER]["D65"]
FLASH, DAYLIGHT = load_flash("led_matrix_200klx").spectrum, d65_spectrum()
SENSOR_NAMES = [
    name
    for name in sorted(path.stem for path in (shipped_folder("materials") / "sensors").glob("*.toml"))
    if load_sensor(name).channels == 3
]


def leaf_reflectances() -> np.ndarray:
    """`(13, n)` reflectances at `NM`; beyond 730 nm, where cameras see nothing, the last value is held."""
    leaves = read_spectra("leaf/vrhel_leaf_reflectance", outside="hold").values()
    return np.stack([leaf.at(NM) for leaf in leaves])


def measured_camera(name: str) -> Sensor:
    """A sensor with the curves of one of the measured cameras; they are per radiant power."""
    columns = read_spectra("sensors/spectra/physlight_camera_sensitivities")
    nm = columns[f"{name}_g"].wavelength_nm
    curves = np.stack([columns[f"{name}_{channel}"].values / nm for channel in "rgb"])
    efficiency = Spectrum(nm, 0.5 * curves / curves.max())
    return replace(load_sensor("ueye_ui5250re"), name=name, quantum_efficiency=efficiency)


def observer_lab(spd: np.ndarray, reflectance: np.ndarray, transform: str = "Bradford") -> np.ndarray:
    """`(m, 3)` Lab of reflectances `(m, n)` under a light `(n,)`, adapted to D65."""
    observer = colour.MSDS_CMFS[OBSERVER].copy().align(colour.SpectralShape(380, 780, 1))
    weight = spd[:, None] * observer.values
    xyz, white, d65 = reflectance @ weight, weight.sum(0), colour.xy_to_XYZ(D65)
    adapted = colour.chromatic_adaptation(
        xyz / white[1], white / white[1], d65, method="Von Kries", transform=transform
    )
    return np.asarray(colour.XYZ_to_Lab(adapted, D65))


def lab_of_rgb(rgb: np.ndarray) -> np.ndarray:
    """`(..., 3)` Lab of linear sRGB."""
    return np.asarray(colour.XYZ_to_Lab(colour.RGB_to_XYZ(rgb, "sRGB", apply_cctf_decoding=False), D65))


def chroma(lab: np.ndarray) -> np.ndarray:
    """Chroma C*ab."""
    return np.hypot(lab[..., 1], lab[..., 2])


def delta_e(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """CIEDE2000 colour differences."""
    return np.asarray(colour.delta_E(a, b, method="CIE 2000"))


def chart_delta_e(sensor: Sensor, light: Spectrum) -> float:
    """Mean CIEDE2000 of the ColorChecker, of which the fit of the sensor's matrix consists in part."""
    chart, matrix = colour_checker_reflectances().at(ALL_NM), colour_correction(sensor, light).matrix
    rendered = xyz_to_lab(balanced_rgb(sensor, light, chart) @ matrix.T @ SRGB_TO_XYZ.T)
    return float(delta_e(xyz_to_lab(adapted_xyz(light, chart)), rendered).mean())
