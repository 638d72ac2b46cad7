"""What stands around the plants: twine and wire, gutters and what lies in them, floor film, heating pipes."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pepperscene.materials.surface import Surface
from pepperscene.spectra import read_spectrum

WHITE_PAINT: Final = ("chart/colorchecker_iso17321_1", "white_9_5_05_d")
"""A paint white by titanium dioxide, which also whitens coated steel, polypropylene and polyethylene: bright
from 420 nm on, dark in the ultraviolet. Measured from 380 to 780 nm; the end values hold beyond, as the
pigment's band edge lies at 400 nm and neither it nor the polymers absorb much between 780 and 1100 nm."""
GUTTER_CLEANNESS: Final = 0.92
"""Chosen: dust and salts on a gutter in use take some per cent of its white."""
FILM_SCATTERING: Final = 3.0
"""Kubelka and Munk's S times thickness of the film at 550 nm: chosen, so that it reflects three quarters."""
GROUND_REFLECTANCE: Final = 0.08
"""Of the wet, dark ground under the film: chosen. Its light passes the film twice and adds 1 % at most, so
that its own colour cannot be seen."""
STEEL_REFLECTANCE: Final = 0.35
"""Of a galvanised wire: chosen. Zinc that has weathered to a matt grey, even over the whole range."""
ROCKWOOL_REFLECTANCE: Final = ((400.0, 0.08), (700.0, 0.22), (1100.0, 0.30))
"""Of wet stone wool with some algae, wavelength in nm and reflectance: chosen, a dark yellowish brown.
Straight lines between, the end values beyond."""


def greenhouse_surfaces(wavelength_nm: ArrayLike) -> dict[str, Surface]:
    """The surfaces of the greenhouse by name: twine, gutter, foil, rockwool, floor_film, steel and pipe.

    Args:
        wavelength_nm: `(n,)` increasing; the spectra are made for 300 to 1100 nm.
    """
    surfaces = (
        twine_surface(wavelength_nm),
        gutter_surface(wavelength_nm),
        foil_surface(wavelength_nm),
        rockwool_surface(wavelength_nm),
        floor_film_surface(wavelength_nm),
        steel_surface(wavelength_nm),
        pipe_surface(wavelength_nm),
    )
    return {surface.name: surface for surface in surfaces}


def twine_surface(wavelength_nm: ArrayLike) -> Surface:
    """The twine that plants climb on: matt, opaque, the measured white table cloth of Vrhel et al. 1994.

    It was measured from 390 to 730 nm; the end values hold beyond, as white textiles are even from there to
    1100 nm, and the cloth is dark already where its white ends in the violet.
    """
    nm = _grid(wavelength_nm)
    cloth = read_spectrum("organ/vrhel_white_fabric_reflectance", "table_cloth_white_163", outside="hold")
    return _opaque("twine", nm, cloth.at(nm))


def gutter_surface(wavelength_nm: ArrayLike) -> Surface:
    """The gutter that carries the substrate: white-coated steel with a slight gloss.

    A MODEL: the measured white paint of the ColorChecker, dusty; index and roughness of a satin coating
    are chosen.
    """
    nm = _grid(wavelength_nm)
    return _opaque("gutter", nm, GUTTER_CLEANNESS * _paint(nm), ior=1.5, roughness=(0.3, 0.3))


def foil_surface(wavelength_nm: ArrayLike) -> Surface:
    """The foil around slabs and blocks of substrate: white polyethylene, thick enough to hide what is in it.

    A MODEL: as the gutter, but rougher, as foil creases; chosen.
    """
    nm = _grid(wavelength_nm)
    return _opaque("foil", nm, GUTTER_CLEANNESS * _paint(nm), ior=1.5, roughness=(0.45, 0.45))


def rockwool_surface(wavelength_nm: ArrayLike) -> Surface:
    """The open upper side of a block of substrate: matt, `ROCKWOOL_REFLECTANCE`."""
    nm = _grid(wavelength_nm)
    known, reflectance = zip(*ROCKWOOL_REFLECTANCE, strict=True)
    return _opaque("rockwool", nm, np.interp(nm, known, reflectance))


def steel_surface(wavelength_nm: ArrayLike) -> Surface:
    """The wire that the twine is tied to: matt, `STEEL_REFLECTANCE`."""
    nm = _grid(wavelength_nm)
    return _opaque("steel", nm, np.full(nm.size, STEEL_REFLECTANCE))


def pipe_surface(wavelength_nm: ArrayLike) -> Surface:
    """The heating pipes on the floor: steel painted white, as the gutter."""
    nm = _grid(wavelength_nm)
    return _opaque("pipe", nm, GUTTER_CLEANNESS * _paint(nm), ior=1.5, roughness=(0.3, 0.3))


def floor_film_surface(wavelength_nm: ArrayLike) -> Surface:
    """The floor: white film or woven ground cover that lies on wet, dark ground.

    A MODEL: a layer of white paint (Kubelka & Munk 1931) too thin to hide the ground altogether, the less the
    longer the waves, since pigment grains of 0.25 micrometres scatter about as 1/wavelength beyond the green.
    As the ground lies right below, film and ground are one opaque body. Index and roughness of worn
    polyethylene are chosen.
    """
    nm = _grid(wavelength_nm)
    return _opaque("floor_film", nm, _film_on_ground(nm), ior=1.5, roughness=(0.5, 0.5))


def _film_on_ground(nm: NDArray[np.float64]) -> NDArray[np.float64]:
    """Reflectance of a scattering layer with a backing: Kubelka & Munk's hyperbolic solution."""
    thick = _paint(nm)
    a = 0.5 * (1.0 / thick + thick)
    b = np.sqrt(a**2 - 1.0)
    c = b / np.tanh(b * FILM_SCATTERING * 550.0 / nm)
    ground = GROUND_REFLECTANCE
    return np.asarray((1.0 - ground * (a - c)) / (a - ground + c))


def _paint(nm: NDArray[np.float64]) -> NDArray[np.float64]:
    return read_spectrum(*WHITE_PAINT, outside="hold").at(nm)


def _opaque(
    name: str,
    nm: NDArray[np.float64],
    reflectance: NDArray[np.float64],
    ior: float = 1.0,
    roughness: tuple[float, float] = (0.3, 0.3),
) -> Surface:
    """One spectrum on both sides."""
    both = np.tile(reflectance, (1, 2, 1))
    return Surface(name, nm, both, np.zeros((1, nm.size)), ior=ior, roughness=roughness)


def _grid(wavelength_nm: ArrayLike) -> NDArray[np.float64]:
    return np.atleast_1d(np.asarray(wavelength_nm, dtype=float))
