"""Spectra of leaves and petals: PROSPECT's leaf under a cuticle, with a paler lower side."""

from __future__ import annotations

from typing import Final

import numpy as np

from pepperscene.cultivar import PigmentPath
from pepperscene.materials.gloss import cone_gloss, cuticle_transmittance
from pepperscene.materials.surface import Surface, leaf_contents, refine_states
from pepperscene.spectra import leaf_spectra
from pepperscene.spectra.spectrum import FloatArray

ABAXIAL_FRACTION: Final = 0.6
"""Fraction of the pigments that light from below meets before it turns back: chosen.

PROSPECT's leaf is the same on both sides; a real one has most of its chlorophyll in the palisade below its
upper side, so that the lower side reflects more in the visible and about as much in the near infrared
(Woolley 1971, Plant Physiology 47:656).
"""

SPONGY_REFLECTANCE: Final = 0.04
"""Reflectance of the lower epidermis and the air-filled cells above it, which hold no pigment: chosen, so
that the mean leaf's lower side reflects about twice as much as its upper side at 450 and 670 nm, surface
reflection included (1.9 and 2.2 times). It has L* 49, C* 28 under D65."""

PIGMENTS: Final = (
    "chlorophyll_ug_cm2", "carotenoid_ug_cm2", "capsanthin_ug_cm2", "anthocyanin_ug_cm2", "brown"
)  # fmt: skip


def leaf_optics(
    path: PigmentPath, wavelength_nm: FloatArray, states: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Reflectance of the upper and of the lower side and transmittance of the whole sheet, each `(s, n)`.

    Hemispherical, with the gloss, for light in PROSPECT's cone of incidence. The upper side and the
    transmittance are PROSPECT's. Below, an unpigmented layer of reflectance r is over a leaf of reflectance R
    with `ABAXIAL_FRACTION` of the pigments: r + (1 - r)^2 R / (1 - r R) (Stokes 1862). The transmittance is
    the same both ways, as reciprocity requires; the lower reflectance is at most 1 minus it.
    """
    contents = path.at(states)
    thinned = {
        name: amount * ABAXIAL_FRACTION if name in PIGMENTS else amount for name, amount in contents.items()
    }
    leaf = leaf_spectra(wavelength_nm, **contents)
    inner = leaf_spectra(wavelength_nm, **thinned).reflectance
    layer = SPONGY_REFLECTANCE
    lower = layer + (1.0 - layer) ** 2 * inner / (1.0 - layer * inner)
    return leaf.reflectance, np.minimum(lower, 1.0 - leaf.transmittance), leaf.transmittance


def leaf_body(
    path: PigmentPath, wavelength_nm: FloatArray, states: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Reflectance of the upper and of the lower side and transmittance, each `(s, n)`, under the cuticle.

    They are fractions of the light that enters. Cuticle and body together have the sheet's reflectances and
    its transmittance from above (`leaf_optics`): the gloss is taken off the surface reflection that PROSPECT
    includes (as in PROSPECULAR, Li et al. 2023), and only the light that the cuticle's lobes scatter more
    than once stays with the body. A glossier cuticle sends part of what comes through the sheet back to the
    other side (`pepperscene.render.surface.scattering`); that is taken off as well.
    """
    return under_cuticle(path, *leaf_optics(path, wavelength_nm, states))


def under_cuticle(
    path: PigmentPath, upper: FloatArray, lower: FloatArray, transmittance: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Reflectances and transmittance of the body that has those of the sheet `(s, n)`: see `leaf_body`."""
    entering = [1.0 - mean_gloss(path, side) for side in (0, 1)]
    opens = [mean_openness(path, side) for side in (0, 1)]
    leaving = [min(opens) / openness for openness in opens]
    # Clipped where pigments absorb everything and the cuticle reflects more than PROSPECT's leaf.
    through = np.clip(transmittance / (entering[0] * leaving[0]), 0.0, 1.0)
    front, back = (
        np.clip(1.0 - (1.0 - sheet) / entering[side] - through * (1.0 - leaving[side]), 0.0, 1.0 - through)
        for side, sheet in enumerate((upper, lower))
    )
    return front, back, through


def gloss_lobes(path: PigmentPath, side: int) -> tuple[tuple[float, float], ...]:
    """(share of the cuticle's area, GGX alpha) of each lobe of the gloss, on side 0 (front) or 1 (back)."""
    if path.wide_roughness is None:
        return ((1.0, path.roughness[side]),)
    return (1.0 - path.wide_share, path.roughness[side]), (path.wide_share, path.wide_roughness[side])


def mean_gloss(path: PigmentPath, side: int) -> float:
    """Fraction of the light in PROSPECT's cone of incidence that the gloss of a side, 0 or 1, reflects."""
    return sum(share * cone_gloss(path.ior, alpha) for share, alpha in gloss_lobes(path, side))


def mean_openness(path: PigmentPath, side: int) -> float:
    """Fraction of diffuse light that passes the cuticle of a side; see `mean_gloss`."""
    return sum(share * cuticle_transmittance(path.ior, alpha)[1] for share, alpha in gloss_lobes(path, side))


def leaf_surface(name: str, path: PigmentPath, wavelength_nm: FloatArray) -> Surface:
    """Leaf or petal of these pigments, without textures; it ages if the path does."""
    first = -1.0 if path.ageing else 0.0
    states = refine_states(lambda nm, states: np.stack(leaf_body(path, nm, states), axis=1), first)
    upper, lower, transmittance = leaf_body(path, wavelength_nm, states)
    return Surface(
        name,
        wavelength_nm,
        np.stack([upper, lower], axis=1),
        transmittance,
        ior=path.ior,
        roughness=path.roughness,
        wide_roughness=path.wide_roughness,
        wide_share=path.wide_share,
        first_state=first,
        contents=leaf_contents(path, states),
    )
