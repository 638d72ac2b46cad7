"""Measures of materials and camera that the page about realism compares with published targets.

None of them renders: each takes seconds at most. `realism.py` adds those that need images.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

import pepperscene as ps
from pepperscene.camera.image.colorimetry import (
    D65_WHITE,
    SRGB_TO_XYZ,
    adapted_xyz,
    bradford_adaptation,
    cie_1931_observer,
    colour_correction,
    d65_spectrum,
    xyz_to_lab,
)
from pepperscene.colour.appearance import lab_hue_deg
from pepperscene.colour.statistics import delta_e_2000
from pepperscene.materials.gloss import cone_gloss
from pepperscene.materials.surface import Surface
from pepperscene.spectra import Spectrum, leaf_spectra, read_spectra

Floats = NDArray[np.float64]

NM: Final = np.arange(300.0, 1101.0)
"""The grid of `pepperscene.camera.image.colorimetry`."""
CULTIVAR: Final = "kaite"
SENSOR: Final = "ueye_ui5250re"
FLASH: Final = "led_matrix_200klx"
STATE: Final = 0.5
"""Pigment state of the leaf that is measured. Chosen: the middle of the path from pale to dark."""


@dataclass(frozen=True)
class Row:
    """A row of the table: a target and what is reached.

    Attributes:
        name: what is measured.
        target: in words.
        low: least accepted value, or None.
        high: greatest accepted value, or None.
        digits: decimals that are shown.
        measure: computes the value.
    """

    name: str
    target: str
    low: float | None
    high: float | None
    digits: int
    measure: Callable[[], float]

    def cells(self, value: float) -> str:
        """The row as Markdown."""
        reached = (self.low is None or value >= self.low) and (self.high is None or value <= self.high)
        number = f"{round(value, self.digits) + 0.0:.{self.digits}f}"
        return f"| {self.name} | {self.target} | {number} | {'yes' if reached else 'no'} |"


# --- leaf and fruit -----------------------------------------------------------------------------------------


@functools.cache
def surfaces(wavelength_nm: tuple[float, ...]) -> dict[str, Surface]:
    """Surfaces of the cultivar at these wavelengths."""
    return ps.organ_surfaces(ps.load_cultivar(CULTIVAR), np.array(wavelength_nm))


def mean_leaf() -> Floats:
    """`(801,)` reflectance of the leaf's upper side with its surface, by PROSPECT, at `NM`."""
    contents = ps.load_cultivar(CULTIVAR).pigments["leaf"].at(np.array([STATE]))
    reflectance = np.asarray(leaf_spectra(NM, **contents).reflectance)
    return reflectance.reshape(-1, NM.size)[0]


def leaf_hue() -> float:
    """CIELAB hue of the mean leaf under D65, degrees."""
    return float(lab_hue_deg(xyz_to_lab(adapted_xyz(d65_spectrum(), mean_leaf()[None])))[0])


def leaf_red_over_green() -> float:
    """Red over green of the mean leaf on the sensor under D65, white balanced."""
    rgb = _balanced_rgb(d65_spectrum(), mean_leaf()[None])[0]
    return float(rgb[0] / rgb[1])


def lower_over_upper(wavelength_nm: float) -> float:
    """Reflectance of the leaf's lower side over that of its upper side, with the cuticle."""
    leaf = surfaces((450.0, 670.0, 850.0))["leaf"]
    column = int(np.flatnonzero(leaf.wavelength_nm == wavelength_nm)[0])
    upper, lower = _reflectance(leaf, STATE)[:, column]
    return float(lower / upper)


def infrared_sum() -> float:
    """Greatest sum of reflectance and transmittance of a leaf at 850 nm."""
    leaf = surfaces((450.0, 670.0, 850.0))["leaf"]
    return float((leaf.reflectance + leaf.transmittance[:, None])[..., -1].max())


def unripe_fruit(channel: str) -> float:
    """L* or C* of the unripe fruit under D65, with the reflection of its cuticle."""
    nm = tuple(np.arange(300.0, 1101.0, 10.0))
    fruit = surfaces(nm)["fruit"]
    skin = np.interp(NM, fruit.wavelength_nm, _reflectance(fruit, 0.0)[0])
    lab = xyz_to_lab(adapted_xyz(d65_spectrum(), skin[None]))[0]
    return float(lab[0] if channel == "L" else np.hypot(lab[1], lab[2]))


def texture_correlation() -> float:
    """Greatest correlation of the vein images of two leaves over uv; 1 if all leaves share one."""
    pattern = surfaces((450.0, 670.0, 850.0))["leaf"].pattern
    if pattern is None or pattern.ndim == 2 or len(pattern) == 1:
        return 1.0
    matrix = np.corrcoef(pattern.reshape(len(pattern), -1))
    return float(matrix[~np.eye(len(pattern), dtype=bool)].max())


def relief_isotropy() -> float:
    """Rms slope of the leaf's relief across over along the midrib, or the inverse, at least 1."""
    relief = surfaces((450.0, 670.0, 850.0))["leaf"].relief_mm
    if relief is None:
        return float("nan")
    stack = relief.reshape(-1, *relief.shape[-2:])
    sizes = ps.load_cultivar(CULTIVAR).organs["lamina"].distributions
    steps = [
        1e3 * sizes[key].mean / count for key, count in zip(("length", "width"), stack.shape[1:], strict=True)
    ]
    # The margin of the image is not on the leaf.
    down, across = np.gradient(stack[:, 16:-16, 16:-16], *steps, axis=(1, 2))
    ratio = float(np.sqrt(np.mean(across**2) / np.mean(down**2)))
    return max(ratio, 1.0 / ratio)


def _reflectance(surface: Surface, state: float) -> Floats:
    """`(2, n)` reflectance of both sides at a pigment state: of the cuticle, and of the body for the rest."""
    # Rows are evenly spaced from the first state to 1.
    states = np.linspace(surface.first_state, 1.0, len(surface.reflectance))
    place = np.interp(state, states, np.arange(len(states)))
    below = min(int(place), len(states) - 2) if len(states) > 1 else 0
    above = min(below + 1, len(states) - 1)
    share = place - below
    body = (1.0 - share) * surface.reflectance[below] + share * surface.reflectance[above]
    gloss = np.array([[cone_gloss(surface.ior, alpha)] for alpha in surface.roughness], float)
    if surface.wide_roughness is not None:
        wide = np.array([[cone_gloss(surface.ior, alpha)] for alpha in surface.wide_roughness], float)
        gloss = (1.0 - surface.wide_share) * gloss + surface.wide_share * wide
    return np.asarray(gloss + (1.0 - gloss) * body)


# --- camera -------------------------------------------------------------------------------------------------


def vrhel_chroma_bias() -> float:
    """Mean excess of the camera's chroma over the true one for 13 measured leaves under D65, in percent."""
    leaves = read_spectra("leaf/vrhel_leaf_reflectance")
    table = np.stack([Spectrum(leaf.wavelength_nm, leaf.values, "hold").at(NM) for leaf in leaves.values()])
    light = d65_spectrum()
    true = xyz_to_lab(adapted_xyz(light, table))
    linear = _balanced_rgb(light, table) @ colour_correction(ps.load_sensor(SENSOR), light).matrix.T
    seen = xyz_to_lab(linear @ SRGB_TO_XYZ.T)
    chroma = [np.hypot(lab[:, 1], lab[:, 2]) for lab in (true, seen)]
    return float(100.0 * np.mean(chroma[1] / chroma[0] - 1.0))


def daylight_in_flash_pictures() -> float:
    """CIEDE2000 of white daylight in a picture balanced for the flash: camera against observer."""
    sensor, flash = ps.load_sensor(SENSOR), ps.load_flash(FLASH).spectrum
    correction = colour_correction(sensor, flash)
    linear = correction.matrix @ (correction.gains * (sensor.electrons_per_joule(NM) @ d65_spectrum().at(NM)))
    seen = SRGB_TO_XYZ @ linear
    true, white = (cie_1931_observer().at(NM) @ light.at(NM) for light in (d65_spectrum(), flash))
    true = bradford_adaptation(white / white[1]) @ true
    labs = [xyz_to_lab(xyz / xyz[1] * D65_WHITE[1]) for xyz in (seen, true)]
    return float(delta_e_2000(*labs))


def _balanced_rgb(light: Spectrum, reflectance: Floats) -> Floats:
    """`(m, 3)` electrons of the sensor over those of a white diffuser."""
    weight = ps.load_sensor(SENSOR).electrons_per_joule(NM) * light.at(NM)
    return np.asarray(reflectance @ weight.T / weight.sum(axis=1))


ROWS: Final = (
    Row("hue of the mean leaf under D65, degrees", "118 to 126", 118.0, 126.0, 1, leaf_hue),
    Row("red over green of the mean leaf on the sensor", "at least 0.66", 0.66, None, 3, leaf_red_over_green),
    Row("leaf, lower over upper at 450 nm", "1.7 to 2.3", 1.7, 2.3, 2, lambda: lower_over_upper(450.0)),
    Row("leaf, lower over upper at 670 nm", "1.7 to 2.3", 1.7, 2.3, 2, lambda: lower_over_upper(670.0)),
    Row("leaf, reflectance plus transmittance at 850 nm", "at most 1", None, 1.0, 3, infrared_sum),
    Row("unripe fruit under D65, L*", "33 to 37", 33.0, 37.0, 1, lambda: unripe_fruit("L")),
    Row("unripe fruit under D65, C*", "21 to 28", 21.0, 28.0, 1, lambda: unripe_fruit("C")),
    Row("correlation of the vein images of two leaves", "below 0.2", None, 0.2, 2, texture_correlation),
    Row("slopes of the leaf's relief, ratio of directions", "at most 1.5", None, 1.5, 2, relief_isotropy),
    Row("13 measured leaves under D65, chroma bias, %", "within ±5", -5.0, 5.0, 1, vrhel_chroma_bias),
    Row("D65 under the flash's balance, CIEDE2000", "at most 6", None, 6.0, 1, daylight_in_flash_pictures),
)  # fmt: skip
