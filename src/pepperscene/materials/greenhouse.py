"""Surfaces of the greenhouse: twine and wire, gutters and their contents, floor film, heating pipes."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pepperscene.materials.patterns import noise_mm
from pepperscene.materials.rind import absorption_per_scattering, thick_reflectance
from pepperscene.materials.surface import Surface, opaque_surface
from pepperscene.spectra import read_spectrum
from pepperscene.spectra.spectrum import FloatArray

WHITE_PAINT: Final = ("chart/colorchecker_iso17321_1", "white_9_5_05_d")
"""A paint white by titanium dioxide, which also whitens coated steel, polypropylene and polyethylene: bright
from 420 nm on, dark in the ultraviolet. Measured from 380 to 780 nm; the end values apply beyond, as the
pigment's band edge is at 400 nm and neither it nor the polymers absorb much between 780 and 1100 nm."""
WHITE_FABRIC: Final = ("organ/vrhel_white_fabric_reflectance", "table_cloth_white_163")
"""The white table cloth of Vrhel et al. 1994, measured from 390 to 730 nm; the end values apply beyond, as
white textiles have a constant reflectance up to 1100 nm and the cloth is already dark in the violet."""
TWINE_DUST: Final = 0.05
"""K/S of the dust, algae and wear on twine: chosen, takes its reflectance at 550 nm from 0.79 to 0.68."""
STRANDS: Final = 3  # chosen: of laid twine
STRAND_TURNS: Final = 3  # of the strands about each other, over the length of the texture
STRAND_MM: Final = 0.22
"""Depth of the furrows between strands: chosen. Round strands would leave 0.9 mm on a twine of 3 mm; fibres
fill most of it."""
TWINE_MM: Final = 3.0  # chosen: diameter that the texture is drawn for, as in the shipped recipes
TWINE_SHAPE: Final = (256, 96)  # rows and columns: 0.2 by 0.1 mm
TWINE_SEED: Final = 3301  # chosen
GUTTER_CLEANNESS: Final = 0.92
"""Chosen: dust and salts on a gutter in use absorb some per cent."""
FILM_SCATTERING: Final = 3.0
"""Kubelka and Munk's S times thickness of the film at 550 nm: chosen, so that it reflects three quarters."""
GROUND_REFLECTANCE: Final = 0.08
"""Of the wet, dark ground under the film: chosen. Its light passes the film twice and adds 1 % at most, so
that its own colour cannot be seen."""
STEEL_REFLECTANCE: Final = 0.35
"""Of a galvanised wire: chosen. Zinc that has weathered to a matt grey, constant over the whole range."""
ROCKWOOL_REFLECTANCE: Final = ((400.0, 0.08), (700.0, 0.22), (1100.0, 0.30))
"""Of wet stone wool with some algae, wavelength in nm and reflectance: chosen, a dark yellowish brown.
Linear in between, the end values beyond."""


def greenhouse_surfaces(wavelength_nm: ArrayLike) -> dict[str, Surface]:
    """Surfaces of the greenhouse by name: twine, gutter, foil, rockwool, floor_film, steel and pipe.

    Refractive indices and roughnesses are chosen. The white surfaces except the twine are MODELs: the
    measured white paint of the ColorChecker, dusty.

    Args:
        wavelength_nm: `(n,)` increasing; the spectra are made for 300 to 1100 nm.
    """
    nm = np.atleast_1d(np.asarray(wavelength_nm, dtype=float))
    paint = read_spectrum(*WHITE_PAINT, outside="hold").at(nm)
    dusty = GUTTER_CLEANNESS * paint
    rockwool_nm, rockwool = zip(*ROCKWOOL_REFLECTANCE, strict=True)
    # Reflectance, and roughness of those that are not matt.
    parts: dict[str, tuple[FloatArray, float | None]] = {
        # The gutter that carries the substrate: white-coated steel, a satin coating.
        "gutter": (dusty, 0.3),
        # Foil around slabs and blocks of substrate: white polyethylene, opaque; rougher, as foil creases.
        "foil": (dusty, 0.45),
        # The open upper side of a block of substrate.
        "rockwool": (np.interp(nm, rockwool_nm, rockwool), None),
        # The floor: white film or woven ground cover on wet, dark ground; worn polyethylene.
        "floor_film": (_film_on_ground(paint, nm), 0.5),
        # The wire that the twine is tied to.
        "steel": (np.full(nm.size, STEEL_REFLECTANCE), None),
        # Heating pipes on the floor: steel painted white, like the gutter.
        "pipe": (dusty, 0.3),
    }
    surfaces = {"twine": twine_surface(nm)}
    for name, (reflectance, alpha) in parts.items():
        gloss = {} if alpha is None else {"ior": 1.5, "roughness": (alpha, alpha)}
        surfaces[name] = opaque_surface(name, nm, reflectance[None], **gloss)
    return surfaces


def twine_surface(wavelength_nm: ArrayLike) -> Surface:
    """Twine that plants climb on: white, laid of three strands, a little greyed, matt and opaque.

    A MODEL. State 1 is the crown of a strand, `WHITE_FABRIC` with the dust of some months: its absorption per
    scattering (Kubelka and Munk's K/S) rises by `TWINE_DUST`. State 0 is the furrow between two strands,
    where half of the light meets the other strand before it leaves, and dust collects. The texture's relief
    and states are those of strands with a pitch of five diameters, over the 15 diameters after which v
    repeats on `pepperscene.geometry.twine_mesh`.
    """
    nm = np.atleast_1d(np.asarray(wavelength_nm, dtype=float))
    fabric = read_spectrum(*WHITE_FABRIC, outside="hold").at(nm)
    clean = absorption_per_scattering(fabric)
    crown, dusty = (thick_reflectance(clean + dust) for dust in (TWINE_DUST, 4.0 * TWINE_DUST))
    # Light leaves at once, or after one or more reflections at the other strand.
    furrow = 0.5 * dusty / (1.0 - 0.5 * dusty)
    pattern, relief_mm = _strands()
    return opaque_surface("twine", nm, np.stack([furrow, crown]), pattern=pattern, relief_mm=relief_mm)


def _strands() -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Differences of the state from 0.5 and heights in millimetres, `(1, h, w)`, of strands over uv."""
    height, width = TWINE_SHAPE
    v, u = np.meshgrid((np.arange(height) + 0.5) / height, (np.arange(width) + 0.5) / width, indexing="ij")
    # Distance from the middle of the nearest strand, 1 half-way between two; strands turn thrice over v.
    off = np.abs(2.0 * np.mod(STRANDS * (u - STRAND_TURNS * v), 1.0) - 1.0)
    rng = np.random.default_rng(TWINE_SEED)
    size_mm = (np.pi * TWINE_MM, 15.0 * TWINE_MM)
    # Fibres run along the twine, as they are twisted the other way than the strands; tufts are some mm long.
    fibres = noise_mm(rng, TWINE_SHAPE, size_mm, (0.12, 2.0))
    tufts = noise_mm(rng, TWINE_SHAPE, size_mm, (0.5, 1.5))
    pattern = 0.42 - 0.85 * off**4 + 0.06 * fibres + 0.06 * tufts
    relief_mm = -STRAND_MM * off**2 + 0.012 * fibres
    return pattern[None].astype(np.float32), relief_mm[None].astype(np.float32)


def _film_on_ground(paint: FloatArray, nm: FloatArray) -> FloatArray:
    """Reflectance of white film on ground: Kubelka & Munk's hyperbolic solution (1931).

    A MODEL: a layer of white paint too thin to hide the ground completely. It scatters less at longer
    wavelengths, since pigment grains of 0.25 micrometres scatter about as 1/wavelength beyond the green. Film
    and ground below are one opaque body.
    """
    a = 0.5 * (1.0 / paint + paint)
    b = np.sqrt(a**2 - 1.0)
    c = b / np.tanh(b * FILM_SCATTERING * 550.0 / nm)
    ground = GROUND_REFLECTANCE
    return np.asarray((1.0 - ground * (a - c)) / (a - ground + c))
