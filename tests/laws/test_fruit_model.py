"""Colour of the fruit, a layer of pigments on diffuse flesh, against measured fruits.

The measurements (Vrhel, Gershon & Iwan 1994) mostly exclude the specular reflection, so the gloss of the
cuticle is subtracted from the model.
"""

from __future__ import annotations

import numpy as np
import pytest

from pepperscene.cultivar import load_cultivar
from pepperscene.spectra import colour_science, layer_over_body, leaf_spectra, read_spectrum
from pepperscene.spectra.prospect import INCIDENCE_CONE_RAD, cone_transmissivity

NM = np.arange(400, 731, 2)
FRUITS = "fruit/vrhel_fruit_vegetable_reflectance"


def measured(column: str) -> np.ndarray:
    return read_spectrum(FRUITS, column, outside="error").at(NM)


def smooth_gloss(ior: float) -> float:
    """Reflectance of a smooth cuticle for light in PROSPECT's cone of incidence."""
    return float(1.0 - cone_transmissivity(INCIDENCE_CONE_RAD, ior))


def shipped_fruit(state: float) -> np.ndarray:
    """Reflectance of the shipped cultivar's fruit without its gloss."""
    path = load_cultivar("kaite").pigments["fruit"]
    assert path.flesh_reflectance is not None
    skin = leaf_spectra(NM, **path.at(state))
    return layer_over_body(skin, path.flesh_reflectance).reflectance - smooth_gloss(path.ior)


def hue_and_chroma(reflectance: np.ndarray) -> tuple[float, float]:
    """In CIELAB under D65, degrees and units, by colour-science."""
    colour = colour_science()
    sd = colour.SpectralDistribution(dict(zip(NM.tolist(), reflectance.tolist(), strict=True)))
    shape = colour.SpectralShape(400, 730, 2)
    light = colour.SDS_ILLUMINANTS["D65"].copy().align(shape)
    observer = colour.MSDS_CMFS["CIE 1931 2 Degree Standard Observer"].copy().align(shape)
    xyz = colour.sd_to_XYZ(sd, observer, light, method="Integration", shape=shape) / 100
    _, a, b = colour.XYZ_to_Lab(xyz, colour.CCS_ILLUMINANTS["CIE 1931 2 Degree Standard Observer"]["D65"])
    return float(np.degrees(np.arctan2(b, a))), float(np.hypot(a, b))


def rms(difference: np.ndarray) -> float:
    return float(np.sqrt(np.mean(difference**2)))


def test_fitted_contents_reproduce_the_measured_green_pepper():
    skin = leaf_spectra(NM, structure_n=1, chlorophyll_ug_cm2=15.2, carotenoid_ug_cm2=4.0, brown=0.365)
    pepper = layer_over_body(skin, 0.596).reflectance - smooth_gloss(1.45)
    assert rms(pepper - measured("green_pepper_136")) <= 0.012


@pytest.mark.parametrize("column", ["lemon_skin_139", "apple_yellow_delicious_134"])
def test_shipped_ripe_fruit_is_yellow(column):
    """No yellow pepper was measured; the hue of a ripe one is within 10 degrees of other yellow fruits'.

    Green and red are at least 30 degrees away on either side.
    """
    hue, chroma = hue_and_chroma(shipped_fruit(1.0))
    measured_hue, measured_chroma = hue_and_chroma(measured(column))
    assert abs(hue - measured_hue) <= 10
    assert chroma >= 0.9 * measured_chroma


def test_ripening_hue_falls_monotonically_from_green_to_yellow():
    hues = [hue_and_chroma(shipped_fruit(state))[0] for state in np.linspace(0.0, 1.0, 21)]
    assert np.all(np.diff(hues) < 0)
    # A fruit on the plant is a purer green than the measured pepper from a shop.
    assert 0 <= hues[0] - hue_and_chroma(measured("green_pepper_136"))[0] <= 20
