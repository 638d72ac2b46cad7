"""What fruit, stems and stalks have in common: a pigmented rind on a pale, watery body."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pepperscene.materials.gloss import cone_gloss
from pepperscene.materials.patterns import noise_mm
from pepperscene.materials.surface import Surface, enough_states
from pepperscene.spectra import (
    Spectrum,
    absorption_coefficients,
    layer_over_body,
    leaf_spectra,
    read_spectrum,
)

if TYPE_CHECKING:
    from pepperscene.cultivar import PigmentPath


Array = NDArray[np.float64]

SCATTERING_PER_CM: Final = 10.0
"""Reduced scattering coefficient of fruit flesh: 9.5 to 12.5 cm-1 between 1000 and 500 nm in pears (Hu, Fu &
Ying 2017, J. Food Meas. Charact., doi 10.1007/s11694-017-9465-x). Stems are taken to be alike."""
WATER_SHARE: Final = 0.9
"""Of the flesh's volume: chosen, sweet pepper is 92 to 94 % water by weight and holds some air."""


def flesh_reflectance(dry_reflectance: float, wavelength_nm: ArrayLike) -> Array:
    """Reflectance `(n,)` of a thick, diffuse body of parenchyma under diffuse light, 300 to 1100 nm: a MODEL.

    Kubelka & Munk 1931: K/S = (1 - R)^2 / (2 R). What the body absorbs without water gives
    `dry_reflectance` at every wavelength; its water adds K = 2 mu_a to that, with S = 3/4 mu_s'
    (Mudgett & Richards 1971, Appl. Opt. 10:1485). Below 700 nm water takes nothing, at 970 nm its band is
    seen, as in measured fruit.

    Args:
        dry_reflectance: where water does not absorb, in [0, 1).
        wavelength_nm: `(n,)`.
    """
    nm = np.atleast_1d(np.asarray(wavelength_nm, dtype=float))
    if dry_reflectance == 0.0:
        return np.zeros(nm.size)
    water_per_cm = absorption_coefficients(nm)["water"]
    dry = (1.0 - dry_reflectance) ** 2 / (2.0 * dry_reflectance)
    wet = dry + 2.0 * WATER_SHARE * water_per_cm / (0.75 * SCATTERING_PER_CM)
    return np.asarray(1.0 + wet - np.sqrt(wet**2 + 2.0 * wet))


def rind_reflectance(path: PigmentPath, wavelength_nm: Array, states: ArrayLike) -> Array:
    """Reflectance `(s, n)` under the cuticle of a pigmented rind on its flesh, at states `(s,)`.

    The pigments are mixed at each state and then the spectrum is computed (PROSPECT's layer on a diffuse
    body): the colour half-way is not the mean of the ends' colours.
    """
    rind = leaf_spectra(wavelength_nm, **path.at(np.atleast_1d(np.asarray(states, dtype=float))))
    flesh = flesh_reflectance(path.flesh_reflectance or 0.0, wavelength_nm)
    reflectance, _ = layer_over_body(rind, flesh).under_gloss(cone_gloss(path.ior, path.roughness[0]))
    return reflectance


def rind_surface(
    name: str,
    path: PigmentPath,
    wavelength_nm: Array,
    pattern: Array,
    relief_mm: Array | None = None,
) -> Surface:
    """An opaque surface of rind on flesh, the same from both sides, tabulated finely enough."""
    states = enough_states(lambda nm, asked: rind_reflectance(path, nm, asked))
    rows = rind_reflectance(path, wavelength_nm, states)
    return Surface(
        name,
        wavelength_nm,
        np.repeat(rows[:, None, :], 2, axis=1),
        np.zeros_like(rows),
        ior=path.ior,
        roughness=path.roughness,
        pattern=pattern.astype(np.float32),
        relief_mm=None if relief_mm is None else relief_mm.astype(np.float32),
    )


PIXELS: Final = 256


def fruit_surface(
    path: PigmentPath,
    wavelength_nm: NDArray[np.float64],
    size_mm: tuple[float, float],
    rng: np.random.Generator,
) -> Surface:
    """A fruit, ripening in patches on top of the ripeness that the mesh gives to each of its points.

    Args:
        path: pigments from unripe (state 0) over breaker to ripe (state 1).
        wavelength_nm: `(n,)`.
        size_mm: girth and length.
        rng: draws the patches.
    """
    # Patches of centimetres turn earlier than others, with a faint speckle on top: amounts chosen by eye.
    grid = (PIXELS, PIXELS)
    patches = 0.045 * noise_mm(rng, grid, size_mm, (9.0, 14.0))
    speckle = 0.012 * noise_mm(rng, grid, size_mm, (0.7, 0.7))
    return rind_surface("fruit", path, wavelength_nm, patches + speckle)


DRY_MEASURED: Final = "organ/vrhel_wood_bark_straw_reflectance"
DRY_INFRARED: Final = "organ/earthlib_wood_bark_reflectance"


@dataclass(frozen=True)
class Grain:
    """How a rind varies in state and in height over its surface; all chosen by eye from photographs.

    Attributes:
        streaks: standard deviation of the state in streaks that run along the organ.
        mottle: standard deviation of the state in blotches of some millimetres.
        cork: by how much the state falls in corky flecks, a few millimetres long.
        ribs_mm: standard deviation of the height of ribs that run along the organ.
        rib_share: width of a rib, as a share of the girth.
    """

    streaks: float
    mottle: float
    ribs_mm: float
    rib_share: float
    cork: float = 0.0


GRAINS: Final = {
    # Lenticels and cork in short fissures; the large ridges are the mesh's.
    "stem": Grain(streaks=0.06, mottle=0.04, ribs_mm=0.11, rib_share=0.05, cork=0.3),
    "petiole": Grain(streaks=0.06, mottle=0.04, ribs_mm=0.05, rib_share=0.05),
    # Slightly ribbed on top of the mesh's five ribs.
    "peduncle": Grain(streaks=0.07, mottle=0.03, ribs_mm=0.10, rib_share=0.035),
    # A rib runs out into each tooth of the star.
    "calyx": Grain(streaks=0.05, mottle=0.06, ribs_mm=0.20, rib_share=0.03),
}


def green_surface(
    name: str, path: PigmentPath, wavelength_nm: Array, size_mm: tuple[float, float], rng: np.random.Generator
) -> Surface:
    """A stem, petiole, peduncle or calyx: a green rind on pale parenchyma, streaked and ribbed along.

    Args:
        name: of the surface, one of `GRAINS`.
        path: pigments from pale or corky (state 0) to dark green (state 1).
        wavelength_nm: `(n,)`.
        size_mm: girth and length.
        rng: draws streaks, flecks and ribs.
    """
    grain, girth = GRAINS[name], size_mm[0]

    def noise(around_mm: float, along_mm: float) -> Array:
        return noise_mm(rng, (PIXELS, PIXELS), size_mm, (around_mm, along_mm))

    # Streaks are narrow around (u) and long (v); ribs run along the whole organ.
    pattern = grain.streaks * noise(0.02 * girth, 12.0) + grain.mottle * noise(1.5, 6.0)
    relief_mm = grain.ribs_mm * noise(grain.rib_share * girth, 60.0)
    if grain.cork:
        # Flecks are where a field of short streaks peaks: the upper tenth, with soft borders.
        fleck = np.clip((noise(0.25, 1.6) - 1.3) / 0.7, 0.0, 1.0)
        pattern = pattern - grain.cork * fleck
    return rind_surface(name, path, wavelength_nm, pattern, relief_mm)


def cut_surface(stem: PigmentPath, wavelength_nm: Array, rng: np.random.Generator) -> Surface:
    """The scar where a fruit was cut off: pale dry cork in the middle (state 0), a dark green rim (state 1).

    A MODEL: no spectrum of such a scar was found. The middle is measured straw and bark chip in equal parts,
    the rim measured bark and this cultivar's darkest stem in equal parts (Vrhel et al. 1994; parts chosen).
    """
    straw = _dry("straw_from_broom_154", "woodstrw").at(wavelength_nm)
    chip = _dry("bark_chip_iii_129", "innrbark").at(wavelength_nm)
    bark = _dry("bark_37", "deadtwig").at(wavelength_nm)
    green = rind_reflectance(stem, wavelength_nm, 1.0)[0]
    rows = np.stack([0.5 * (straw + chip), 0.5 * (bark + green)])
    speckle = 0.12 * noise_mm(rng, (PIXELS, PIXELS), (10.0, 10.0), (0.5, 0.5))
    both = np.repeat(rows[:, None, :], 2, axis=1)
    return Surface("cut", wavelength_nm, both, np.zeros_like(rows), pattern=speckle.astype(np.float32))


def _dry(measured: str, alike: str) -> Spectrum:
    """A dry plant material measured in the visible, continued to 1100 nm like another of its kind: a MODEL.

    Dry matter goes on brightening in the near infrared, where the visible measurement has ended (730 nm).
    Beyond, absorption over scattering K/S = (1 - R)^2 / (2 R) (Kubelka & Munk 1931) falls in the same
    proportion as in the material whose infrared is known. The first value holds below 390 nm.
    """
    known = read_spectrum(DRY_MEASURED, measured, outside="hold")
    other = read_spectrum(DRY_INFRARED, alike, outside="hold")
    last_nm = known.wavelength_nm[-1]
    beyond_nm = other.wavelength_nm[other.wavelength_nm > last_nm]
    share = _absorbed(other.at(beyond_nm)) / _absorbed(other.at(last_nm))
    ratio = share * _absorbed(known.values[-1:])
    beyond = 1.0 + ratio - np.sqrt(ratio**2 + 2.0 * ratio)
    return Spectrum(
        np.concatenate([known.wavelength_nm, beyond_nm]), np.concatenate([known.values, beyond]), "hold"
    )


def _absorbed(reflectance: Array) -> Array:
    """Kubelka and Munk's absorption over scattering of a thick body."""
    return np.asarray((1.0 - reflectance) ** 2 / (2.0 * reflectance))
