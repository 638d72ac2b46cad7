"""Colours of reflectances by colour-science, and spectra between the rows of a surface; for tests."""

import colour
import numpy as np

from pepperscene.spectra import sky_spectrum
from pepperscene.spectra.prospect import INCIDENCE_CONE_RAD, cone_transmissivity


def smooth_gloss(ior):
    """Reflectance of a smooth cuticle for light in PROSPECT's cone of incidence."""
    return 1 - cone_transmissivity(INCIDENCE_CONE_RAD, ior)


def at(table, state, first=0.0):
    """Spectrum at a state, linear between the rows of `(s, n)`, of which the first has state `first`."""
    states = np.linspace(first, 1, len(table))
    return np.array([np.interp(state, states, column) for column in table.T])


def xyz(reflectance, nm):
    """XYZ under D65 and the white's chromaticity, 2 degrees, by colour-science's observer."""
    cmfs = colour.MSDS_CMFS["CIE 1931 2 Degree Standard Observer"]
    bars = np.stack([np.interp(nm, cmfs.wavelengths, cmfs.values[:, i]) for i in range(3)])
    light = sky_spectrum("d65").at(nm)
    scale = 1 / np.sum(light * bars[1])
    return scale * bars @ (light * reflectance), colour.XYZ_to_xy(scale * bars @ light)


def lab(reflectance, nm):
    """CIELAB under D65."""
    return colour.XYZ_to_Lab(*xyz(reflectance, nm))


def lab_hue(reflectance, nm):
    """Hue angle in CIELAB, degrees: 90 is yellow, 180 green."""
    _, a, b = lab(reflectance, nm)
    return np.degrees(np.arctan2(b, a)) % 360


def srgb_hue(reflectance, nm):
    """Hue in HSV of the sRGB colour under D65, degrees: 0 is red, 60 yellow."""
    value, white = xyz(reflectance, nm)
    rgb = np.clip(colour.XYZ_to_sRGB(value, illuminant=white), 0, 1)
    return 360 * colour.RGB_to_HSV(rgb)[0]
