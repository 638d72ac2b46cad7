"""Surfaces of a stand: pots, substrate, stake, backdrops, and the patches of charts."""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from pepperscene.errors import InputError
from pepperscene.materials.surface import Surface, opaque_surface
from pepperscene.spectra import read_spectra, read_spectrum
from pepperscene.spectra.files import spectra_file
from pepperscene.spectra.measured import read_measured
from pepperscene.spectra.spectrum import FloatArray

CHART: Final = "chart/colorchecker_iso17321_1"
"""The 24 patches of the ColorChecker, measured from 380 to 780 nm; the end values apply beyond."""
WHITE_PATCH, BLACK_PATCH, PATCHES = 18, 23, 24

STAND_COLOURS: Final = {
    # Fired clay: hematite absorbs up to its edge near 580 nm, and weakly at 870 nm.
    "terracotta": (
        (400.0, 0.07), (500.0, 0.10), (550.0, 0.15), (600.0, 0.29), (650.0, 0.36), (750.0, 0.42),
        (870.0, 0.40), (1100.0, 0.48),
    ),
    # Carbon black absorbs evenly.
    "black": ((400.0, 0.045), (1100.0, 0.045)),
    # Titanium dioxide, whose band edge is at 400 nm.
    "white": ((380.0, 0.15), (400.0, 0.41), (420.0, 0.82), (450.0, 0.87), (1100.0, 0.89)),
    "grey": ((400.0, 0.18), (1100.0, 0.20)),
    # A blue dye, transparent beyond 680 nm as dyes of textiles are.
    "blue": (
        (400.0, 0.16), (450.0, 0.24), (480.0, 0.22), (520.0, 0.13), (560.0, 0.08), (640.0, 0.07),
        (680.0, 0.13), (740.0, 0.50), (1100.0, 0.60),
    ),
}  # fmt: skip
"""Colours of pots, cloths and walls: wavelength in nm and reflectance. All are chosen. Linear in between, the
end values beyond."""
_GLOSSY: Final = ("black", "white")  # pots of plastic; chosen, as are index and roughness
SUBSTRATE: Final = (
    ((400.0, 0.03), (550.0, 0.05), (700.0, 0.10), (1100.0, 0.25)),
    ((400.0, 0.5), (1100.0, 0.75)),
)
"""Moist peat, dark brown, and grains of perlite, white: chosen."""
_BAMBOO: Final = ("organ/vrhel_wood_bark_straw_reflectance", "bamboo_122")


def patch_state(patch: int) -> float:
    """State of the surface "chart" at which it has the spectrum of a patch, 0 to 23."""
    return patch / (PATCHES - 1)


def stand_surfaces(
    wavelength_nm: ArrayLike, pot: str = "terracotta", backdrop: str = "white"
) -> dict[str, Surface]:
    """Surfaces of a stand by name: pot, backdrop, turntable, substrate, stake and chart.

    All but pots of plastic are matt. States of the chart are the patches of the ColorChecker, `patch_state`;
    states of the substrate go from peat to perlite.

    Args:
        wavelength_nm: `(n,)` increasing; the spectra are made for 300 to 1100 nm.
        pot: a name of `STAND_COLOURS`, or the path of a CSV file, whose first curve is used; see
            `pepperscene.spectra.measured.read_measured`.
        backdrop: likewise.

    Raises:
        InputError: a file is missing or has other values than reflectances.
    """
    nm = np.atleast_1d(np.asarray(wavelength_nm, dtype=float))
    chart = np.stack([spectrum.at(nm) for spectrum in read_spectra(CHART, outside="hold").values()])
    rows = {
        "pot": colour_reflectance(pot, nm)[None],
        "backdrop": colour_reflectance(backdrop, nm)[None],
        "turntable": colour_reflectance("grey", nm)[None],
        "substrate": np.stack([_interpolate(curve, nm) for curve in SUBSTRATE]),
        "stake": read_spectrum(*_BAMBOO, outside="hold").at(nm)[None],
        "chart": chart,
    }
    surfaces = {name: opaque_surface(name, nm, reflectance) for name, reflectance in rows.items()}
    ior = 1.5 if pot in _GLOSSY else 1.0
    return surfaces | {"pot": replace(surfaces["pot"], ior=ior, roughness=(0.25, 0.25))}


def colour_reflectance(colour: str, nm: FloatArray) -> FloatArray:
    """Reflectance `(n,)` of a colour, as in `stand_surfaces`."""
    if colour in STAND_COLOURS:
        return _interpolate(STAND_COLOURS[colour], nm)
    try:
        return np.asarray(read_measured(spectra_file(colour)).at(nm)[0])
    except InputError as error:
        if error.where != colour:
            raise
        names = ", ".join(STAND_COLOURS)
        raise InputError(colour, f"is neither a file of spectra nor one of {names}") from None


def _interpolate(curve: tuple[tuple[float, float], ...], nm: FloatArray) -> FloatArray:
    knots = np.array(curve)
    return np.interp(nm, knots[:, 0], knots[:, 1])
