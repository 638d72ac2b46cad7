"""The surfaces of a plant's organs, from the pigments of its cultivar."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pepperscene.materials.noise import smooth_noise
from pepperscene.materials.surface import Surface
from pepperscene.materials.venation import grow_veins, vein_pattern, vein_relief
from pepperscene.spectra import leaf_spectra, over_body, read_spectrum

if TYPE_CHECKING:
    from pepperscene.cultivar import Cultivar, PigmentPath

Array = NDArray[np.float64]

LEAF_STATES: Final = 17
FRUIT_STATES: Final = 41
GREEN_STATES: Final = 9
"""Rows along the paths: chosen so that linear interpolation between them stays within .002 of the model."""

ABAXIAL_SHARE: Final = 0.5
"""Share of the pigments that light from below meets before it turns back: chosen.

PROSPECT's leaf is the same on both sides; a real one keeps most of its chlorophyll in the palisade below its
upper side, so that the lower side reflects more in the visible and as much in the near infrared (Woolley
1971, Plant Physiology 47:656). The lower side's reflectance is that of a leaf with this share of the pigments
and the same structure, water and dry matter; the transmittance is that of the whole leaf both ways, as
reciprocity asks. Since transmittance falls with pigment, the sum can never exceed 1.
"""

PIGMENTS: Final = (
    "chlorophyll_ug_cm2", "carotenoid_ug_cm2", "capsanthin_ug_cm2", "anthocyanin_ug_cm2", "brown"
)  # fmt: skip
PATTERN_SEED: Final = 112_135
"""Of the generator that draws all patterns: chosen; the patterns belong to the cultivar, not to a frame."""


def organ_surfaces(cultivar: Cultivar, wavelength_nm: ArrayLike) -> dict[str, Surface]:
    """The surfaces that the meshes of a plant name: leaf, petiole, stem, fruit, calyx and cut.

    Args:
        cultivar: whose `pigments` give the paths through pigment space, and whose sizes the patterns' scale.
        wavelength_nm: `(n,)` increasing, up to 2500 nm.

    Raises:
        ValueError: a wavelength lies beyond the pigments' coefficients.
    """
    nm = np.atleast_1d(np.asarray(wavelength_nm, dtype=float))
    pigments = cultivar.pigments
    rngs = dict(zip(("leaf", "petiole", "stem", "fruit", "calyx", "cut"),
                    np.random.default_rng(PATTERN_SEED).spawn(6), strict=True))  # fmt: skip

    blade_mm = (1e3 * cultivar.leaf.width.mean, 1e3 * cultivar.leaf.length.mean)
    girth_mm = 1e3 * np.pi * cultivar.fruit.diameter.mean
    fruit_mm = (girth_mm, 1e3 * cultivar.fruit.diameter.mean * cultivar.fruit.slenderness.mean)
    stem = cultivar.plant.stem_diameter.mean, cultivar.node.internode_length.mean
    petiole = cultivar.leaf.petiole_diameter.mean, cultivar.leaf.petiole_length.mean
    peduncle = cultivar.peduncle.diameter.mean, cultivar.peduncle.length.mean

    surfaces = (
        leaf_surface(pigments["leaf"], nm, blade_mm, rngs["leaf"]),
        green_surface("petiole", pigments["petiole"], nm, _around_mm(*petiole), rngs["petiole"]),
        green_surface("stem", pigments["stem"], nm, _around_mm(*stem), rngs["stem"]),
        fruit_surface(pigments["fruit"], nm, fruit_mm, rngs["fruit"]),
        green_surface("calyx", pigments["calyx"], nm, _around_mm(*peduncle), rngs["calyx"]),
        cut_surface(pigments["stem"], nm, rngs["cut"]),
    )
    return {surface.name: surface for surface in surfaces}


def leaf_surface(
    path: PigmentPath, wavelength_nm: Array, size_mm: tuple[float, float], rng: np.random.Generator
) -> Surface:
    """A leaf's blade: PROSPECT on both sides, its gloss left to the cuticle, with veins.

    Args:
        path: pigments from pale (state 0) to dark (state 1).
        wavelength_nm: `(n,)`.
        size_mm: width and length of the flat blade.
        rng: draws veins and mottling.
    """
    contents = path.at(np.linspace(0.0, 1.0, LEAF_STATES))
    above, through = leaf_spectra(wavelength_nm, **contents).under_cuticle(path.ior)
    below, _ = leaf_spectra(wavelength_nm, **_thinned(contents, ABAXIAL_SHARE)).under_cuticle(path.ior)
    veins = grow_veins(size_mm, rng)
    return Surface(
        "leaf",
        wavelength_nm,
        np.stack([above, below], axis=1),
        np.minimum(through, 1.0 - below),
        ior=path.ior,
        roughness=path.roughness,
        pattern=vein_pattern(veins, rng),
        relief_mm=vein_relief(veins, rng),
    )


def fruit_surface(
    path: PigmentPath, wavelength_nm: Array, size_mm: tuple[float, float], rng: np.random.Generator
) -> Surface:
    """A fruit: pigmented skin on white flesh under a smooth cuticle, ripening in patches.

    Args:
        path: pigments from unripe (state 0) over breaker to ripe (state 1).
        wavelength_nm: `(n,)`.
        size_mm: girth and length.
        rng: draws the patches.
    """
    # Patches of centimetres turn earlier than others, with a faint speckle on top: amounts chosen by eye.
    patches = 0.045 * _noise_mm(rng, size_mm, (14.0, 9.0)) + 0.012 * _noise_mm(rng, size_mm, (0.7, 0.7))
    return _opaque("fruit", path, wavelength_nm, FRUIT_STATES, patches, None)


def green_surface(
    name: str, path: PigmentPath, wavelength_nm: Array, size_mm: tuple[float, float], rng: np.random.Generator
) -> Surface:
    """A stem, petiole, peduncle or calyx: a green rind on pale parenchyma, streaked and ribbed along.

    Args:
        name: of the surface.
        path: pigments from pale (state 0) to dark green (state 1).
        wavelength_nm: `(n,)`.
        size_mm: girth and length of the tube.
        rng: draws streaks and ribs.
    """
    # Streaks are narrow around (u) and long (v); some six ribs run along the whole tube. Chosen by eye.
    girth = size_mm[0]
    streaks = 0.06 * _noise_mm(rng, size_mm, (12.0, 0.02 * girth)) + 0.04 * _noise_mm(
        rng, size_mm, (6.0, 1.5)
    )
    ribs = 0.004 * girth * _noise_mm(rng, size_mm, (60.0, 0.05 * girth))
    return _opaque(name, path, wavelength_nm, GREEN_STATES, streaks, ribs)


def cut_surface(stem: PigmentPath, wavelength_nm: Array, rng: np.random.Generator) -> Surface:
    """The scar where a fruit was cut off: pale dry cork in the middle (state 0), a dark green rim (state 1).

    A MODEL: no spectrum of such a scar was found. The middle is measured straw and bark chip in equal parts,
    the rim measured bark and this cultivar's darkest stem in equal parts (Vrhel et al. 1994; parts chosen).
    """
    file = "organ/vrhel_wood_bark_straw_reflectance"
    straw, chip, bark = (
        read_spectrum(file, column, outside="hold").at(wavelength_nm)
        for column in ("straw_from_broom_154", "bark_chip_iii_129", "bark_37")
    )
    green = _skin_on_body(stem, wavelength_nm, np.array([1.0]))[0]
    rows = np.stack([0.5 * (straw + chip), 0.5 * (bark + green)])
    size_mm = (10.0, 10.0)
    speckle = 0.12 * _noise_mm(rng, size_mm, (0.5, 0.5))
    both = np.repeat(rows[:, None, :], 2, axis=1)
    return Surface("cut", wavelength_nm, both, np.zeros_like(rows), pattern=speckle.astype(np.float32))


def twine_surface(wavelength_nm: ArrayLike) -> Surface:
    """The twine that plants climb on: matt, opaque, the measured white table cloth of Vrhel et al. 1994."""
    nm = np.atleast_1d(np.asarray(wavelength_nm, dtype=float))
    cloth = read_spectrum("organ/vrhel_white_fabric_reflectance", "table_cloth_white_163", outside="hold").at(
        nm
    )
    return Surface("twine", nm, np.tile(cloth, (1, 2, 1)), np.zeros((1, nm.size)))


def _opaque(
    name: str,
    path: PigmentPath,
    wavelength_nm: Array,
    states: int,
    pattern: Array,
    relief_mm: Array | None,
) -> Surface:
    """A pigmented skin on a diffuse body, the same from both sides."""
    rows = _skin_on_body(path, wavelength_nm, np.linspace(0.0, 1.0, states))
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


def _skin_on_body(path: PigmentPath, wavelength_nm: Array, states: Array) -> Array:
    """Reflectance `(s, n)` under the cuticle; without a body behind, light that comes through is lost."""
    skin = leaf_spectra(wavelength_nm, **path.at(states))
    reflectance, _ = over_body(skin, path.flesh_reflectance or 0.0).under_cuticle(path.ior)
    return reflectance


def _thinned(contents: dict[str, Array], share: float) -> dict[str, Array]:
    return {name: amount * share if name in PIGMENTS else amount for name, amount in contents.items()}


def _around_mm(diameter_m: float, length_m: float) -> tuple[float, float]:
    return 1e3 * np.pi * diameter_m, 1e3 * length_m


def _noise_mm(
    rng: np.random.Generator, size_mm: tuple[float, float], sigma_mm: tuple[float, float], pixels: int = 256
) -> Array:
    """Smooth noise over uv whose grain is `sigma_mm` along v and along u."""
    return smooth_noise(
        rng, (pixels, pixels), (sigma_mm[0] / size_mm[1] * pixels, sigma_mm[1] / size_mm[0] * pixels)
    )
