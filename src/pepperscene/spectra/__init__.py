"""Spectra: sampled functions of wavelength, their files, daylight, and the leaf model PROSPECT."""

from pepperscene.spectra.files import (
    Provenance,
    read_provenance,
    read_spectra,
    read_spectrum,
    spectra_file,
)
from pepperscene.spectra.lights import (
    D65_K,
    colour_science,
    daylight_basis,
    daylight_mixture,
    illuminance,
    photons_per_joule,
    photopic_efficiency,
    scale_to_illuminance,
    sky_spectrum,
    sun_spectrum,
)
from pepperscene.spectra.prospect import MEAN_LEAF, absorption_coefficients, layer_over_body, leaf_spectra
from pepperscene.spectra.spectrum import Spectrum

__all__ = [
    "D65_K",
    "MEAN_LEAF",
    "Provenance",
    "Spectrum",
    "absorption_coefficients",
    "colour_science",
    "daylight_basis",
    "daylight_mixture",
    "illuminance",
    "layer_over_body",
    "leaf_spectra",
    "photons_per_joule",
    "photopic_efficiency",
    "read_provenance",
    "read_spectra",
    "read_spectrum",
    "scale_to_illuminance",
    "sky_spectrum",
    "spectra_file",
    "sun_spectrum",
]
