"""Surfaces of fruit, stems and stalks: a pigmented rind on a pale, watery body."""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from pepperscene.cultivar import OrganForm, PigmentPath
from pepperscene.materials.gloss import cone_gloss
from pepperscene.materials.patterns import noise_mm
from pepperscene.materials.rind_textures import (
    FruitSkin,
    add_skin,
    fruit_textures,
    green_textures,
    uncorrelated,
)
from pepperscene.materials.surface import Surface, opaque_surface, refine_states, rind_contents
from pepperscene.spectra import (
    Spectrum,
    absorption_coefficients,
    layer_over_body,
    leaf_spectra,
    read_spectrum,
)
from pepperscene.spectra.spectrum import FloatArray

SCATTERING_PER_CM: Final = 10.0
"""Reduced scattering coefficient of fruit flesh: 9.5 to 12.5 cm-1 between 1000 and 500 nm in pears (Hu, Fu &
Ying 2017, J. Food Meas. Charact., doi 10.1007/s11694-017-9465-x). Assumed equal for stems."""
WATER_FRACTION: Final = 0.9
"""Of the flesh's volume: chosen, sweet pepper is 92 to 94 % water by weight and contains some air."""
CORK_REFLECTANCE: Final = 0.3
"""Of the cork of russet, scars and scratches and of dried spray on fruit, at all wavelengths: chosen, that of
dry bark chips at 550 to 600 nm (0.25 to 0.32; Vrhel et al. 1994)."""
PITH: Final = {
    "structure_n": 1.2, "chlorophyll_ug_cm2": 1.2, "carotenoid_ug_cm2": 0.5, "water_cm": 0.02,
    "dry_matter_g_cm2": 0.004,
}  # fmt: skip
"""Contents of the outermost layer of fresh pith: chosen, a tenth of the green rind's."""
PITH_REFLECTANCE: Final = 0.62
"""Of fresh pith where its water does not absorb: chosen, as the flesh of pale fruit."""
CUT_SHAPE: Final = (64, 64)
CUT_TEXTURES: Final = 4
DRY_MEASURED: Final = "organ/vrhel_wood_bark_straw_reflectance"
DRY_INFRARED: Final = "organ/earthlib_wood_bark_reflectance"


def flesh_reflectance(dry_reflectance: float, wavelength_nm: ArrayLike) -> FloatArray:
    """Reflectance `(n,)` of a thick, diffuse body of parenchyma under diffuse light, 300 to 1100 nm: a MODEL.

    Kubelka & Munk 1931. Without water the body has `dry_reflectance` at every wavelength; water adds
    K = 2 mu_a to its absorption, with S = 3/4 mu_s' (Mudgett & Richards 1971, Appl. Opt. 10:1485). Below
    700 nm water hardly absorbs; at 970 nm its band is visible, as in measured fruit.

    Args:
        dry_reflectance: reflectance where water does not absorb, in [0, 1).
        wavelength_nm: `(n,)`.
    """
    nm = np.atleast_1d(np.asarray(wavelength_nm, dtype=float))
    if dry_reflectance == 0.0:
        return np.zeros(nm.size)
    water_per_cm = absorption_coefficients(nm)["water"]
    dry = absorption_per_scattering(dry_reflectance)
    return thick_reflectance(dry + 2.0 * WATER_FRACTION * water_per_cm / (0.75 * SCATTERING_PER_CM))


def absorption_per_scattering(reflectance: FloatArray | float) -> FloatArray:
    """K/S of a thick body of this reflectance R: (1 - R)^2 / (2 R) (Kubelka & Munk 1931)."""
    return np.asarray((1.0 - reflectance) ** 2 / (2.0 * reflectance))


def thick_reflectance(ratio: FloatArray) -> FloatArray:
    """Reflectance of a thick body of this K/S; inverse of `absorption_per_scattering`."""
    return np.asarray(1.0 + ratio - np.sqrt(ratio**2 + 2.0 * ratio))


def rind_reflectance(path: PigmentPath, wavelength_nm: FloatArray, states: ArrayLike) -> FloatArray:
    """Reflectance `(s, n)` under the cuticle of a pigmented rind on its flesh, at states `(s,)`.

    The pigments are mixed at each state before the spectrum is computed (PROSPECT's layer on a diffuse body):
    the colour at 0.5 is not the mean of the ends' colours.
    """
    rind = leaf_spectra(wavelength_nm, **path.at(np.atleast_1d(np.asarray(states, dtype=float))))
    flesh = flesh_reflectance(path.flesh_reflectance or 0.0, wavelength_nm)
    reflectance, _ = layer_over_body(rind, flesh).under_gloss(cone_gloss(path.ior, path.roughness[0]))
    return reflectance


def _rind_surface(
    name: str, path: PigmentPath, wavelength_nm: FloatArray, pattern: FloatArray, relief_mm: FloatArray
) -> Surface:
    """Surface of rind on flesh, with textures `(t, h, w)`."""
    states = refine_states(lambda nm, states: rind_reflectance(path, nm, states))
    rows = rind_reflectance(path, wavelength_nm, states)
    return opaque_surface(
        name,
        wavelength_nm,
        rows,
        ior=path.ior,
        roughness=path.roughness,
        pattern=pattern.astype(np.float32),
        relief_mm=relief_mm.astype(np.float32),
        contents=rind_contents(path, states),
    )


def fruit_surface(
    name: str,
    path: PigmentPath,
    wavelength_nm: FloatArray,
    size_mm: tuple[float, float],
    calyx_mm: float,
    skin: FruitSkin,
    rng: np.random.Generator,
) -> Surface:
    """Fruit that ripens in patches, in addition to the ripeness that the mesh gives each of its points.

    The path's pigments go from unripe (state 0) over breaker to ripe (state 1), `size_mm` are girth and
    length. The skin is slightly wavy. Cork (russet around the calyx, the scar of the style, healed scratches)
    and dried spray are its residue.
    """
    textures = add_skin(fruit_textures(size_mm, calyx_mm, rng), size_mm, skin, rng)
    surface = _rind_surface(name, path, wavelength_nm, textures.pattern, textures.relief_mm)
    mean = textures.cover.mean(axis=(1, 2), keepdims=True)
    return replace(
        surface,
        residue_reflectance=CORK_REFLECTANCE,
        residue_pattern=(textures.cover / mean).astype(np.float32),
        contents={**surface.contents, "ripeness": surface.states},
    )


def green_surface(
    name: str,
    form: OrganForm,
    path: PigmentPath,
    wavelength_nm: FloatArray,
    size_mm: tuple[float, float],
    rng: np.random.Generator,
) -> Surface:
    """Stem, petiole, peduncle or calyx: a green rind on pale parenchyma, with streaks and ribs along it.

    The path's pigments go from pale or corky (state 0) to dark green (state 1), `size_mm` are girth and
    length. The form of the organs determines the texture.
    """
    return _rind_surface(name, path, wavelength_nm, *green_textures(form, size_mm, rng))


def cut_surface(stem: PigmentPath, wavelength_nm: FloatArray, rng: np.random.Generator) -> Surface:
    """Scar where a fruit was cut off: dried pith (state 0), fresh pith, a green ring, bark (state 1).

    A MODEL: no measured spectrum of such a scar was found. Dried pith is measured straw and bark chip in
    equal parts, bark is measured bark and this cultivar's darkest stem in equal parts (Vrhel et al. 1994;
    parts chosen). Fresh pith is the stem's parenchyma with the little pigment of `PITH`, and the ring the
    stem's darkest green, one third and two thirds of the way from the dried pith.
    """
    straw = _dry_material("straw_from_broom_154", "woodstrw").at(wavelength_nm)
    chip = _dry_material("bark_chip_iii_129", "innrbark").at(wavelength_nm)
    bark = _dry_material("bark_37", "deadtwig").at(wavelength_nm)
    green = rind_reflectance(stem, wavelength_nm, 1.0)[0]
    pith = layer_over_body(
        leaf_spectra(wavelength_nm, **PITH), flesh_reflectance(PITH_REFLECTANCE, wavelength_nm)
    ).reflectance
    rows = np.stack([0.5 * (straw + chip), pith, green, 0.5 * (bark + green)])
    fields = [noise_mm(rng, CUT_SHAPE, (10.0, 10.0), (0.4, 0.4)) for _ in range(CUT_TEXTURES)]
    speckle = 0.05 * uncorrelated(np.stack(fields))
    return opaque_surface("cut", wavelength_nm, rows, pattern=speckle.astype(np.float32))


def _dry_material(visible_column: str, infrared_column: str) -> Spectrum:
    """Dry plant material measured in the visible, extrapolated to 1100 nm with a similar one: a MODEL.

    Dry matter becomes brighter in the near infrared, where the visible measurement has ended (730 nm).
    Beyond, K/S falls in the same proportion as in the material whose infrared is known. The first value is
    used below 390 nm.
    """
    visible = read_spectrum(DRY_MEASURED, visible_column, outside="hold")
    infrared = read_spectrum(DRY_INFRARED, infrared_column, outside="hold")
    last_nm = visible.wavelength_nm[-1]
    beyond_nm = infrared.wavelength_nm[infrared.wavelength_nm > last_nm]
    ratio, last_ratio = (absorption_per_scattering(infrared.at(nm)) for nm in (beyond_nm, last_nm))
    extrapolated = thick_reflectance(ratio / last_ratio * absorption_per_scattering(visible.values[-1:]))
    nm = np.concatenate([visible.wavelength_nm, beyond_nm])
    return Spectrum(nm, np.concatenate([visible.values, extrapolated]), "hold")
