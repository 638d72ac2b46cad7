"""Spectra: the sampled function, files, lights, and the pigment model of leaves."""

from pepperscene.spectra.files import (
    Provenance,
    read_provenance,
    read_spectra,
    read_spectrum,
    spectra_file,
)
from pepperscene.spectra.lights import (
    LUMINOUS_EFFICACY,
    illuminance,
    led_spectrum,
    photopic_efficiency,
    sky_spectrum,
    sun_spectrum,
    with_illuminance,
)
from pepperscene.spectra.prospect import (
    LeafOptics,
    absorption_coefficients,
    cuticle_gloss,
    layer_over_body,
    leaf_spectra,
)
from pepperscene.spectra.spectrum import LIGHT_SPEED, PLANCK, Spectrum, colour_science, photons_per_joule

__all__ = [
    "LIGHT_SPEED",
    "LUMINOUS_EFFICACY",
    "PLANCK",
    "LeafOptics",
    "Provenance",
    "Spectrum",
    "absorption_coefficients",
    "colour_science",
    "cuticle_gloss",
    "illuminance",
    "layer_over_body",
    "leaf_spectra",
    "led_spectrum",
    "photons_per_joule",
    "photopic_efficiency",
    "read_provenance",
    "read_spectra",
    "read_spectrum",
    "sky_spectrum",
    "spectra_file",
    "sun_spectrum",
    "with_illuminance",
]
